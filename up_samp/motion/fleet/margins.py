"""How much clearance two bodies keep from each other."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from up_samp.geometry.scene import Scene
from up_samp.motion.fleet.conflicts import separation
from up_samp.motion.fleet.swept import Hull

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Clearances:
    """``margin``: clearance (m) kept where the service has no scene that tells another one;
    ``room``: what bodies at rest have to spare of theirs, so that one of them may drive off.
    """

    margin: float = 0.01
    room: float = 0.02


CLEARANCES = Clearances()


def wished(scene: Scene | None) -> float:
    """Return the clearance (m) asked for: that of the scene, from walls and from others alike."""
    return CLEARANCES.margin if scene is None else scene.margin


def eased(wish: float, gap: float) -> float:
    """Return the clearance (m) that two bodies keep which rest ``gap`` m apart at an end: ``wish``,
    or less where they could not drive off with so much.
    """
    return min(wish, max(0.5 * gap, gap - CLEARANCES.room))


def kept(wish: float, a: Iterable[FloatArray], g: Hull, b: Iterable[FloatArray], h: Hull) -> float:
    """Return the clearance (m) that two bodies keep: ``wish``, less where poses at which they rest
    (``a`` and ``b``, (3,) each) are closer to each other than that.
    """
    margin = wish
    for p, q in product(a, b):
        gap = separation(p, g, q, h, margin + CLEARANCES.room)
        if gap > 0.0:
            margin = eased(margin, gap)
    return margin
