"""Judge the schedule part of a plan: presence, durations, constraints, effects, conditions;
interference: nobody changes what another one reads or writes; and what it is worth by the
problem's quality metrics.

The numbered rules in comments are those of ``docs/semantics.md``.
"""

from __future__ import annotations

import math
import operator
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unified_planning.model import OperatorKind, TimepointKind, metrics

from up_samp.extensions import parts
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.objective import Cost, MinimizeCosts
from up_samp.model.violation import Violation
from up_samp.validation.timeline import (
    MISSING,
    Change,
    Decisions,
    Key,
    Reader,
    Reading,
    StateTimeline,
    Value,
    build_timeline,
    chronicles,
    constant,
    in_type,
    parts_of,
    plain,
    present_activities,
    reader_at,
    show,
    telling,
)


@dataclass(frozen=True)
class Verdict:
    """All violations found. ``definition3`` tells whether the plan also holds (everything else
    being in order) when an effect at ``t`` is seen at ``t``, as in the SAMP paper's Definition 3.
    """

    violations: tuple[Violation, ...]
    definition3: bool

    @property
    def valid(self) -> bool:
        """Whether no rule is broken (under the PDDL 2.1 reading of effects and conditions)."""
        return not self.violations


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
        elif type(value) is not int or value < 0:
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
        from_low = operator.gt if bounds.is_left_open() else operator.ge
        to_high = operator.lt if bounds.is_right_open() else operator.le
        enough = low is MISSING or from_low(length, low)
        if not (enough and (high is MISSING or to_high(length, high))):
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


# ------------------------------------------------------------------ conditions and interference


@dataclass(frozen=True)
class _Condition:
    """A timed condition of an activity (``owner``) or of the problem, over integer instants.

    ``seen`` is the last instant whose value it needs: ``last + 1`` for a half-open interval, in
    whose last unit an effect at ``last`` is seen.
    """

    owner: str | None
    node: Any
    first: int
    last: int
    seen: int

    @property
    def what(self) -> str:
        over = f"at {self.first}" if self.first == self.last else f"over {self.first}..{self.last}"
        return f"condition '{self.node}' of {self.owner or 'the problem'} {over}"


def _timed_conditions(
    problem: Any, timeline: StateTimeline, reading: Reading
) -> Iterator[_Condition]:
    """Rules 10, 12 and 13: each condition with its first and last instant."""
    for chronicle, owner in chronicles(problem, timeline.decisions):
        for interval, nodes in chronicle.conditions.items():
            found = _instants(interval, owner, timeline, reading)
            if found is not None and found[0] <= found[1]:
                yield from (_Condition(owner, node, *found) for node in nodes)


def _instants(
    interval: Any, owner: str | None, timeline: StateTimeline, reading: Reading
) -> tuple[int, int, int] | None:
    """Return an interval's first, last, and last seen instant (None: it hangs on an absent one)."""
    end = timeline.global_end(reading)
    first = timeline.decisions.timing(interval.lower, owner, end)
    last = timeline.decisions.timing(interval.upper, owner, end)
    if MISSING in (first, last):
        return None
    step = timeline.decisions.instant
    if step == 1 and not (isinstance(first, int) and isinstance(last, int)):
        raise UnsupportedError(f"fractional time in the condition interval {interval}")
    last -= interval.is_right_open() * step
    half_open = interval.is_right_open() and reading is Reading.LATER
    return first + interval.is_left_open() * step, last, last + half_open * step


def _new_values(timeline: StateTimeline, reading: Reading) -> dict[str, set[int]]:
    """Return for each fluent's name the instants at which a new value is seen first."""
    times_of: dict[str, set[int]] = defaultdict(set)
    for change in timeline.changes:
        later = reading is Reading.LATER
        seen = change.time + timeline.decisions.instant if later else change.time
        times_of[change.key[0]].add(seen)
    return times_of


def broken_conditions(
    problem: Any, timeline: StateTimeline, reading: Reading
) -> Iterator[Violation]:
    """Rule 9 and 10: every condition holds at every instant of its interval."""
    times_of = _new_values(timeline, reading)
    for condition in _timed_conditions(problem, timeline, reading):
        instant = _first_failure(condition, timeline, reading, times_of)
        if instant is not None:
            text = f"{condition.what} is false at {instant}"
            about = tuple(sorted(_fluents_in(condition.node)))
            yield Violation("condition", text, about=about)


