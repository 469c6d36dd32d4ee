"""Safe-interval search over the plane: hybrid A* in space and time, compiled.

Safe-interval path planning (Phillips & Likhachev 2011) on the arcs of a hybrid A* (Dolgov et al.
2010): a label is a pose with an arrival time, the length of the run it is in (which gives the
speed), and the time until which it is safe to stay. From each label an arc is driven at once, or
after a stop, as soon as each later safe interval of its end can be reached. Movers are seen at
sampled poses with a margin; the path that comes out is timed and proven swept-safe elsewhere
(:mod:`up_samp.motion.spacetime.tuning`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import kernel
from up_samp.geometry.kernels import GridData, PolyData, ShapeData, advance, arc_free
from up_samp.motion.hybrid import Field, field_value
from up_samp.motion.reeds_shepp import connect
from up_samp.motion.spacetime.intervals import A_AVOIDS, B_AVOIDS
from up_samp.motion.spacetime.sweep import _apart

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

VISITS = 24
"""Visits of movers kept for one pose."""
PIECES = 96
"""Sampled poses of one drive at most."""
PIECE = 0.3
"""Distance (m) between sampled poses, more on very long drives."""
GUARD = 0.1
"""Time (s) kept from visits at sampled poses."""


class Movers(NamedTuple):
    """Other bodies: ``rows`` (n, 9) poses in the middle of their extended cells (as in
    ``sweep_table``, but without extent), body k has ``first[k]:first[k + 1]``; ``held``
    its occupancy from ``first[k] + k`` on; ``hull`` (m,) the index of its shape in ``verts``
    (h, p, c, 2), ``counts`` (h, p; 0: no part), ``radii`` (h,);
    ``steps`` (m,) distance between middles at most; ``flags`` (m,) who keeps clear of whom.
    """

    rows: FloatArray
    first: IntArray
    held: FloatArray
    hull: IntArray
    verts: FloatArray
    counts: IntArray
    radii: FloatArray
    steps: FloatArray
    flags: IntArray


class Me(NamedTuple):
    """The body that is planned: convex parts, and ``numbers``: radius, margin, turning radius, v,
    a, release, time after which the goal stays free, time until which it must rest there.
    """

    verts: FloatArray
    counts: IntArray
    numbers: FloatArray


class Labels(NamedTuple):
    """The search's labels, kept between calls.

    ``state`` (cap, 7): x, y, theta, time, signed run, safe until, estimate. ``arc`` (cap, 3):
    curvature, signed length from the parent, 1 if it stopped there first. ``link`` (cap, 3):
    parent, key, next label with the same hash. ``heap`` (cap,), ``table`` (hash size,) first label.
    ``counters``: labels, heap size, expansions, best label, arcs of its tail, whether the tail
    begins with a stop, expansions at the first solution. ``best`` (1,) arrival; ``tail`` (5, 2).
    """

    state: FloatArray
    arc: FloatArray
    link: IntArray
    heap: IntArray
    table: IntArray
    counters: IntArray
    best: FloatArray
    tail: FloatArray


def new_labels(cap: int) -> Labels:
    """Return room for ``cap`` labels."""
    size = 1 << math.ceil(math.log2(2 * cap))
    return Labels(
        np.zeros((cap, 7)),
        np.zeros((cap, 3)),
        np.zeros((cap, 3), dtype=np.int64),
        np.zeros(cap, dtype=np.int64),
        np.full(size, -1, dtype=np.int64),
        np.zeros(7, dtype=np.int64),
        np.zeros(1),
        np.zeros((5, 2)),
    )


@kernel
def visits(
    me: Me, movers: Movers, x: float, y: float, th: float, resting: bool, out: FloatArray
) -> int:
    """Fill ``out`` (VISITS, 2) with the times at which movers are at a pose; return how many."""
    row = np.zeros(9)
    row[0], row[1], row[2], row[3] = x, y, math.cos(th), math.sin(th)
    count = 0
    for k in range(len(movers.hull)):
        flags, hull = movers.flags[k], movers.hull[k]
        low, high = movers.first[k], movers.first[k + 1]
        shift = k
        reach = me.numbers[0] + me.numbers[1] + movers.radii[hull]
        step = movers.steps[k]
        j = low
        if resting or not flags & A_AVOIDS:
            if not flags & B_AVOIDS:
                continue
            j += 1
            high -= 1
        open_from = -1
        while j < high:
            b = movers.rows[j]
            gap = math.sqrt((x - b[0]) ** 2 + (y - b[1]) ** 2) - reach
            hit = False
            if gap <= 0.0:
                hit = _touch(row, me, b, movers, hull)
            if hit and open_from < 0:
                open_from = j
            if not hit and open_from >= 0:
                count = _add(out, count, movers.held[open_from + shift], movers.held[j + shift])
                open_from = -1
            j += 1 if gap <= 0.0 else max(1, int(gap / step))
        if open_from >= 0:
            count = _add(out, count, movers.held[open_from + shift], movers.held[high + shift])
    return count


@kernel
def _touch(row: FloatArray, me: Me, b: FloatArray, movers: Movers, hull: int) -> bool:
    for i in range(len(me.counts)):
        for j in range(movers.counts.shape[1]):
            n = movers.counts[hull, j]
            if n > 0 and not _apart(
                row,
                me.verts[i],
                me.counts[i],
                0.0,
                b,
                movers.verts[hull, j],
                n,
                0.0,
                me.numbers[1],
            ):
                return True
    return False


@kernel
def _add(out: FloatArray, count: int, low: float, high: float) -> int:
    """Add [low, high], guarded, to sorted disjoint intervals; return how many there are then."""
    low -= GUARD
    high += GUARD
    k = 0
    while k < count and out[k, 1] < low:
        k += 1
    last = k
    while last < count and out[last, 0] <= high:
        low, high = min(low, out[last, 0]), max(high, out[last, 1])
        last += 1
    if last == k:
        if count == len(out):
            return count
        for i in range(count, k, -1):
            out[i, 0], out[i, 1] = out[i - 1, 0], out[i - 1, 1]
        count += 1
    else:
        for i in range(last, count):
            out[i - last + k + 1, 0], out[i - last + k + 1, 1] = out[i, 0], out[i, 1]
        count -= last - k - 1
    out[k, 0], out[k, 1] = low, high
    return count


@kernel
def _ramp(run: float, v: float, a: float) -> float:
    """Return the time (s) from rest over ``run`` m at full acceleration."""
    on_ramp = v * v / (2 * a)
    return math.sqrt(2 * run / a) if run <= on_ramp else v / a + (run - on_ramp) / v


@kernel
def _stop(run: float, v: float, a: float) -> float:
    """Return the time (s) lost by coming to rest after ``run`` m instead of driving on."""
    return min(v, math.sqrt(2 * a * abs(run))) / (2 * a)


class Drive(NamedTuple):
    """Sampled poses of a drive: ``at`` (PIECES,) time after its begin from rest, ``on`` (PIECES,)
    the same when begun in motion, ``busy`` (PIECES, VISITS, 2), ``many`` (PIECES,) how many visits.
    """

    at: FloatArray
    on: FloatArray
    busy: FloatArray
    many: IntArray


@kernel
def _sample(
    me: Me,
    movers: Movers,
    label: FloatArray,
    arcs: FloatArray,
    n: int,
    brake: bool,
    drive: Drive,
    end: FloatArray,
) -> tuple[int, float]:
    """Sample ``n`` arcs from a label; return the number of poses and the last run's signed length.

    ``end`` (3,) is filled with the last pose. With ``brake`` the drive ends at rest, otherwise it
    may go on.
    """
    v, a = me.numbers[3], me.numbers[4]
    total = 0.0
    for i in range(n):
        total += abs(arcs[i, 1])
    step = max(PIECE, total / (PIECES - n))
    x, y, th = label[0], label[1], label[2]
    count = 0
    rest, on, run, ahead = 0.0, 0.0, 0.0, 0.0
    moving = abs(label[4]) if label[4] * arcs[0, 1] > 0 else 0.0
    for i in range(n):
        kappa, s = arcs[i, 0], arcs[i, 1]
        if i == 0 or run * s < 0:
            # a cusp: the last run has come to rest, measure the next one
            if i > 0:
                rest += _ramp(ahead, v, a) + _stop(ahead, v, a)
                on += _rolling(moving, ahead, v, a) + _stop(moving + ahead, v, a)
                moving = 0.0
            run, ahead = 0.0, 0.0
            k = i
            while k < n and arcs[k, 1] * s > 0:
                ahead += abs(arcs[k, 1])
                k += 1
        braked = brake or ahead < abs(total) - 1e-9
        pieces = max(1, math.ceil(abs(s) / step))
        for k in range(1, pieces + 1):
            px, py, pth = advance(x, y, th, kappa, s * k / pieces)
            gone = abs(run) + abs(s) * k / pieces
            first, second = _ramp(gone, v, a), _rolling(moving, gone, v, a)
            left = max(0.0, ahead - gone)
            if braked and left < min(v * v / (2 * a), 0.5 * ahead):
                late = _ramp(left, v, a)
                first = max(first, _ramp(ahead, v, a) + _stop(ahead, v, a) - late)
                whole = _rolling(moving, ahead, v, a) + _stop(moving + ahead, v, a)
                second = max(second, whole - late)
            drive.at[count], drive.on[count] = rest + first, on + second
            drive.many[count] = visits(me, movers, px, py, pth, False, drive.busy[count])
            count += 1
        x, y, th = advance(x, y, th, kappa, s)
        run += s
    end[0], end[1], end[2] = x, y, th
    return count, run


@kernel
def _rolling(before: float, run: float, v: float, a: float) -> float:
    """Return the time (s) over ``run`` m, ``before`` m after starting at full acceleration."""
    return _ramp(before + run, v, a) - _ramp(before, v, a)


@kernel
def _clash(drive: Drive, count: int, times: FloatArray, begin: float) -> float:
    """Return by how much a begin must be delayed at least because of the first clash (0: none)."""
    for k in range(count):
        t = begin + times[k]
        for q in range(drive.many[k]):
            if drive.busy[k, q, 0] < t < drive.busy[k, q, 1]:
                return drive.busy[k, q, 1] - t + 1e-6
    return 0.0


@kernel
def _delayed(drive: Drive, count: int, begin: float, latest: float) -> float:
    """Return the first begin from rest in [begin, latest] without a clash (inf: none)."""
    for _ in range(200):
        if begin > latest:
            return math.inf
        delay = _clash(drive, count, drive.at, begin)
        if delay == 0.0:
            return begin
        begin += delay
    return math.inf


@kernel
def _safe_until(drive: Drive, k: int, t: float) -> float:
    """Return until when it is safe to stay at sampled pose ``k`` from ``t`` on."""
    for q in range(drive.many[k]):
        if drive.busy[k, q, 0] >= t:
            return drive.busy[k, q, 0]
    return math.inf


@kernel
def _push(labels: Labels, label: int) -> None:
    heap, est = labels.heap, labels.state[:, 6]
    i = labels.counters[1]
    labels.counters[1] += 1
    while i > 0:
        up = (i - 1) // 2
        if est[heap[up]] <= est[label]:
            break
        heap[i] = heap[up]
        i = up
    heap[i] = label


@kernel
def _pop(labels: Labels) -> int:
    heap, est = labels.heap, labels.state[:, 6]
    top = heap[0]
    labels.counters[1] -= 1
    n = labels.counters[1]
    label = heap[n]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and est[heap[child + 1]] < est[heap[child]]:
            child += 1
        if est[heap[child]] >= est[label]:
            break
        heap[i] = heap[child]
        i = child
    heap[i] = label
    return int(top)


@kernel
def _key(x: float, y: float, th: float, run: float, cell: float, bins: int) -> int:
    col, row = math.floor(x / cell), math.floor(y / cell)
    k = int((th % (2 * math.pi)) / (2 * math.pi) * bins + 0.5) % bins
    return ((int(row) * 1_000_003 + int(col)) * bins + k) * 2 + (1 if run < 0 else 0)


@kernel
def _offer(
    labels: Labels,
    field: Field,
    me: Me,
    goal: FloatArray,
    grain: FloatArray,
    end: FloatArray,
    t: float,
    run: float,
    until: float,
    parent: int,
    kappa: float,
    s: float,
    stopped: bool,
) -> None:
    """Add a label unless another one at its key came earlier and may stay as long."""
    n = labels.counters[0]
    if n >= len(labels.heap):
        return
    v, a, radius = me.numbers[3], me.numbers[4], me.numbers[2]
    key = _key(end[0], end[1], end[2], run, grain[0], int(grain[1]))
    slot = (key * 0x9E3779B1) & (len(labels.table) - 1)
    other = labels.table[slot]
    while other >= 0:
        q = labels.state[other]
        if labels.link[other, 1] == key and q[3] <= t + 1e-6 and q[5] >= until - 1e-6:
            return
        other = labels.link[other, 2]
    away = math.hypot(goal[0] - end[0], goal[1] - end[1])
    far = away
    if field.values.shape[0] > 0:
        far = max(far, field_value(field, end[0], end[1]))
        if far == math.inf:
            return
    moving = abs(run)
    left = _ramp(moving + far, v, a) - _ramp(moving, v, a) + _stop(moving + far, v, a)
    if away < 12 * radius:
        out = np.empty((5, 2))
        limits = np.zeros(5)
        limits[0], limits[1], limits[2], limits[3] = radius, v, a, run
        left = max(
            left,
            connect(end[0], end[1], end[2], goal[0], goal[1], goal[2], limits, out)[0]
            - _ramp(moving, v, a),
        )
    estimate = max(t + left, me.numbers[6])
    if estimate >= labels.best[0]:
        return
    state = labels.state[n]
    state[0], state[1], state[2], state[3] = end[0], end[1], end[2], t
    state[4], state[5], state[6] = run, until, estimate
    labels.arc[n, 0], labels.arc[n, 1], labels.arc[n, 2] = kappa, s, 1.0 if stopped else 0.0
    labels.link[n, 0], labels.link[n, 1], labels.link[n, 2] = parent, key, labels.table[slot]
    labels.table[slot] = n
    labels.counters[0] += 1
    _push(labels, n)


@kernel
def plant(
    labels: Labels,
    field: Field,
    me: Me,
    movers: Movers,
    start: FloatArray,
    goal: FloatArray,
    grain: FloatArray,
) -> None:
    """Put the start into empty labels; ``grain``: cell (m), heading bins."""
    labels.counters[3] = -1
    labels.best[0] = math.inf
    busy = np.empty((VISITS, 2))
    many = visits(me, movers, start[0], start[1], start[2], True, busy)
    release, until = me.numbers[5], math.inf
    for q in range(many):
        if busy[q, 1] - GUARD > release:
            until = min(until, busy[q, 0] + GUARD)
    if until >= release:
        _offer(labels, field, me, goal, grain, start, release, 0.0, until, -1, 0.0, 0.0, False)


@kernel
def _drive_arc(
    labels: Labels,
    label: int,
    field: Field,
    me: Me,
    movers: Movers,
    goal: FloatArray,
    grain: FloatArray,
    arc: FloatArray,
    drive: Drive,
    end: FloatArray,
) -> None:
    """Offer what can be reached along one arc: at once, and later after a stop."""
    state = labels.state[label]
    v, a = me.numbers[3], me.numbers[4]
    count, run = _sample(me, movers, state, arc, 1, False, drive, end)
    ahead = state[4] * arc[0, 1] > 0
    after = -math.inf
    if ahead and _clash(drive, count, drive.on, state[3]) == 0.0:
        t = state[3] + drive.on[count - 1]
        after = _safe_until(drive, count - 1, t)
        _offer(
            labels,
            field,
            me,
            goal,
            grain,
            end,
            t,
            state[4] + run,
            after,
            label,
            arc[0, 0],
            arc[0, 1],
            False,
        )
    begin = state[3] + _stop(state[4], v, a)
    takes = drive.at[count - 1]
    for _ in range(3):
        if after == math.inf:
            return
        # the next safe interval at the end of the arc begins when a visit ends
        wish = max(begin, after - takes + 1e-6) if after > -math.inf else begin
        begin = _delayed(drive, count, wish, state[5])
        if begin == math.inf:
            return
        t = begin + takes
        after = _safe_until(drive, count - 1, t)
        _offer(
            labels, field, me, goal, grain, end, t, run, after, label, arc[0, 0], arc[0, 1], True
        )


@kernel
def _shoot(
    labels: Labels,
    label: int,
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    me: Me,
    movers: Movers,
    goal: FloatArray,
    drive: Drive,
    end: FloatArray,
) -> None:
    """Try to reach the goal from a label along one Reeds-Shepp curve, at once or after a stop."""
    state = labels.state[label]
    v, a = me.numbers[3], me.numbers[4]
    arcs = np.empty((5, 2))
    limits = np.zeros(5)
    limits[0], limits[1], limits[2], limits[3] = me.numbers[2], v, a, state[4]
    _, n = connect(state[0], state[1], state[2], goal[0], goal[1], goal[2], limits, arcs)
    if n == 0:
        return
    x, y, th = state[0], state[1], state[2]
    for i in range(n):
        if not arc_free(grid, polys, shape, x, y, th, arcs[i, 0], arcs[i, 1]):
            return
        x, y, th = advance(x, y, th, arcs[i, 0], arcs[i, 1])
    count, _ = _sample(me, movers, state, arcs, n, True, drive, end)
    free, stopped = me.numbers[6], False
    arrival = state[3] + drive.on[count - 1]
    if state[4] * arcs[0, 1] <= 0 or arrival < free or _clash(drive, count, drive.on, state[3]) > 0:
        takes = drive.at[count - 1]
        wish = max(state[3] + _stop(state[4], v, a), free - takes)
        begin = _delayed(drive, count, wish, state[5])
        arrival, stopped = begin + takes, True
    if arrival < labels.best[0] - 1e-6:
        if labels.best[0] == math.inf:
            labels.counters[6] = labels.counters[2]
        labels.best[0] = arrival
        labels.counters[3], labels.counters[4] = label, n
        labels.counters[5] = 1 if stopped else 0
        for i in range(n):
            labels.tail[i, 0], labels.tail[i, 1] = arcs[i, 0], arcs[i, 1]


@kernel
def expand(
    labels: Labels,
    grid: GridData,
    polys: PolyData,
    shape: ShapeData,
    field: Field,
    me: Me,
    movers: Movers,
    steps: FloatArray,
    goal: FloatArray,
    grain: FloatArray,
    rounds: int,
    extra: int,
) -> int:
    """Expand up to ``rounds`` labels; return 0 to go on, 1 if solved, 2 if nothing is left.

    ``steps`` (n, 2) are the arcs (curvature, signed length) that a label may drive.
    """
    drive = Drive(
        np.empty(PIECES),
        np.empty(PIECES),
        np.empty((PIECES, VISITS, 2)),
        np.zeros(PIECES, dtype=np.int64),
    )
    end = np.empty(3)
    arc = np.empty((1, 2))
    for _ in range(rounds):
        solved = labels.counters[3] >= 0
        if labels.counters[1] == 0:
            return 1 if solved else 2
        label = _pop(labels)
        state = labels.state[label]
        spent = labels.counters[2] - labels.counters[6]
        if solved and (state[6] >= labels.best[0] or spent >= extra):
            return 1
        labels.counters[2] += 1
        away = math.hypot(goal[0] - state[0], goal[1] - state[1])
        if away < 8 * me.numbers[2] or labels.counters[2] % 8 == 1:
            _shoot(labels, label, grid, polys, shape, me, movers, goal, drive, end)
        for k in range(len(steps)):
            if arc_free(grid, polys, shape, state[0], state[1], state[2], steps[k, 0], steps[k, 1]):
                arc[0, 0], arc[0, 1] = steps[k, 0], steps[k, 1]
                _drive_arc(labels, label, field, me, movers, goal, grain, arc, drive, end)
    return 0


@kernel
def chain(labels: Labels) -> FloatArray:
    """Return the best solution's arcs as rows (curvature, signed length, 1 if it stops before)."""
    count = 0
    label = labels.counters[3]
    while labels.link[label, 0] >= 0:
        count += 1
        label = labels.link[label, 0]
    tail = labels.counters[4]
    out = np.zeros((count + tail, 3))
    label = labels.counters[3]
    for i in range(count - 1, -1, -1):
        for k in range(3):
            out[i, k] = labels.arc[label, k]
        label = labels.link[label, 0]
    for i in range(tail):
        out[count + i, 0], out[count + i, 1] = labels.tail[i, 0], labels.tail[i, 1]
    if tail > 0:
        out[count, 2] = labels.counters[5]
    return out
