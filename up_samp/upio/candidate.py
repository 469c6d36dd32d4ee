"""Read a candidate schedule: which motions it wants, from where to where, and when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from unified_planning.model import FNode, Timing
from unified_planning.model.timing import TimepointKind

from up_samp.model import (
    CandidateSchedule,
    ProblemError,
    ScheduledChange,
    ScheduledMotion,
    UnsupportedError,
)
from up_samp.model.snapshot import Snapshot, Term, TermKind
from up_samp.upio.relaxation import Relaxation


@dataclass(frozen=True)
class Itinerary:
    """What a schedule asks of the objects: ``motions`` and ``changes`` in order of time."""

    schedule: CandidateSchedule
    motions: tuple[ScheduledMotion, ...]
    changes: tuple[ScheduledChange, ...]

    def places(self, snapshot: Snapshot, name: str) -> list[tuple[float, str]]:
        """Return ``(since, configuration)`` of object ``name`` over time, in units.

        A move counts from its end on, where it leads.
        """
        events = [(m.end, m.configurations[-1]) for m in self.motions if m.object == name]
        events += [(c.time, c.configuration) for c in self.changes if c.object == name]
        return [(float("-inf"), snapshot.initial[name]), *sorted(events)]

    def place_at(self, snapshot: Snapshot, name: str, time: int) -> str:
        """Return the configuration that object ``name`` has, or is leaving, at ``time`` (units)."""
        return [place for since, place in self.places(snapshot, name) if since <= time][-1]


def read_itinerary(relaxation: Relaxation, schedule: CandidateSchedule) -> Itinerary:
    """Resolve every present motion and change of ``schedule`` to configurations and poses."""
    snapshot = relaxation.snapshot
    motions = []
    for task in snapshot.tasks:
        if task.activity not in schedule.times:
            continue
        start, end = schedule.times[task.activity]
        names = tuple(_resolve(relaxation, schedule, t, task.activity, start) for t in task.terms)
        motions.append(
            ScheduledMotion(
                activity=task.activity,
                constraint=task.index,
                object=task.object,
                configurations=names,
                poses=tuple(snapshot.configurations[n] for n in names),
                start=start,
                end=end,
                avoid=task.avoid,
                static=task.static or frozenset(),
            )
        )
    changes = []
    for change in snapshot.changes:
        if change.activity in schedule.times:
            start, end = schedule.times[change.activity]
            name = _resolve(relaxation, schedule, change.term, change.activity, start)
            pose = snapshot.configurations[name]
            changes.append(ScheduledChange(change.activity, change.object, name, pose, end))
    motions.sort(key=lambda m: (m.start, m.end, m.activity))
    changes.sort(key=lambda c: (c.time, c.activity))
    return Itinerary(schedule, tuple(motions), tuple(changes))


def _resolve(
    relaxation: Relaxation, schedule: CandidateSchedule, term: Term, activity: str, time: int
) -> str:
    if term.kind is TermKind.CONSTANT:
        return term.name
    if term.kind is TermKind.PARAMETER:
        value = schedule.parameters.get(term.name)
        if not isinstance(value, str):
            raise ProblemError(f"activity '{activity}': no value for parameter '{term.name}'")
        return value
    return _fluent_value(relaxation, schedule, term.name, time)


def _fluent_value(relaxation: Relaxation, schedule: CandidateSchedule, text: str, time: int) -> str:
    """Return the object that a ground fluent holds at ``time``: the last assignment before it."""
    problem = relaxation.problem
    best_time, best = -1, None
    initial = next(v for f, v in problem.initial_values.items() if str(f) == text)
    effects = [(t, e, None) for t, e in problem.base_effects]
    effects += [
        (t, e, a.name)
        for a in problem.activities
        if a.name in schedule.times
        for t, group in a.effects.items()
        for e in group
    ]
    for timing, effect, _ in effects:
        if str(_ground(effect.fluent, schedule.parameters)) != text:
            continue
        if effect.is_conditional():
            raise UnsupportedError(
                f"the fluent '{text}' gives a waypoint but has conditional effects"
            )
        at = _evaluate(timing, schedule)
        if best_time < at < time:
            best_time, best = at, effect.value
    value = best if best is not None else initial
    if value.is_parameter_exp():
        return str(schedule.parameters[value.parameter().name])
    if not value.is_object_exp():
        raise UnsupportedError(f"the fluent '{text}' gives a waypoint but is set to '{value}'")
    return str(value.object().name)


def _ground(fluent: FNode, parameters: Mapping[str, object]) -> str:
    arguments = []
    for argument in fluent.args:
        if argument.is_parameter_exp():
            arguments.append(str(parameters[argument.parameter().name]))
        else:
            arguments.append(str(argument))
    name = fluent.fluent().name
    return f"{name}({', '.join(arguments)})" if arguments else name


def _evaluate(timing: Timing, schedule: CandidateSchedule) -> int:
    point = timing.timepoint
    delay = int(timing.delay)
    if point.kind is TimepointKind.GLOBAL_START:
        return delay
    if point.kind is TimepointKind.GLOBAL_END:
        return schedule.makespan + delay
    start, end = schedule.times[point.container]
    return (start if point.kind is TimepointKind.START else end) + delay
