"""What a body in the plane can do: the coordination asks for this, never for a motion model."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.model import Body, MotionModel


@dataclass(frozen=True)
class Abilities:
    """``sideways``: it moves in any direction at any heading. ``pivots``: it turns on the spot.
    ``radius``: the tightest turn while driving (m; 0 where it pivots). ``free``: none of this is
    known, the body has its own equations of motion.
    """

    sideways: bool
    pivots: bool
    radius: float
    free: bool = False


def abilities_of(body: Body) -> Abilities:
    """Return what a planar body can do."""
    kin = body.kinematics
    if kin.model is MotionModel.SE2:
        return Abilities(sideways=True, pivots=True, radius=0.0)
    if kin.model is MotionModel.PIVOT:
        return Abilities(sideways=False, pivots=True, radius=0.0)
    if kin.model is MotionModel.REEDSSHEPP:
        return Abilities(sideways=False, pivots=False, radius=kin.turning_radius)
    return Abilities(sideways=False, pivots=False, radius=kin.turning_radius, free=True)
