"""What is broken inside the solving process: planners, proofs, judges that raise."""

from __future__ import annotations

import builtins
import importlib
from typing import Any

PLACES = {
    "car": ("up_samp.motion.planners.car", "CarPlanner", "leg"),
    "planar": ("up_samp.motion.planners.omni", "PlanarPlanner", "leg"),
    "coordinate": ("up_samp.motion.service", "MotionService", "coordinate"),
    "leg": ("up_samp.motion.legs", "Legs", "find"),
    "certificate": ("up_samp.motion.proofs.certificates", "Certifier", "prove"),
    "bound": ("up_samp.motion.proofs.bounds", "Bounds", "duration"),
    "tidy": ("up_samp.search.resolve", None, "_with_motions_optional"),
    "repair": ("up_samp.search.presets", None, "repair_durations"),
}


def raising(_problem: Any, given: dict[str, Any]) -> None:
    """Make the ``at``-th call of a place (of :data:`PLACES`) and all later ones raise."""
    module, kind, name = PLACES[given["where"]]
    owner = importlib.import_module(module)
    if kind is not None:
        owner = getattr(owner, kind)
    inner = getattr(owner, name)
    error = getattr(builtins, given.get("error", "RuntimeError"))
    calls = 0

    def spoilt(*args: Any, **keywords: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls >= given.get("at", 1):
            raise error("a wheel came off")
        return inner(*args, **keywords)

    setattr(owner, name, spoilt)


class Law:
    """The control law of a robot that turns on the spot; from its ``at``-th call on it raises."""

    def __init__(self, at: int, error: str) -> None:
        self.at, self.error, self.calls = at, getattr(builtins, error), 0

    def __call__(self, q, u, qdot) -> None:
        import math

        self.calls += 1
        if self.calls >= self.at:
            raise self.error("the wheel slips")
        qdot[0], qdot[1], qdot[2] = u[0] * math.cos(q[2]), u[0] * math.sin(q[2]), u[1]


def a_robot_with_a_law(at: int, error: str = "RuntimeError"):
    """Return a problem whose one robot obeys such a law."""
    from unified_planning.model.motion import MotionModels, MovableObject

    from tests.benchmarks.scene import SceneBuilder
    from up_samp.benchmarks.places import box

    scene = SceneBuilder("law")
    start, goal = scene.place("start", (4.0, 10.0, 0.0)), scene.place("goal", (9.0, 10.0, 0.0))
    robot = MovableObject(
        "r7",
        scene.robot_type,
        footprint=list(box(1, 0.6)),
        motion_model=MotionModels.SE2,
        control_model=Law(at, error),
        control_parameters={f"{name}_max": 0.5 for name in ("v", "w")},
    )
    scene.problem.add_object(robot)
    scene.problem.set_initial_configuration(robot, start)
    scene.drive("go", robot, [start, goal], (1, 100))
    return scene.problem
