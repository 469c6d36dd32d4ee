"""Check where everything is at the start, before any search."""

from __future__ import annotations

from up_samp.model import Configuration, Placed, ProblemError
from up_samp.model.snapshot import Snapshot
from up_samp.motion import MotionService


def check_start_poses(snapshot: Snapshot, service: MotionService) -> None:
    """Raise :class:`ProblemError` where a robot starts in a wall or in another object."""
    drivers = sorted({t.object for t in snapshot.tasks})
    for name in drivers:
        body = snapshot.objects[name].body
        pose = snapshot.configurations[snapshot.initial[name]]
        in_wall, _ = service.pose_blockers(body, pose, ())
        if in_wall:
            raise ProblemError(
                f"object '{name}' starts at '{snapshot.initial[name]}' {_show(pose)}, which is in "
                f"a wall or outside the map '{snapshot.map_file}'"
            )
        heeded = _heeded(snapshot, name)
        others = tuple(
            Placed(o, snapshot.objects[o].body, snapshot.configurations[place])
            for o, place in snapshot.initial.items()
            if o != name and (heeded is None or o in heeded)
        )
        _, hit = service.pose_blockers(body, pose, others)
        if hit:
            raise ProblemError(
                f"object '{name}' overlaps '{min(hit)}' at the start; move one of them "
                f"('{name}' starts at '{snapshot.initial[name]}' {_show(pose)})"
            )


def _show(pose: Configuration) -> str:
    return "(" + ", ".join(f"{v:g}" for v in pose) + ")"


def _heeded(snapshot: Snapshot, name: str) -> frozenset[str] | None:
    """Return the obstacles that all motions of ``name`` heed (None: all objects)."""
    heeded: frozenset[str] | None = None
    for task in snapshot.tasks:
        if task.object == name and task.avoid is not None:
            heeded = task.avoid if heeded is None else heeded & task.avoid
    return heeded
