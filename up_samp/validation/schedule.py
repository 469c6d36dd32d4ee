"""Judge the schedule part of a plan: presence, durations, constraints, effects, conditions.

The numbered rules in comments are those of ``docs/semantics.md``.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any

from unified_planning.model import OperatorKind, TimepointKind

from up_samp.extensions import parts
from up_samp.model import UnsupportedError
from up_samp.model.violation import Violation
from up_samp.validation.conditions import (
    broken_conditions,
    interference,
    present_activities,
    reader_at,
)
from up_samp.validation.timeline import (
    Reading,
    StateTimeline,
    build_timeline,
    constant,
    in_type,
)
from up_samp.validation.values import MISSING, Decisions, Key, Reader, Value, chronicles, parts_of
from up_samp.validation.verdict import Verdict

Judged = tuple[Verdict, StateTimeline | None]
"""The verdict on a schedule, with what it decides and the fluents over time (``None``: the plan is
too broken to tell).
"""


def validate_schedule(problem: Any, plan: Any) -> Verdict:
    """Judge a UP ``Schedule`` of a ``SchedulingProblem`` (motions, if any, are not looked at).

    The rules are in ``docs/semantics.md``. Raises ``UnsupportedError`` for a feature
    that has no rule there, ``ProblemError`` for a problem that leaves a needed value open.
    """
    return judge_schedule(problem, plan)[0]


def judge_schedule(problem: Any, plan: Any) -> Judged:
    """Like :func:`validate_schedule`, and also return what was found on the way."""
    decisions, broken = read_decisions(problem, plan)
    if decisions is None or broken:
        return Verdict(tuple(broken), False), None
    verdict, timeline = judge_decisions(problem, decisions)
    found = [v for rule in parts("rules").values() for v in rule(problem, plan)]
    if found:
        verdict = Verdict((*verdict.violations, *found), False)
    return verdict, timeline


def judge_decisions(problem: Any, decisions: Decisions) -> tuple[Verdict, StateTimeline]:
    """Judge what is decided, but for who is to be present (rules 2 to 13)."""
    timeline = build_timeline(problem, decisions)
    common = [
        *_constraints(problem, timeline),
        *timeline.violations,
    ]
    later, at_once = (
        [*_durations(problem, timeline, r), *broken_conditions(problem, timeline, r)]
        for r in Reading
    )
    kept = [*common, *later, *interference(problem, timeline)]
    return Verdict(tuple(kept), definition3=not common and not at_once), timeline


# ------------------------------------------------------------------ presence and variables


def read_decisions(problem: Any, plan: Any) -> tuple[Decisions | None, list[Violation]]:
    """Read presence, times and parameters from a plan (rule 1). ``None`` when names are wrong."""
    found: list[Violation] = []
    known = {a.name: a for a in problem.activities}
    if len(known) < len(problem.activities):
        raise UnsupportedError("activities with equal names")
    counts = Counter(a.name for a in plan.activities)
    for name, count in counts.items():
        if name not in known:
            found.append(Violation("presence", f"{name} is no activity of the problem"))
        elif count > 1:
            found.append(Violation("presence", f"{name} is in the plan {count} times"))
    found += [
        Violation("presence", f"{name} is mandatory but not in the plan")
        for name, activity in known.items()
        if not activity.optional and name not in counts
    ]
    if found:
        return None, found
    objects = objects_by_type(problem)
    assigned = _assignment(plan)
    times: dict[str, tuple[int, int]] = {}
    for name in counts:
        times.update(_times(name, assigned, found))
    parameters: dict[str, Value] = {}
    wanted = list(problem.base_variables)
    wanted += [p for name in counts for p in known[name].parameters]
    for parameter in wanted:
        value = assigned.get(parameter.name, MISSING)
        if value is MISSING:
            found.append(Violation("unassigned", f"parameter {parameter.name} has no value"))
        elif not in_type(value, parameter.type, objects):
            what = f"parameter {parameter.name} = {value} is not of type {parameter.type}"
            found.append(Violation("parameter", what))
        else:
            parameters[parameter.name] = value
    return Decisions(times, parameters, objects), found


def objects_by_type(problem: Any) -> dict[str, tuple[str, ...]]:
    """Return the names of each user type's objects; an object belongs to its type's ancestors."""
    found: dict[str, list[str]] = defaultdict(list)
    for item in problem.all_objects:
        for type_ in item.type.ancestors:
            found[type_.name].append(item.name)
    return {name: tuple(objects) for name, objects in found.items()}


def _assignment(plan: Any) -> dict[Any, Value]:
    """Return the plan's values by ``(kind, activity)`` of timepoints and by name of parameters."""
    values: dict[Any, Value] = {}
    for variable, node in plan.assignment.items():
        is_timepoint = hasattr(variable, "container")
        key = (variable.kind, variable.container) if is_timepoint else variable.name
        values[key] = constant(node)
    return values


