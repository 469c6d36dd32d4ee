"""From a failed motion check to refinements: one pure function a rule.

The rules of the paper (RCOND, CHCONF, CHTIME) and their smaller relatives. Times are in schedule
units. Each function returns what to tell the scheduler, with its strength and its reason.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import starmap

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import (
    Absent,
    Apart,
    Clause,
    Differs,
    Elsewhere,
    Exclusive,
    Given,
    Lasts,
    Layer,
    Literal,
    Overlap,
    Refinement,
    Requires,
    Strength,
    TimeRef,
    end_of,
    start_of,
)


def only_given(refinement: Refinement, given: Given) -> Refinement:
    """Return a statement that gives way when one of the decisions it was found for differs."""
    if not given:
        return refinement
    statement = refinement.statement
    if isinstance(statement, Lasts):
        activity, units = statement.activity, statement.at_least
        longer = Apart(start_of(activity), end_of(activity), units)
        literals: tuple[Literal, ...] = (Absent(activity), longer)
    else:
        assert isinstance(statement, Clause), f"{statement} cannot depend on decisions"
        literals = statement.literals
    return replace(refinement, statement=Clause((*literals, *differs(given))))


def differs(given: Given) -> list[Literal]:
    """State that one of the decisions is another."""
    return list(starmap(Differs, given))


def other_motions(motions: Iterable[ScheduledMotion]) -> list[Literal]:
    """State that one of the motions is not made, or not between these configurations."""
    literals: dict[Literal, None] = {}
    for motion in motions:
        literals[Absent(motion.activity)] = None
        literals.update(dict.fromkeys(differs(motion.given)))
    return list(literals)


def elsewhen(reference: TimeRef, point: TimeRef, offset: int) -> list[Literal]:
    """State that a timepoint is not ``offset`` units after a reference."""
    return [Apart(point, reference, 1 - offset), Apart(reference, point, offset + 1)]


def impossible(activity: str, why: str, layer: Layer = Layer.GEOMETRIC) -> Refinement:
    """State that an activity can never be (of a motion: the map alone forbids it)."""
    return Refinement(Clause((Absent(activity),)), layer, Strength.PROVEN, why)


def lasts(
    activity: str,
    units: int,
    why: str,
    *,
    layer: Layer = Layer.BOUND,
    strength: Strength = Strength.PROVEN,
) -> Refinement:
    """State that a motion takes at least ``units``."""
    return Refinement(Lasts(activity, units), layer, strength, why)


def not_all_there(arrivals: Sequence[str], departures: Sequence[str], why: str) -> Refinement:
    """State that objects do not rest at one time where ``arrivals`` bring them and others are from
    the beginning: one does not come, or sets off (``departures``) before all are there.
    """
    left = itertools.product(dict.fromkeys(departures), dict.fromkeys(arrivals))
    literals: tuple[Literal, ...] = (
        *(Absent(activity) for activity in dict.fromkeys(arrivals)),
        *(Apart(start_of(gone), end_of(come), 0) for gone, come in left),
    )
    return Refinement(Clause(literals), Layer.GEOMETRIC, Strength.PROVEN, why)


def needs_away(
    activity: str, obstacle: str, configuration: str, why: str, *, at_end: bool = False
) -> Refinement:
    """State that a static obstacle must be elsewhere all the time, or that any must be in the end
    (right only where nothing brings it back there, see :func:`blocked_while`).
    """
    statement = Requires(activity, obstacle, configuration, at_end)
    return Refinement(statement, Layer.GEOMETRIC, Strength.PROVEN, why)


def gone_before(point: TimeRef, changes: Iterable[str], units: int, why: str) -> Refinement:
    """State that an obstacle has gone ``units`` before an activity's start or end.

    Right where it is in the way at first and nothing brings it back there: then it has gone when
    any of ``changes``, the activities that set it elsewhere, has ended. Unlike a condition on its
    place this does not keep further changes of it apart from the activity.
    """
    literals: list[Literal] = [Absent(point.activity)]
    literals += [Apart(end_of(c), point, units) for c in sorted(changes) if c != point.activity]
    return Refinement(Clause(tuple(literals)), Layer.GEOMETRIC, Strength.PROVEN, why)


def blocked_while(
    activity: str,
    blockers: Mapping[str, str],
    movers: Mapping[str, Iterable[str]],
    why: str,
    *,
    strength: Strength = Strength.PROVEN,
) -> Refinement:
    """State that a motion cannot be made while all ``blockers`` rest (object -> configuration).

    Some blocker must be elsewhere, or some activity that moves one (``movers``) must overlap.
    This is RCOND -> CHCONF with only the rivals that matter.
    """
    literals: list[Literal] = [Absent(activity)]
    for obstacle, configuration in sorted(blockers.items()):
        literals.append(Elsewhere(activity, obstacle, configuration))
        literals += _in_between((activity,), movers[obstacle])
    return Refinement(Clause(tuple(literals)), Layer.GEOMETRIC, strength, why)


def slower_while(
    activity: str,
    units: int,
    blockers: Mapping[str, str],
    movers: Mapping[str, Iterable[str]],
    why: str,
    *,
    strength: Strength = Strength.RELATIVE,
) -> Refinement:
    """State that a motion takes ``units`` while all ``blockers`` rest where they are."""
    base = blocked_while(activity, blockers, movers, why, strength=strength)
    return unless_longer(base, activity, units)


def unless_longer(cut: Refinement, activity: str, units: int) -> Refinement:
    """Return a motion's geometric cut as a temporal one, that gives way if it lasts ``units``."""
    assert isinstance(cut.statement, Clause)
    longer = Apart(start_of(activity), end_of(activity), units)
    return replace(cut, statement=Clause((*cut.statement.literals, longer)), layer=Layer.TEMPORAL)


