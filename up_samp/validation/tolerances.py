"""How exactly plans are judged: every tolerance of the validator, and how long it may take."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tolerances:
    """What is forgiven because numbers are rounded, and how closely is looked. None of it can be
    tuned: with other values the same plan would be judged otherwise.
    """

    penetration: float = 1e-6
    """Bodies may touch, and be into each other by this much (m): rounding is no crash."""
    unseen_contact: float = 1e-3
    """Where bodies nearly touch: no more than this way (m) is left unseen between looks."""
    limits: float = 0.01
    """Limits of speed, acceleration and turning may be exceeded by this share."""
    noise: float = 1e-6
    """Positions (m) and angles (rad) may be off by this much."""
    sampling: float = 0.1
    """Samples are at most this far apart (s) while the body moves."""
    turn_step: float = 0.1
    """A turn rate may change at once by what the limit makes good in this time (s): between two
    samples nobody sees how it changed."""
    slip_window: float = 2.0
    """Side slip may not add up to more than ``limits`` of any such stretch of way (m)."""
    wrong_way: float = 1e-3
    """So far (m) a body may have gone against the direction of a zone."""
    on_spot: float = 0.01
    """Who turns about a point that is nearer than this (m) turns on the spot."""
    control_rate: float = 0.02
    """Rates may miss the model's by this share of the fastest one, plus 1e-3 (m/s, rad/s)."""
    pose: float = 1e-3
    """Poses that are this near (m, rad) are the same."""
    height: float = 1e-3
    """Maps whose heights differ by no more (m) are of one floor, for loads."""
    agreement: float = 1e-2
    """A path and a trajectory of the same motion may differ by this much (m, rad)."""
    joint: float = 1e-3
    """The end of one controlled piece of a path and the next pose may differ by this (m, rad)."""
    rigid: float = 1e-3
    """A load that stands to its carrier at the end as at the start, this near (m, rad), travels."""
    closed_gap: float = 1e-6
    """Gaps between robot and load that are below twice this (m) are rounding."""
    late: float = 1e-6
    """A trajectory may leave its activity's window by this much (s)."""


TOLERANCES = Tolerances()

JUDGING_GRACE = 1.5
"""Seconds after its limit that a solve may go on judging a plan that it has found."""
