"""Read a candidate schedule: which motions it wants, from where to where, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from up_samp.model import CandidateSchedule, ProblemError, ScheduledChange, ScheduledMotion
from up_samp.model.refinement import Given
from up_samp.model.snapshot import Snapshot, Term, TermKind
from up_samp.upio.relaxation import Relaxation


@dataclass(frozen=True)
class Itinerary:
    """What a schedule asks of the objects: ``motions`` and ``changes`` in order of time."""

    schedule: CandidateSchedule
    motions: tuple[ScheduledMotion, ...]
    changes: tuple[ScheduledChange, ...]

    @property
    def given(self) -> Given:
        """The decisions that all configurations come from."""
        parts = [*(m.given for m in self.motions), *(c.given for c in self.changes)]
        return tuple(sorted({pair for given in parts for pair in given}))

    def places(self, snapshot: Snapshot, name: str) -> list[tuple[float, str]]:
        """Return ``(since, configuration)`` of object ``name`` over time, in units.

        A move counts from its end on, where it leads.
        """
        events = [(m.end, m.configurations[-1]) for m in self.motions if m.object == name]
        events += [(m.end, place) for m in self.motions for load, place in m.loads if load == name]
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
        names, given = _resolve(relaxation, schedule, task.activity, task.terms)
        goals = [ride.goal for ride in task.rides]
        put, _ = _resolve(relaxation, schedule, task.activity, goals)
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
                given=given,
                loads=tuple((r.load, p) for r, p in zip(task.rides, put, strict=True)),
            )
        )
    changes = []
    for change in snapshot.changes:
        if change.activity in schedule.times:
            _, end = schedule.times[change.activity]
            terms = (change.term,)
            (name,), given = _resolve(relaxation, schedule, change.activity, terms, at_end=True)
            pose = snapshot.configurations[name]
            changes.append(ScheduledChange(change.activity, change.object, name, pose, end, given))
    motions.sort(key=lambda m: (m.start, m.end, m.activity))
    changes.sort(key=lambda c: (c.time, c.activity))
    return Itinerary(schedule, tuple(motions), tuple(changes))


def _resolve(
    relaxation: Relaxation,
    schedule: CandidateSchedule,
    activity: str,
    terms: Sequence[Term],
    *,
    at_end: bool = False,
) -> tuple[tuple[str, ...], Given]:
    """Return the terms' configurations, and the decisions that they come from."""
    names, given = [], {}
    for term in terms:
        if term.kind is TermKind.CONSTANT:
            names.append(term.name)
            continue
        choice = relaxation.choices[activity, term, at_end]
        if choice.variable is None:
            names.append(choice.values[0])
            continue
        value = schedule.parameters.get(choice.variable)
        if not isinstance(value, str):
            raise ProblemError(f"activity '{activity}': no value for '{term.name}'")
        names.append(value)
        given[choice.variable] = value
    return tuple(names), tuple(sorted(given.items()))