def unary_place(
    name: str,
    arrivals: Iterable[str],
    departures: Iterable[str],
    taken: bool,
    leaving: Iterable[tuple[str, str, str]] = (),
    coming: Iterable[tuple[str, str, str]] = (),
) -> Refinement:
    """State that poses which overlap can hold only one object at a time."""
    statement = Exclusive(
        name,
        frozenset(arrivals),
        frozenset(departures),
        taken,
        frozenset(leaving),
        frozenset(coming),
    )
    why = "objects that rest at these configurations would overlap"
    return Refinement(statement, Layer.BOUND, Strength.PROVEN, why)


def handed_over(
    leaving: str, coming: str, units: int, why: str, *, strength: Strength
) -> Refinement:
    """State that ``coming`` ends ``units`` after the start of ``leaving``, which gives the place
    free, or before that.
    """
    literals = (
        Absent(leaving),
        Absent(coming),
        Apart(start_of(leaving), end_of(coming), units),
        Apart(end_of(coming), start_of(leaving), 1),
    )
    return Refinement(Clause(literals), Layer.BOUND, strength, why)


def group_timing(
    motions: Sequence[ScheduledMotion],
    arrivals: Mapping[str, int],
    blockers: Mapping[str, str],
    movers: Mapping[str, Iterable[str]],
    why: str,
    *,
    rivals: Iterable[str] = (),
) -> Refinement:
    """Return CHTIME for a small group: as timed, some late motion must end later. Heuristic.

    ``arrivals`` are the late motions' needed ends in units after the first start. The cut gives
    way when an offset changes, except that a single late motion does not arrive earlier by
    starting later, and when a motion that is in time gets longer: it may give way then.
    ``blockers`` rest in the way; the cut gives way when one may have moved. ``rivals`` are other
    motions of the group's own objects: it gives way, too, when one of them comes in between, for
    an object may then arrive later or drive on sooner.
    """
    reference = min(motions, key=lambda m: (m.start, m.activity))
    only_late = next(iter(arrivals)) if len(arrivals) == 1 else None
    literals = other_motions(motions)
    for motion in motions:
        if motion is reference:
            continue
        offset = motion.start - reference.start
        earlier, later = start_of(reference.activity), start_of(motion.activity)
        literals.append(Apart(later, earlier, 1 - offset))
        if motion.activity != only_late:
            literals.append(Apart(earlier, later, offset + 1))
    for name, units in sorted(arrivals.items()):
        literals.append(Apart(start_of(reference.activity), end_of(name), units))
    for motion in motions:
        if motion.activity not in arrivals:
            longer = motion.end - reference.start + 1
            literals.append(Apart(start_of(reference.activity), end_of(motion.activity), longer))
    names = tuple(m.activity for m in motions)
    literals += _in_between(names, rivals)
    literals += _moved_away(names, blockers, movers)
    return Refinement(Clause(tuple(literals)), Layer.GROUP, Strength.HEURISTIC, why)