def _times(
    name: str, assigned: dict[Any, Value], found: list[Violation]
) -> dict[str, tuple[int, int]]:
    start = assigned.get((TimepointKind.START, name), MISSING)
    end = assigned.get((TimepointKind.END, name), MISSING)
    for what, value in (("start", start), ("end", end)):
        if value is MISSING:
            found.append(Violation("unassigned", f"{name} has no {what}"))
        elif isinstance(value, (bool, str)) or not isinstance(value, int) or value < 0:
            found.append(Violation("time", f"{name}'s {what} {value} is no integer >= 0"))
    if not all(isinstance(v, int) for v in (start, end)):
        return {}
    if end < start:
        found.append(Violation("time", f"{name} ends at {end}, before its start at {start}"))
    return {name: (start, end)}


# ------------------------------------------------------------------ durations and constraints


def _durations(problem: Any, timeline: StateTimeline, reading: Reading) -> Iterator[Violation]:
    """Rule 2."""
    for activity in present_activities(problem, timeline):
        start, end = timeline.decisions.times[activity.name]
        reader = reader_at(timeline, start, reading, activity.name)
        bounds = activity.duration
        low, high = reader.value(bounds.lower), reader.value(bounds.upper)
        length = end - start
        short = low is not MISSING and (length < low or (length == low and bounds.is_left_open()))
        long = high is not MISSING and (
            length > high or (length == high and bounds.is_right_open())
        )
        if short or long:
            what = f"{activity.name} lasts {length}, not within {bounds} (start {start}, end {end})"
            yield Violation("duration", what, about=(activity.name,))


def _constraints(problem: Any, timeline: StateTimeline) -> Iterator[Violation]:
    """Rules 3 to 5."""
    changed = {effect.fluent.fluent().name for _, effect, _ in problem.all_effects()}

    def static(key: Key) -> Value:
        if key[0] in changed:
            raise UnsupportedError(f"fluent {key[0]} in a constraint: effects change it")
        return timeline.initial(key)

    for chronicle, owner in chronicles(problem, timeline.decisions):
        for constraint, scope in chronicle.scoped_constraints:
            reader = Reader(timeline.decisions, static, owner, hasty=True)
            if all(reader.value(s) is True for s in scope) and reader.value(constraint) is False:
                under = f" (scope {list(scope)})" if scope else ""
                by = f" of {owner}" if owner else ""
                what = f"'{constraint}'{under}{by} does not hold{_times_in(constraint, timeline)}"
                yield Violation("constraint", what, node=constraint)


def _times_in(node: Any, timeline: StateTimeline) -> str:
    """Return the times of the activities that an expression mentions, for people."""
    timed = (n.timing() for n in parts_of(node) if n.node_type == OperatorKind.TIMING_EXP)
    names, times = {timing.timepoint.container for timing in timed}, timeline.decisions.times
    shown = [f"{n} [{times[n][0]}, {times[n][1]}]" for n in sorted(names & times.keys())]
    return f": {', '.join(shown)}" if shown else ""
