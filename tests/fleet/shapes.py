"""Shapes on the floor, as the judge of fleet plans sees them."""

from __future__ import annotations

import math

from shapely.affinity import affine_transform
from shapely.geometry import Polygon, box

NEAR = 1e-3
"""Shapes may overlap by so much (m), as rounding of files does."""


def outline(value):
    if len(value) == 2 and not isinstance(value[0], list | tuple):
        length, width = value
        return box(-length / 2, -width / 2, length / 2, width / 2)
    return Polygon(value)


def moved(shape, pose):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return affine_transform(shape, [c, -s, s, c, pose[0], pose[1]])


def deep(a, b) -> bool:
    """Return whether two shapes overlap by more than rounding does."""
    if not a.intersects(b):
        return False
    return a.buffer(-NEAR).intersects(b.buffer(-NEAR))


def same(a, b) -> bool:
    turned = (a[2] - b[2] + math.pi) % (2 * math.pi) - math.pi
    return math.hypot(a[0] - b[0], a[1] - b[1]) < 1e-3 and abs(turned) < 1e-3