def group_fails(
    motions: Sequence[ScheduledMotion],
    blockers: Mapping[str, str],
    movers: Mapping[str, Iterable[str]],
    why: str,
) -> Refinement:
    """State that a group found no trajectories as timed: some offset or end must change.

    Nothing is proven by a search that ran out of time, so the cut is heuristic and narrow.
    """
    reference = min(motions, key=lambda m: (m.start, m.activity))
    literals = other_motions(motions)
    for motion in motions:
        earlier, later = start_of(reference.activity), start_of(motion.activity)
        if motion is not reference:
            offset = motion.start - reference.start
            literals += elsewhen(earlier, later, offset)
        finish = motion.end - reference.start
        literals.append(Apart(earlier, end_of(motion.activity), finish + 1))
    names = tuple(m.activity for m in motions)
    literals += _moved_away(names, blockers, movers)
    return Refinement(Clause(tuple(literals)), Layer.GROUP, Strength.HEURISTIC, why)


def not_together(
    motions: Sequence[ScheduledMotion],
    blockers: Mapping[str, str],
    movers: Mapping[str, Iterable[str]],
    why: str,
) -> Refinement:
    """State that motions which found no trajectories at several offsets do not all go at once:
    one of them ends before another begins. Heuristic, as :func:`group_fails`.
    """
    names = tuple(m.activity for m in motions)
    literals = other_motions(motions)
    literals += [
        Apart(end_of(a.activity), start_of(b.activity), 0)
        for a, b in itertools.product(motions, repeat=2)
        if a.object != b.object
    ]
    literals += _moved_away(names, blockers, movers)
    return Refinement(Clause(tuple(literals)), Layer.GROUP, Strength.HEURISTIC, why)


def _moved_away(
    names: tuple[str, ...], blockers: Mapping[str, str], movers: Mapping[str, Iterable[str]]
) -> list[Literal]:
    """State that some blocker is elsewhere, or that something moves it meanwhile."""
    literals: list[Literal] = []
    for obstacle, configuration in sorted(blockers.items()):
        literals += [Elsewhere(n, obstacle, configuration) for n in names]
        literals += _in_between(names, movers[obstacle])
    return literals


def _in_between(names: tuple[str, ...], rivals: Iterable[str]) -> list[Literal]:
    """State that some rival of activities overlaps with them."""
    return [Overlap(r, names) for r in sorted(rivals) if r not in names]


# ------------------ The refinements of the paper, as it states them: RCOND, CHCONF and CHTIME
# They speak of a whole group in the order in which it failed.


def paper_condition(motions: Sequence[ScheduledMotion], rivals: Iterable[str]) -> list[Literal]:
    """Return the negation of RCOND(G): the ways in which the paper's cut does not apply.

    Some activity of the group absent or between other configurations, the first motion of an
    object not first, or a rival that overlaps the group.
    """
    literals = other_motions(motions)
    for name in sorted({m.object for m in motions}):
        own = sorted((m for m in motions if m.object == name), key=lambda m: m.start)
        literals += [Apart(start_of(m.activity), end_of(own[0].activity), 1) for m in own[1:]]
    names = tuple(m.activity for m in motions)
    return literals + _in_between(names, rivals)