def _first_failure(
    condition: _Condition,
    timeline: StateTimeline,
    reading: Reading,
    times_of: Mapping[str, set[int]],
    *,
    surely: bool = False,
) -> int | None:
    """Return the first instant at which a condition is false (``surely``: not true). Looking at the
    first instant and where a fluent that it mentions gets a new value is enough.
    """
    instants = {condition.first}
    for name in _fluents_in(condition.node):
        new = times_of.get(name, set())
        instants |= {t for t in new if condition.first < t <= condition.seen}
    for instant in sorted(instants):
        reader = reader_at(timeline, instant, reading, condition.owner)
        value = reader.value(condition.node)
        failed = value is not True if surely else value is False
        if failed:
            return instant
    return None


def holds_throughout(interval: Any, node: Any, timeline: StateTimeline, reading: Reading) -> bool:
    """Return whether an expression is true at every instant of a global time interval (of a
    half-open one as a condition: also what is seen in its last unit).
    """
    found = _instants(interval, None, timeline, reading)
    if found is None:
        return False
    if found[0] > found[1]:
        return True
    condition = _Condition(None, node, *found)
    new = _new_values(timeline, reading)
    return _first_failure(condition, timeline, reading, new, surely=True) is None


def interference(problem: Any, timeline: StateTimeline) -> Iterator[Violation]:
    """Rule 11: an activity's effects keep apart from what other activities read."""
    by_name: dict[str, list[Change]] = defaultdict(list)
    for change in timeline.changes:
        if change.owner is not None:
            by_name[change.key[0]].append(change)
    for condition in _timed_conditions(problem, timeline, Reading.LATER):
        if condition.owner is None:
            continue
        for name in sorted(_fluents_in(condition.node)):
            for change in by_name[name]:
                if change.owner == condition.owner:
                    continue
                if not condition.first <= change.time <= condition.last:
                    continue
                reader = reader_at(timeline, change.time, Reading.LATER, condition.owner)
                reader.value(condition.node)
                if change.key in reader.reads:
                    yield _clash(change, condition.what)
    yield from _other_interference(problem, timeline, by_name)


def _other_interference(
    problem: Any, timeline: StateTimeline, by_name: dict[str, list[Change]]
) -> Iterator[Violation]:
    """Rule 11 for what effects, durations and motions read."""
    readings = [(time, time, by, keys, what) for time, by, keys, what in timeline.effect_reads]
    step = timeline.decisions.instant
    for activity in present_activities(problem, timeline):
        start, end = timeline.decisions.times[activity.name]
        for first, last, told, nodes in _read_by(activity, start, end, step):
            reader = reader_at(timeline, first, Reading.LATER, activity.name)
            for node in nodes:
                reader.value(node)
            what = f"the {told} of {activity.name}, read at {first}"
            readings.append((first, last, activity.name, frozenset(reader.reads), what))
    for first, last, owner, keys, what in readings:
        for change in (c for key in sorted(keys, key=str) for c in by_name[key[0]]):
            read = first <= change.time <= last and change.key in keys
            if read and owner is not None and change.owner != owner:
                yield _clash(change, what)


def _read_by(
    activity: Any, start: Any, end: Any, step: Any
) -> Iterator[tuple[Any, Any, str, list[Any]]]:
    """Yield what else an activity reads, and from when to when (rules 2, 14 and 19)."""
    yield start, start, "duration", [activity.duration.lower, activity.duration.upper]
    for constraint in getattr(activity, "motion_constraints", ()):
        yield start, start, "motion", [constraint.starting, *constraint.waypoints]
        still = constraint.static_obstacles
        told = [telling(still[item], item) for item in still] if isinstance(still, dict) else []
        yield start, max(start, end - 2 * step), "static obstacles", told
    yield end, end, "motion effect", list(getattr(activity, "motion_effects", {}).values())


def _clash(change: Change, what: str) -> Violation:
    return Violation(
        "interference",
        f"{change.what} changes {show(change.key)}, which the {what.removeprefix('the ')} reads",
        about=(show(change.key),),
    )


def _fluents_in(node: Any) -> set[str]:
    """Return the names of all fluents that an expression mentions."""
    return {item.fluent().name for item in parts_of(node) if item.is_fluent_exp()}


# ------------------------------------------------------------------ quality metrics


def evaluate_metric(metric: Any, timeline: StateTimeline) -> Value:
    """Return the value of ``metric``: the makespan is the latest end of a present activity; values
    of fluents and goals are those after all effects.
    """
    for objective in parts("objectives").values():
        if type(metric) is objective.metric:
            return objective.judged(metric, timeline)
    for kind, value in _VALUES.items():
        if isinstance(metric, kind):
            return value(metric, timeline)
    raise UnsupportedError(f"the metric '{metric}' has no meaning for schedules")


