"""Exact cuts for a schedule as it is timed: the last resorts, they always reject it.

A schedule can slip through the general rules where a change of an obstacle just touches a motion's
start or end. These cuts give way only when something that matters is elsewhere in the order of
things. Times are in schedule units.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import (
    Absent,
    Apart,
    Clause,
    Layer,
    Literal,
    Refinement,
    Strength,
    end_of,
    start_of,
)
from up_samp.refinement.rules import elsewhen


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
    on decisions, it holds under these only (see ``rules.only_given``).
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
    *,
    strength: Strength,
) -> Refinement:
    """State that a group does not work just as it is timed: the last resort, it always rejects
    (under the decisions that the configurations hang on, see ``rules.only_given``).

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
    return Refinement(Clause(tuple(literals)), Layer.GROUP, strength, why)


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