def paper_geometric(
    motions: Sequence[ScheduledMotion],
    rivals: Iterable[str],
    blockers: Mapping[str, str],
) -> Clause:
    """Return the paper's geometric refinement: RCOND(G) -> some blocker changes (CHCONF): another
    object is not at its place while one of the motions happens.
    """
    pairs = itertools.product(motions, sorted(blockers.items()))
    elsewhere = [Elsewhere(m.activity, o, c) for m, (o, c) in pairs if o != m.object]
    return Clause((*paper_condition(motions, rivals), *elsewhere))


def paper_temporal(
    motions: Sequence[ScheduledMotion],
    rivals: Iterable[str],
    arrivals: Mapping[str, int],
    places: Mapping[str, str],
) -> Clause:
    """Return the paper's temporal refinement: RCOND(G) -> CHTIME.

    ``arrivals``: needed ends of the late motions after the group's first start; ``places``:
    where every other object that may move is.
    """
    reference = min(motions, key=lambda m: (m.start, m.activity))
    begin = start_of(reference.activity)
    later = (m for m in motions if m is not reference)
    sooner = [Apart(start_of(m.activity), begin, 1 - m.start + reference.start) for m in later]
    longer = [Apart(begin, end_of(name), units) for name, units in sorted(arrivals.items())]
    return Clause((*paper_geometric(motions, rivals, places).literals, *sooner, *longer))


# ------------------ Exact cuts for a schedule as it is timed: the last resorts
# A schedule can slip through the general rules where a change of an obstacle just touches a
# motion's start or end. These cuts give way only when something that matters is elsewhere in the
# order of things. Times are in schedule units.


def blocked_as_timed(
    motion: ScheduledMotion,
    set_by: Mapping[str, str | None],
    changes: Mapping[str, Mapping[str, int]],
    why: str,
    *,
    rides: Collection[str] = (),
    strength: Strength = Strength.PROVEN,
) -> Refinement:
    """State that a motion cannot be made while obstacles rest as they do in this schedule.

    ``set_by`` tells which change (activity) set each obstacle where it is (``None``: it is there
    from the first), ``changes`` at what time each obstacle's present and absent (-1) other
    changes happen. Those of ``rides`` take an obstacle away at their start, all others at their
    end. The cut gives way only when one of them comes in between, so that it rejects the schedule
    also where a change touches the motion's start or end. Where configurations hang
    on decisions, it holds under these only (see ``only_given``).
    """
    start, end = start_of(motion.activity), end_of(motion.activity)
    literals: list[Literal] = [Absent(motion.activity)]
    for obstacle, setter in sorted(set_by.items()):
        if setter is not None:
            literals += [Absent(setter), Apart(start, end_of(setter), 1)]
        for other, time in sorted(changes[obstacle].items()):
            if other == setter:
                continue
            if setter is not None and 0 <= time <= motion.start:
                literals.append(Apart(end_of(setter), end_of(other), 1))
            else:
                away = start_of(other) if other in rides else end_of(other)
                literals.append(Apart(away, end, 1))
    return Refinement(Clause(tuple(literals)), Layer.GEOMETRIC, strength, why)


