"""Where paths bend: their parameter, where they kink, where the body must rest or drive slowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from up_samp.model import Body, MotionModel
from up_samp.motion.curves.rolling import FINE, rolls_of
from up_samp.motion.curves.twists import twists
from up_samp.motion.fleet.abilities import abilities_of

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Cut:
    """How paths are cut. Steps shorter than ``tiny`` (m) carry no shape of their own; a change of
    the direction of the twist by ``kink`` ends a stretch of constant curvature; where the direction
    of an omnidirectional body changes by ``corner`` (rad) from sample to sample, it must stop;
    ``bent`` is the share of the acceleration that a bend may take on a path whose speed is tuned
    with all of it: the two are at right angles, so that together they take 0.5 % more; ``levels``:
    speed levels that the tuning aims at (see :mod:`up_samp.motion.fleet.speed`); ``least``: those
    below the top speed of a tight arc, at least.
    """

    tiny: float = 1e-7
    kink: float = 1e-6
    corner: float = 0.1
    bent: float = 0.1
    levels: int = 20
    least: int = 2


CUT = Cut()


def path_steps(poses: FloatArray, body: Body, radius: float) -> FloatArray:
    """Return the steps of ``s`` (m) between samples of a body of this ``radius`` (m)."""
    kin = body.kinematics
    moves = twists(poses)
    ways, turns = np.hypot(moves[:, 0], moves[:, 1]), np.abs(moves[:, 2])
    if kin.model is MotionModel.PIVOT:
        return np.where(ways < FINE.spot * turns, turns * kin.v_max / kin.omega_max, ways)
    turn_metre = radius
    if abilities_of(body).pivots:
        turn_metre = kin.v_max / kin.omega_max
    elif kin.model is MotionModel.REEDSSHEPP:
        turn_metre = 0.0
    return np.asarray(np.maximum(ways, turn_metre * turns))


def top_speeds(poses: FloatArray, body: Body) -> FloatArray:
    """Return the top speeds (m/s) between the poses of a path."""
    tops = np.full(len(poses) - 1, body.kinematics.v_max)
    if body.kinematics.model is MotionModel.PIVOT and len(poses) > 1:
        rolls = rolls_of(poses, body.kinematics)
        tops = np.where(np.abs(rolls.kinds) == 2, tops, rolls.tops)
    return tops


def kept_samples(s: FloatArray) -> IntArray:
    """Return samples that lie at least a tiny step apart, always with the first and the last."""
    if np.all(np.diff(s) >= CUT.tiny):
        return np.arange(len(s), dtype=np.int64)
    keep = [0]
    for i in range(1, len(s)):
        if s[i] - s[keep[-1]] >= CUT.tiny:
            keep.append(i)
    if keep[-1] != len(s) - 1 and len(keep) > 1:
        keep[-1] = len(s) - 1
    return np.array(keep, dtype=np.int64)


def kinks_and_stops(poses: FloatArray, s: FloatArray, body: Body) -> tuple[BoolArray, BoolArray]:
    """Return where the twist's direction jumps, and where the body must therefore rest."""
    n, model = len(s), body.kinematics.model
    kink, stop = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    kink[0] = kink[-1] = stop[0] = stop[-1] = True
    if n > 2:
        unit = twists(poses) / np.diff(s)[:, None]
        kink[1:-1] = np.abs(np.diff(unit, axis=0)).max(axis=1) > CUT.kink
        if model is MotionModel.REEDSSHEPP:
            stop[1:-1] = unit[:-1, 0] * unit[1:, 0] < 0
        elif model is MotionModel.PIVOT:  # it turns at will, but on the spot it rests
            stop[1:-1] = np.diff(rolls_of(poses, body.kinematics).kinds) != 0
        else:
            # a velocity may not jump: chords of smooth curves turn little from sample to sample
            chord = np.diff(poses, axis=0) / np.diff(s)[:, None]
            stop[1:-1] = np.abs(np.diff(chord, axis=0)).max(axis=1) > CUT.corner
    return kink, stop


def bends_hard(poses: FloatArray, s: FloatArray, stop: BoolArray, body: Body) -> bool:
    """Return whether going on at full speed where the way bends, or where it begins to turn more or
    less on its way, takes more acceleration than what speeding up or braking leaves over.
    """
    steps = np.diff(s)
    way = np.diff(poses[:, :2], axis=0) / steps[:, None]
    change = np.hypot(*np.diff(way, axis=0).T)
    mean = 0.5 * (steps[1:] + steps[:-1])
    moving = (steps[1:] > CUT.tiny) & (steps[:-1] > CUT.tiny) & ~stop[1:-1]
    kin = body.kinematics
    most = CUT.bent * kin.a_max / kin.v_max**2
    # tuned motions follow constant twists: who turns on a straight way would sway from side to side
    turn = np.where(np.hypot(*way.T) > 1e-6, np.abs(np.diff(poses[:, 2])) / steps, 0.0)
    return bool(np.any(change[moving] > most * mean[moving]) or np.any(turn > most))