def _final(timeline: StateTimeline, owner: str | None = None) -> Reader:
    """Return what reads expressions after all effects."""
    return reader_at(timeline, timeline.horizon + 1, Reading.LATER, owner)


def _of_costs(metric: MinimizeCosts, timeline: StateTimeline) -> Value:
    """Return what is minimised of costs: infinite, where a limited one is above its limit."""
    told = [_sum(costs, timeline) for costs in map(metric.of_rank, range(len(metric.limits) + 1))]
    over = any(value > most for value, most in zip(told, metric.limits, strict=False))
    return math.inf if over else told[-1]


def _sum(costs: Iterable[Cost], timeline: StateTimeline) -> Value:
    return plain(sum(value for _, value in _terms(costs, timeline)))


def _terms(costs: Iterable[Cost], timeline: StateTimeline) -> Iterator[tuple[str, Value]]:
    """Yield each cost that counts, by its term: weighted values after all effects, and the largest
    of those sums that are shares.
    """
    shares: dict[str, dict[str, Value]] = {}
    for cost in costs:
        if cost.activity is None or cost.activity in timeline.decisions.times:
            value = _final(timeline, cost.activity).value(cost.node)
            if cost.node.type.is_bool_type():  # what an absent activity leaves open does not hold
                value = int(value is True)
            worth = cost.weight * (max(0, value) if cost.positive else value)
            if cost.share:
                sums = shares.setdefault(cost.term, {})
                sums[cost.share] = sums.get(cost.share, 0) + worth
            else:
                yield cost.term, plain(worth)
    yield from ((term, plain(max(0, *sums.values()))) for term, sums in shares.items())


def _costs(metric: Any, timeline: StateTimeline) -> Iterator[Value]:
    """Yield what each present activity costs, by fluents as they were at first."""
    if metric.default is None:
        raise UnsupportedError(f"the metric '{metric}' says not what an activity costs: by default")
    for name in timeline.decisions.times:
        yield Reader(timeline.decisions, timeline.initial, name).value(metric.default)


def _goals(metric: Any, timeline: StateTimeline) -> Value:
    """Return what the goals that are reached in the end are worth."""
    final = _final(timeline)
    return plain(sum(gain for goal, gain in metric.goals.items() if final.value(goal) is True))


def _timed_goals(metric: Any, timeline: StateTimeline) -> Value:
    """Return what the goals are worth that hold all through their times."""
    reached = (
        gain
        for (interval, goal), gain in metric.goals.items()
        if holds_throughout(interval, goal, timeline, Reading.LATER)
    )
    return plain(sum(reached))


def _at_end(metric: Any, timeline: StateTimeline) -> Value:
    return _final(timeline).value(metric.expression)


_VALUES: Mapping[Any, Callable[[Any, StateTimeline], Value]] = {
    metrics.MinimizeMakespan: lambda _, timeline: timeline.decisions.makespan,
    MinimizeCosts: _of_costs,
    metrics.MinimizeExpressionOnFinalState: _at_end,
    metrics.MaximizeExpressionOnFinalState: _at_end,
    metrics.Oversubscription: _goals,
    metrics.TemporalOversubscription: _timed_goals,
    metrics.MinimizeActionCosts: lambda metric, timeline: plain(sum(_costs(metric, timeline))),
}
"""Values by the kind of metric."""


def terms_of(problem: Any, plan: Any) -> dict[str, Value]:
    """Return what a schedule costs by term, where the problem's metric is a sum of costs."""
    metric = problem.quality_metrics[0]
    found = dict.fromkeys((cost.term for cost in metric.costs), 0)
    timeline = _timeline_of(problem, plan)
    # shares of a term are compared within a rank: one sum at a time
    for costs in map(metric.of_rank, range(len(metric.ranks))):
        for term, value in _terms(costs, timeline):
            found[term] = plain(found[term] + value)
    return found


def ranked(problem: Any, plan: Any) -> list[Value]:
    """Return what a schedule costs by rank, where the problem's metric is a sum of costs."""
    metric, timeline = problem.quality_metrics[0], _timeline_of(problem, plan)
    return [_sum(metric.of_rank(number), timeline) for number, _ in enumerate(metric.ranks)]


def value_of(problem: Any, plan: Any) -> Value:
    """Return the value of the problem's (only) metric for a schedule."""
    return evaluate_metric(problem.quality_metrics[0], _timeline_of(problem, plan))


def _timeline_of(problem: Any, plan: Any) -> StateTimeline:
    decisions, wrong = read_decisions(problem, plan)
    if decisions is None:
        raise ProblemError(f"this is no schedule of the problem: {wrong[0]}")
    return build_timeline(problem, decisions)