def as_timed(
    motions: Sequence[ScheduledMotion],
    arrivals: Mapping[str, int],
    drives: Mapping[str, tuple[int, int] | None],
    changes: Mapping[str, tuple[str, int | None]],
    why: str,
) -> Refinement:
    """State that a group does not work just as it is timed: the last resort, it always rejects
    (under the decisions that the configurations hang on, see ``only_given``).

    ``arrivals`` are the late motions' needed ends in units after the first start (none: the group
    found no trajectories). ``drives`` are the times of all other motion activities, ``changes``
    the objects and times of all instantaneous changes (``None``: absent). The cut gives way when
    any of them comes, or moves to the other side of the group or of another change of its object.
    """
    reference = min(motions, key=lambda m: (m.start, m.activity))
    begin, final = start_of(reference.activity), max(motions, key=lambda m: (m.end, m.activity))
    literals: list[Literal] = [Absent(m.activity) for m in motions]
    for motion in motions:
        if motion is not reference:
            literals += elsewhen(begin, start_of(motion.activity), motion.start - reference.start)
        needed = arrivals.get(motion.activity, motion.end - reference.start + 1)
        literals.append(Apart(begin, end_of(motion.activity), needed))
    last = end_of(final.activity)
    for name, times in sorted(drives.items()):
        if times is None:
            literals.append(Apart(start_of(name), end_of(name), 0))
        elif times[1] < reference.start:
            literals += [Absent(name), Apart(begin, end_of(name), 0)]
        else:
            literals += [Absent(name), Apart(start_of(name), last, 0)]
    for name, (thing, time) in sorted(changes.items()):
        if time is None:
            literals.append(Apart(start_of(name), end_of(name), 0))
            continue
        literals.append(Absent(name))
        if time <= reference.start:
            literals.append(Apart(begin, end_of(name), 1))
            literals += [
                Apart(end_of(name), end_of(other), 1)
                for other, (same, before) in sorted(changes.items())
                if same == thing and before is not None and before < time
            ]
        elif time >= final.end:
            literals.append(Apart(end_of(name), last, 1))
        else:
            literals += elsewhen(begin, end_of(name), time - reference.start)
    return Refinement(Clause(tuple(literals)), Layer.GROUP, Strength.HEURISTIC, why)


def set_onto(
    change: str,
    setter: str | None,
    moves: Mapping[str, tuple[int, int] | None],
    sets: Mapping[str, tuple[int, int] | None],
    why: str,
) -> Refinement:
    """State that ``change`` must not set something to where another object rests: *proven*.

    ``setter`` is the activity that brought the other object there (``None``: it is there from the
    first), ``moves`` and ``sets`` are the times of all activities that drive it and that set it
    elsewhere (``None``: absent). The cut gives way when one of them takes the object away between
    the setter's end and the change's: what is set elsewhere in the same instant is gone by then,
    what drives off then is not.
    """
    end = end_of(change)
    literals: list[Literal] = [Absent(change)]
    if setter is not None:
        literals += [Absent(setter), Apart(end, end_of(setter), 1)]
    leaving = [(start_of(m), m, t and t[0], 1) for m, t in sorted(moves.items())]
    leaving += [(end_of(s), s, t and t[1], 0) for s, t in sorted(sets.items())]
    since = None
    if setter is not None:
        times = {**sets, **moves}[setter]
        since = None if times is None else times[1]
    for point, name, time, units in leaving:
        if name in (setter, change):
            continue
        if setter is not None and since is not None and time is not None and time < since:
            literals.append(Apart(end_of(setter), point, 0))
        else:
            literals.append(Apart(point, end, units))
    return Refinement(Clause(tuple(literals)), Layer.GEOMETRIC, Strength.PROVEN, why)


def exactly_as_timed(times: Mapping[str, tuple[int, int]], why: str) -> Refinement:
    """State that activities do not go together just as they are timed: some offset or end must
    change, or one of them must be absent. *Heuristic*; it always rejects the schedule.
    """
    literals: list[Literal] = [Absent(name) for name in times]
    reference = min(times, key=lambda n: (times[n], n))
    begin, at = start_of(reference), times[reference][0]
    for name, (start, end) in sorted(times.items()):
        if name != reference:
            literals += elsewhen(begin, start_of(name), start - at)
        literals += elsewhen(begin, end_of(name), end - at)
    return Refinement(Clause(tuple(literals)), Layer.GROUP, Strength.HEURISTIC, why)
