"""Compiled conflict geometry of two bodies on fixed paths, safe between samples.

Every path is cut into cells, every cell into halves, quarters, ... A piece of half-length ``h``
around a middle pose is bounded by how far any point of the body can move along a separating axis
while ``s`` stays in the piece; two pieces are apart if for one edge normal of the convex parts the
gap at the middle poses exceeds these bounds and the margin (conservative advancement in the sense
of Zhang, Lee & Kim 2006, along separating axes). Pieces that are neither apart nor overlapping in
the middle are split; what stays undecided at the finest level counts as a conflict.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import kernel

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

DEPTH = 2
"""Times that a cell may be halved."""


@kernel
def sweep_table(s: FloatArray, poses: FloatArray, edges: FloatArray, depth: int) -> FloatArray:
    """Return rows (x, y, cos, sin, tx, ty, w, h, e) of shape (cells + 2, 2 ** (depth + 1), 9).

    Row 1 of an extended cell is the whole cell, rows 2k and 2k + 1 are the halves of row k.
    (tx, ty) is the direction of travel at the middle per unit of ``s``, ``w`` the largest turn per
    unit of ``s`` in the piece, ``h`` half the piece's length, ``e`` the displacement (m) that jumps
    of the direction inside the piece may add. The rests have ``h = 0``.
    """
    cells = len(edges) - 1
    rows = 1 << (depth + 1)
    table = np.zeros((cells + 2, rows, 9))
    n = len(s)
    for cell in range(cells + 2):
        rest = cell == 0 or cell == cells + 1
        low = edges[0] if cell == 0 else edges[min(cell - 1, cells)]
        high = low if rest else edges[cell]
        for row in range(1, rows):
            level = 0
            while (1 << (level + 1)) <= row:
                level += 1
            share = (row - (1 << level)) / (1 << level)
            a = low + (high - low) * share
            b = a + (high - low) / (1 << level)
            middle = 0.5 * (a + b)
            out = table[cell, row]
            i = max(0, min(n - 2, np.searchsorted(s, middle, side="right") - 1))
            _pose_at(s, poses, i, middle, out)
            if rest or n == 1:
                out[4], out[5], out[6], out[7] = 0.0, 0.0, 0.0, 0.0
                continue
            out[7] = 0.5 * (b - a)
            k = i
            while k > 0 and s[k] > a:
                k -= 1
            while k < n - 1 and s[k] < b:
                turn = abs(poses[k + 1, 2] - poses[k, 2]) / (s[k + 1] - s[k])
                out[6] = max(out[6], turn)
                if s[k] > a:
                    out[8] += out[7] * _jump(s, poses, k)
                k += 1
    return table


@kernel
def _jump(s: FloatArray, poses: FloatArray, k: int) -> float:
    """Return how much the direction of travel per unit of ``s`` jumps at the inner sample ``k``."""
    ends = np.empty((2, 2))
    for side in range(2):
        i = k - 1 + side
        dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
        half = 0.5 * (poses[i + 1, 2] - poses[i, 2])
        grow = 1.0 if abs(half) < 1e-9 else half / np.sin(half)
        angle = half if side == 0 else -half
        c, q = np.cos(angle), np.sin(angle)
        step = grow / (s[i + 1] - s[i])
        ends[side, 0], ends[side, 1] = step * (c * dx - q * dy), step * (q * dx + c * dy)
    return np.hypot(ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1])


@kernel
def _pose_at(s: FloatArray, poses: FloatArray, i: int, at: float, out: FloatArray) -> None:
    """Fill ``out`` with (x, y, cos, sin, tx, ty) at parameter ``at`` of sample interval ``i``."""
    if len(s) == 1 or at <= s[0]:
        j = 0
        out[0], out[1] = poses[j, 0], poses[j, 1]
        out[2], out[3] = np.cos(poses[j, 2]), np.sin(poses[j, 2])
        return
    share = min(1.0, (at - s[i]) / (s[i + 1] - s[i]))
    dx, dy = poses[i + 1, 0] - poses[i, 0], poses[i + 1, 1] - poses[i, 1]
    turn = poses[i + 1, 2] - poses[i, 2]
    half = 0.5 * turn
    if abs(half) < 1e-9:
        scale, angle, grow = share, 0.0, 1.0
    else:
        scale = np.sin(share * half) / np.sin(half)
        angle = (share - 1.0) * half
        grow = half / np.sin(half)
    c, q = np.cos(angle), np.sin(angle)
    out[0] = poses[i, 0] + scale * (c * dx - q * dy)
    out[1] = poses[i, 1] + scale * (q * dx + c * dy)
    theta = poses[i, 2] + share * turn
    out[2], out[3] = np.cos(theta), np.sin(theta)
    # direction of travel: the chord turned by what is missing to the arc's tangent here
    c, q = np.cos(share * turn - half), np.sin(share * turn - half)
    step = grow / (s[i + 1] - s[i])
    out[4], out[5] = step * (c * dx - q * dy), step * (q * dx + c * dy)


@kernel
def _apart(
    a: FloatArray,
    va: FloatArray,
    na: int,
    ra: float,
    b: FloatArray,
    vb: FloatArray,
    nb: int,
    rb: float,
    margin: float,
) -> int:
    """Return 2 if two convex parts stay apart in both pieces, 1 if they are apart in the middle
    only, 0 if they are not (all with ``margin``). ``a``, ``b`` are rows of sweep tables.
    """
    ha, hb = a[7], b[7]
    spin = a[6] * ha * (ra + 0.5 * ha) + b[6] * hb * (rb + 0.5 * hb) + a[8] + b[8]
    tx, ty = ha * a[4], ha * a[5]
    ux, uy = hb * b[4], hb * b[5]
    found = 0
    for side in range(2):
        p, q = (a, b) if side == 0 else (b, a)
        vp, vq = (va, vb) if side == 0 else (vb, va)
        n, m = (na, nb) if side == 0 else (nb, na)
        # corners of q in the frame of p
        dx, dy = q[0] - p[0], q[1] - p[1]
        ox, oy = p[2] * dx + p[3] * dy, -p[3] * dx + p[2] * dy
        c, s = p[2] * q[2] + p[3] * q[3], p[2] * q[3] - p[3] * q[2]
        for i in range(n):
            j = i + 1 if i + 1 < n else 0
            nx, ny = vp[j, 1] - vp[i, 1], vp[i, 0] - vp[j, 0]
            norm = 1.0 / np.sqrt(nx * nx + ny * ny)
            nx *= norm
            ny *= norm
            # least of n . (o + R v) over q's corners, minus the edge's own offset
            gx, gy = c * nx + s * ny, -s * nx + c * ny
            least = gx * vq[0, 0] + gy * vq[0, 1]
            for k in range(1, m):
                least = min(least, gx * vq[k, 0] + gy * vq[k, 1])
            gap = least + nx * (ox - vp[i, 0]) + ny * (oy - vp[i, 1]) - margin
            if gap > 0.0:
                found = 1
                wx, wy = p[2] * nx - p[3] * ny, p[3] * nx + p[2] * ny
                moved = abs(tx * wx + ty * wy) + abs(ux * wx + uy * wy) + spin
                if gap > moved:
                    return 2
    return found


@kernel
def _verdict(
    a: FloatArray,
    va: FloatArray,
    ca: IntArray,
    ra: float,
    b: FloatArray,
    vb: FloatArray,
    cb: IntArray,
    rb: float,
    margin: float,
) -> int:
    """Return the least verdict of :func:`_apart` over all pairs of convex parts."""
    dx, dy = a[0] - b[0], a[1] - b[1]
    reach = ra + rb + a[7] + b[7] + margin
    if dx * dx + dy * dy > reach * reach:
        return 2
    worst = 2
    for i in range(len(ca)):
        for j in range(len(cb)):
            verdict = _apart(a, va[i], ca[i], ra, b, vb[j], cb[j], rb, margin)
            if verdict == 0:
                return 0
            worst = min(worst, verdict)
    return worst


@kernel
def pieces_conflict(
    ta: FloatArray,
    va: FloatArray,
    ca: IntArray,
    ra: float,
    tb: FloatArray,
    vb: FloatArray,
    cb: IntArray,
    rb: float,
    margin: float,
) -> bool:
    """Return whether two cells (rows ``ta``, ``tb`` of sweep tables) are not shown to be apart."""
    stack = np.empty((64, 2), dtype=np.int64)
    stack[0, 0], stack[0, 1] = 1, 1
    top = 1
    half_a, half_b = len(ta) // 2, len(tb) // 2
    while top > 0:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        a, b = ta[i], tb[j]
        verdict = _verdict(a, va, ca, ra, b, vb, cb, rb, margin)
        if verdict == 2:
            continue
        if verdict == 0:
            return True
        can_a, can_b = i < half_a and a[7] > 0, j < half_b and b[7] > 0
        if not can_a and not can_b:
            return True
        if can_a and (not can_b or a[7] * (1 + a[6] * ra) >= b[7] * (1 + b[6] * rb)):
            stack[top, 0], stack[top, 1] = 2 * i, j
            stack[top + 1, 0], stack[top + 1, 1] = 2 * i + 1, j
        else:
            stack[top, 0], stack[top, 1] = i, 2 * j
            stack[top + 1, 0], stack[top + 1, 1] = i, 2 * j + 1
        top += 2
    return False


@kernel
def _gap(
    a: FloatArray, va: FloatArray, ca: IntArray, b: FloatArray, vb: FloatArray, cb: IntArray
) -> float:
    """Return the largest gap (m) along an edge normal at the middles of two pieces, least over the
    pairs of convex parts: not more than the distance, or minus the depth of the overlap.
    """
    least_gap = np.inf
    for u in range(len(ca)):
        for w in range(len(cb)):
            best = -np.inf
            for side in range(2):
                p, q = (a, b) if side == 0 else (b, a)
                vp, vq = (va[u], vb[w]) if side == 0 else (vb[w], va[u])
                n, m = (ca[u], cb[w]) if side == 0 else (cb[w], ca[u])
                dx, dy = q[0] - p[0], q[1] - p[1]
                ox, oy = p[2] * dx + p[3] * dy, -p[3] * dx + p[2] * dy
                c, s = p[2] * q[2] + p[3] * q[3], p[2] * q[3] - p[3] * q[2]
                for i in range(n):
                    j = i + 1 if i + 1 < n else 0
                    nx, ny = vp[j, 1] - vp[i, 1], vp[i, 0] - vp[j, 0]
                    norm = 1.0 / np.sqrt(nx * nx + ny * ny)
                    nx *= norm
                    ny *= norm
                    gx, gy = c * nx + s * ny, -s * nx + c * ny
                    least = gx * vq[0, 0] + gy * vq[0, 1]
                    for k in range(1, m):
                        least = min(least, gx * vq[k, 0] + gy * vq[k, 1])
                    best = max(best, least + nx * (ox - vp[i, 0]) + ny * (oy - vp[i, 1]))
            least_gap = min(least_gap, best)
    return least_gap


@kernel
def _reach(row: FloatArray, radius: float) -> float:
    """Return how far (m) any point of a body can be from where it is in the middle of a piece."""
    return row[7] * (1.0 + row[6] * (radius + 0.5 * row[7])) + row[8]


@kernel
def grown(rows: IntArray) -> IntArray:
    """Return a copy with room for twice as many rows."""
    n, m = rows.shape
    out = np.empty((2 * n, m), dtype=np.int64)
    for i in range(n):
        for j in range(m):
            out[i, j] = rows[i, j]
    return out


@kernel
def conflict_runs(
    ta: FloatArray,
    va: FloatArray,
    ca: IntArray,
    ra: float,
    tb: FloatArray,
    vb: FloatArray,
    cb: IntArray,
    rb: float,
    margin: float,
    core: float,
) -> IntArray:
    """Return the conflicting cell pairs of two paths as rows (i, j first, j last), shape (k, 3).

    From one cell of ``b`` to the next its middle moves at most ``step`` m and no point more than
    ``stride`` m, so that pairs that are far apart, or deep in each other, let the scan along ``b``
    jump ahead. Middles less than ``core`` m apart (the sum of the inscribed radii about the
    reference points) certainly overlap.
    """
    runs = np.empty((64, 3), dtype=np.int64)
    used = 0
    n, m = len(ta), len(tb)
    step = stride = 1e-9
    for j in range(m):
        step = max(step, 2 * tb[j, 1, 7])
        stride = max(stride, 2 * _reach(tb[j, 1], rb))
    for i in range(n):
        a = ta[i, 1]
        mine = _reach(a, ra)
        open_from = -1
        j = 0
        while j < m:
            b = tb[j, 1]
            dx, dy = a[0] - b[0], a[1] - b[1]
            away = np.sqrt(dx * dx + dy * dy)
            far = away - (ra + rb + a[7] + 0.5 * step + margin)
            hit, same = False, 0  # the next ``same`` cells of b are like this one
            if far > 0.0:
                same = int(far / step) - 1
            elif away < core:
                hit, same = True, int((core - away) / step)
            else:
                gap = _gap(a, va, ca, b, vb, cb) - margin
                if gap <= 0.0:
                    hit, same = True, int(-gap / stride)
                elif gap > mine + 0.5 * stride:
                    same = int((gap - mine - 0.5 * stride) / stride)
                else:
                    hit = pieces_conflict(ta[i], va, ca, ra, tb[j], vb, cb, rb, margin)
            if hit and open_from < 0:
                open_from = j
            if not hit and open_from >= 0:
                if used == len(runs):
                    runs = grown(runs)
                runs[used, 0], runs[used, 1], runs[used, 2] = i, open_from, j - 1
                used += 1
                open_from = -1
            j += 1 + max(0, same)
        if open_from >= 0:
            if used == len(runs):
                runs = grown(runs)
            runs[used, 0], runs[used, 1], runs[used, 2] = i, open_from, m - 1
            used += 1
    return runs[:used]


@kernel
def separation(
    p: FloatArray,
    va: FloatArray,
    ca: IntArray,
    q: FloatArray,
    vb: FloatArray,
    cb: IntArray,
    enough: float,
) -> float:
    """Return the largest gap (m) between two placed bodies along an edge normal (<= 0: overlap);
    ``enough`` where it is more than that.
    """
    a, b = np.zeros(9), np.zeros(9)
    a[0], a[1], a[2], a[3] = p[0], p[1], np.cos(p[2]), np.sin(p[2])
    b[0], b[1], b[2], b[3] = q[0], q[1], np.cos(q[2]), np.sin(q[2])
    worst = enough
    for i in range(len(ca)):
        for j in range(len(cb)):
            # bisect the margin at which the parts stop being apart: cheap, and done rarely
            low, high = 0.0, enough
            if _apart(a, va[i], ca[i], 0.0, b, vb[j], cb[j], 0.0, low) == 0:
                return 0.0
            if _apart(a, va[i], ca[i], 0.0, b, vb[j], cb[j], 0.0, high) == 0:
                for _ in range(40):
                    middle = 0.5 * (low + high)
                    if _apart(a, va[i], ca[i], 0.0, b, vb[j], cb[j], 0.0, middle) == 0:
                        high = middle
                    else:
                        low = middle
            else:
                low = high
            worst = min(worst, low)
    return worst
