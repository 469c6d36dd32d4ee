"""What zones ask of a problem that is read: maps where they lie, and straight ways to docks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from up_samp.model import Configuration, Movable, ProblemError, UnsupportedError
from up_samp.model.frames import PlacedMap
from up_samp.model.snapshot import MotionTask, TermKind


def check_docks(
    objects: Mapping[str, Movable],
    configurations: Mapping[str, Configuration],
    maps: Sequence[PlacedMap],
    tasks: Sequence[MotionTask],
) -> None:
    """Check motions on maps with docks.

    :raises ProblemError: where one does not say from where it comes straight to a dock.
    :raises UnsupportedError: where it goes on from there, or any of its poses is decided later.
    """
    for task in tasks:
        zones = [
            zone
            for zone in objects[task.object].body.kinematics.zones
            if zone.dock and zone.height == maps[task.map].height
        ]
        if not zones:
            continue
        what = f"activity '{task.activity}': '{task.object}', which has docks,"
        if any(term.kind is not TermKind.CONSTANT for term in task.terms):
            raise UnsupportedError(f"{what} needs named configurations as start and waypoints")
        poses = [configurations[term.name] for term in task.terms]
        for zone in zones:
            if any(zone.binds(pose) for pose in poses[1:-1]):
                raise UnsupportedError(f"{what} goes on from a dock: let the motion end there")
            begins = len(poses) == 2 or abs(zone.off_dock(poses[-2])[0]) > zone.long - 1e-4
            if zone.binds(poses[-1]) and not (begins and zone.leads_in(poses[-2])):
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
