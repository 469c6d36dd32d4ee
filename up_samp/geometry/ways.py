"""Rules of ways for the compiled checks: zones that are driven through in one direction only, and
zones in which no body turns on the spot.

A motion is looked at piece by piece, each taken for its chord; the zones are wider by what that may
leave out. Lengths in m, angles in rad.
"""

from __future__ import annotations

import math

from up_samp.geometry.records import RuleData, inner
from up_samp.model.arrays import FloatArray

WIDER = 0.01
"""What zones are wider (m) than they are: arcs leave their chords by less than half of it."""


@inner
def _meets(verts: FloatArray, n: int, ax: float, ay: float, bx: float, by: float) -> bool:
    """Return whether a segment meets a convex counter-clockwise polygon (Cyrus and Beck)."""
    low, high = 0.0, 1.0
    j = n - 1
    for i in range(n):
        nx, ny = verts[j, 1] - verts[i, 1], verts[i, 0] - verts[j, 0]
        inside = (ax - verts[j, 0]) * nx + (ay - verts[j, 1]) * ny
        gain = (bx - ax) * nx + (by - ay) * ny
        if gain == 0.0:
            if inside < 0.0:
                return False
        elif gain > 0.0:
            low = max(low, -inside / gain)
        else:
            high = min(high, -inside / gain)
        if low > high:
            return False
        j = i
    return True


@inner
def piece_obeys(
    rules: RuleData, ax: float, ay: float, bx: float, by: float, turn: float, bend: float
) -> bool:
    """Return whether a piece of a way from one point to another keeps the rules: it turns the body
    by ``turn`` rad, and its own direction leaves the chord's by ``bend`` rad at most.
    """
    dx, dy = bx - ax, by - ay
    way = math.sqrt(dx * dx + dy * dy)
    # who turns round a point nearer than 5 cm turns on the spot
    spot = abs(turn) > 1e-9 and way < 0.05 * abs(turn)
    for k in range(rules.counts.shape[0]):
        u, w, still = rules.rules[k, 0], rules.rules[k, 1], rules.rules[k, 2] > 0.0
        if still:
            if not spot:
                continue
        else:
            along, across = dx * u + dy * w, abs(dx * w - dy * u)
            # a millionth of the way may lead against the direction: rounding
            if along * math.cos(bend) - across * math.sin(bend) >= -1e-6 * way - 1e-12:
                continue
        if _meets(rules.verts[k], rules.counts[k], ax, ay, bx, by):
            return False
    return True
