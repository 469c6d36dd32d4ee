"""What zones ask of a problem that is read: maps where they lie, and straight ways to docks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from up_samp.model import Configuration, Movable, ProblemError, UnsupportedError
from up_samp.model.frames import PlacedMap
from up_samp.model.snapshot import MotionTask, TermKind


def check_docks(
    objects: Mapping[str, Movable],
    configurations: Mapping[str, Configuration],
    tasks: Sequence[MotionTask],
) -> None:
    """Raise where a motion to a dock does not say from where it comes straight to it, or where it
    goes on from there.

    :raises UnsupportedError: where the goal of a motion is decided later, or where it goes on.
    """
    for task in tasks:
        zones = [z for z in objects[task.object].body.kinematics.zones if z.dock]
        if not zones:
            continue
        what = f"activity '{task.activity}': '{task.object}', which has docks,"
        if any(term.kind is not TermKind.CONSTANT for term in task.terms):
            raise UnsupportedError(f"{what} needs named configurations as start and waypoints")
        poses = [configurations[term.name] for term in task.terms]
        for zone in zones:
            if any(zone.binds(pose) for pose in poses[1:-1]):
                raise UnsupportedError(f"{what} goes on from a dock: let the motion end there")
            if zone.binds(poses[-1]) and not zone.leads_in(poses[-2]):
                raise ProblemError(
                    f"{what} has to come straight to {task.terms[-1].name}: give it, as the last "
                    "waypoint before, a pose on the line along that heading where the zone begins"
                )


def check_zones(maps: Sequence[PlacedMap], objects: Mapping[str, Movable]) -> None:
    """Raise where a zone is at a height at which there is no map: it would mean nothing."""
    heights = {placed.height for placed in maps}
    for name, movable in objects.items():
        for zone in movable.body.kinematics.zones:
            if zone.height not in heights:
                raise ProblemError(
                    f"object '{name}': a zone is {zone.height:g} m up, and no map is"
                )
