"""Safe-interval search over the plane: hybrid A* in space and time, compiled.

Safe-interval path planning (Phillips & Likhachev 2011) on the arcs of a hybrid A* (Dolgov et al.
2010): a label is a pose with an arrival time, the length of the run it is in (which gives the
speed), and the time until which it is safe to stay. From each label an arc is driven at once, or
after a stop, as soon as each later safe interval of its end can be reached. Movers are seen at
sampled poses with a margin; the path that comes out is timed and proven swept-safe elsewhere
(:mod:`up_samp.motion.fleet.speed`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from up_samp.geometry.compiled import inner, kernel
from up_samp.geometry.kernels import WorldData, advance
from up_samp.geometry.sweeps import arc_free
from up_samp.motion.curves.reeds_shepp import CarLimits, connect
from up_samp.motion.fleet.drives import (
    PIECES,
    Drive,
    clash,
    delayed,
    ramp,
    safe_until,
    sample,
    stop,
)
from up_samp.motion.fleet.movers import GUARD, VISITS, Me, Movers, visits
from up_samp.motion.guides.cost_to_go import Field, field_value
from up_samp.motion.guides.heap import pop, push

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Labels(NamedTuple):
    """The search's labels, kept between calls.

    ``state`` (cap, 7): x, y, theta, time, signed run, safe until, estimate. ``arc`` (cap, 4):
    curvature, signed length from the parent, 1 if it stopped there first, 1 if its estimate knows
    the curve to the goal. ``link`` (cap, 3): parent, key, next label with the same hash. ``heap``
    (cap,), ``table`` (hash size,) first label. ``counters``: labels, heap size, expansions, best
    label, arcs of its tail, whether the tail begins with a stop, expansions at the first solution.
    ``best`` (1,) arrival; ``tail`` (5, 2).
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
        np.zeros((cap, 4)),
        np.zeros((cap, 3), dtype=np.int64),
        np.zeros(cap, dtype=np.int64),
        np.full(size, -1, dtype=np.int64),
        np.zeros(7, dtype=np.int64),
        np.zeros(1),
        np.zeros((5, 2)),
    )


@inner
def _key(x: float, y: float, th: float, run: float, cell: float, bins: int) -> int:
    col, row = math.floor(x / cell), math.floor(y / cell)
    k = int((th % (2 * math.pi)) / (2 * math.pi) * bins + 0.5) % bins
    return ((int(row) * 1_000_003 + int(col)) * bins + k) * 2 + (1 if run < 0 else 0)


@inner
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
    arcs: FloatArray,
    stopped: bool,
) -> None:
    """Add a label unless another one at its key came earlier and may stay as long."""
    n = labels.counters[0]
    if n >= len(labels.heap):
        return
    key = _key(end[0], end[1], end[2], run, grain[0], int(grain[1]))
    slot = (key * 0x9E3779B1) & (len(labels.table) - 1)
    state, link = labels.state, labels.link
    other = labels.table[slot]
    while other >= 0:
        same = link[other, 1] == key
        if same and state[other, 3] <= t + 1e-6 and state[other, 5] >= until - 1e-6:
            return
        other = link[other, 2]
    far = math.hypot(goal[0] - end[0], goal[1] - end[1])
    if field.values.shape[0] > 0:
        far = max(far, field_value(field, end[0], end[1]))
        if far == math.inf:
            return
    v, a, moving = me.numbers[3], me.numbers[4], abs(run)
    left = ramp(moving + far, v, a) - ramp(moving, v, a) + stop(moving + far, v, a)
    estimate = max(t + left, me.numbers[6])
    if estimate >= labels.best[0]:
        return
    state[n, 0], state[n, 1], state[n, 2], state[n, 3] = end[0], end[1], end[2], t
    state[n, 4], state[n, 5], state[n, 6] = run, until, estimate
    labels.arc[n, 0], labels.arc[n, 1] = arcs[0, 0], arcs[0, 1]
    labels.arc[n, 2], labels.arc[n, 3] = 1.0 if stopped else 0.0, 0.0
    link[n, 0], link[n, 1], link[n, 2] = parent, key, labels.table[slot]
    labels.table[slot] = n
    labels.counters[0] += 1
    push(labels.heap, state, labels.counters, n)


def plant(labels: Labels, me: Me, movers: Movers, start: FloatArray) -> None:
    """Put the start into the labels, which are emptied."""
    labels.table[:] = -1
    labels.counters[:] = 0
    labels.counters[3] = -1
    labels.best[0] = math.inf
    busy = np.empty((VISITS, 2))
    many = visits(me, movers, start[0], start[1], start[2], True, busy)
    release = float(me.numbers[5])
    soon = busy[:many][busy[:many, 1] - GUARD > release]
    until = float(np.min(soon[:, 0] + GUARD, initial=math.inf))
    if until >= release:
        # its order and key do not matter: it is taken first, and nothing is compared with it
        labels.state[0] = (*start[:3], release, 0.0, until, release)
        labels.arc[0] = 0.0
        labels.link[0] = (-1, -1, -1)
        labels.heap[0] = 0
        labels.counters[:2] = 1


@inner
def _offers(
    labels: Labels,
    label: int,
    field: Field,
    me: Me,
    goal: FloatArray,
    grain: FloatArray,
    arcs: FloatArray,
    drive: Drive,
    count: int,
    run: float,
    end: FloatArray,
) -> None:
    """Offer what can be reached along one sampled arc: at once, and later after a stop."""
    state = labels.state
    now, before, latest = state[label, 3], state[label, 4], state[label, 5]
    takes, begin = drive.at[count - 1], now + stop(before, me.numbers[3], me.numbers[4])
    after = -math.inf
    for attempt in range(4):
        stopped = attempt > 0
        if not stopped:
            if before * arcs[0, 1] <= 0 or clash(drive, count, drive.on, now) > 0.0:
                continue
            t = now + drive.on[count - 1]
        else:
            # the next safe interval at the end of the arc begins when a visit ends
            if after > -math.inf:
                begin = max(begin, after - takes + 1e-6)
            begin = delayed(drive, count, begin, latest)
            if begin == math.inf:
                return
            t = begin + takes
        after = safe_until(drive, count - 1, t)
        length = run if stopped else before + run
        _offer(labels, field, me, goal, grain, end, t, length, after, label, arcs, stopped)
        if after == math.inf:
            return


@inner
def _finish(
    labels: Labels, label: int, me: Me, arcs: FloatArray, n: int, drive: Drive, count: int
) -> None:
    """Keep a sampled way to the goal if it arrives earlier than what is known: at once, or else
    after a stop.
    """
    now, before, latest = labels.state[label, 3], labels.state[label, 4], labels.state[label, 5]
    free, stopped = me.numbers[6], False
    arrival = now + drive.on[count - 1]
    if before * arcs[0, 1] <= 0 or arrival < free or clash(drive, count, drive.on, now) > 0.0:
        takes = drive.at[count - 1]
        wish = max(now + stop(before, me.numbers[3], me.numbers[4]), free - takes)
        arrival, stopped = delayed(drive, count, wish, latest) + takes, True
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
    world: WorldData,
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

    ``steps`` (n, 2) are the arcs (curvature, signed length) that a label may drive, ``grain`` is
    (cell (m), heading bins). Each callee has one call site: that keeps compiling short.
    """
    drive = Drive(
        np.empty(PIECES),
        np.empty(PIECES),
        np.empty((PIECES, VISITS, 2)),
        np.zeros(PIECES, dtype=np.int64),
    )
    end, arcs = np.empty(3), np.empty((5, 2))
    radius, v, a = me.numbers[2], me.numbers[3], me.numbers[4]
    car, target = CarLimits(radius, v, a), (goal[0], goal[1], goal[2])
    for _ in range(rounds):
        solved = labels.counters[3] >= 0
        if labels.counters[1] == 0:
            return 1 if solved else 2
        label = pop(labels.heap, labels.state, labels.counters)
        state = labels.state[label]
        spent = labels.counters[2] - labels.counters[6]
        if solved and (state[6] >= labels.best[0] or spent >= extra):
            return 1
        away = math.hypot(goal[0] - state[0], goal[1] - state[1])
        guides = away < 12 * radius and labels.arc[label, 3] == 0.0
        shoots = away < 8 * radius or labels.counters[2] % 8 == 0
        n = 0
        if guides or shoots:
            pose = state[0], state[1], state[2]
            time, n = connect(pose, target, car, (state[4], 0.0), arcs)
            if guides:
                # estimates that know the curve are made when a label's turn comes, not before
                labels.arc[label, 3] = 1.0
                estimate = state[3] + time - ramp(abs(state[4]), v, a)
                if estimate > state[6]:
                    state[6] = estimate
                    if estimate < labels.best[0]:
                        push(labels.heap, labels.state, labels.counters, label)
                    continue
        labels.counters[2] += 1
        for k in range(-1 if shoots and n > 0 else 0, len(steps)):
            if k >= 0:
                n = 1
                arcs[0, 0], arcs[0, 1] = steps[k, 0], steps[k, 1]
            x, y, th = state[0], state[1], state[2]
            free = True
            for i in range(n):
                if not arc_free(world, x, y, th, arcs[i, 0], arcs[i, 1]):
                    free = False
                    break
                x, y, th = advance(x, y, th, arcs[i, 0], arcs[i, 1])
            if not free:
                continue
            count, run = sample(me, movers, state, arcs, n, k < 0, drive, end)
            if k < 0:
                _finish(labels, label, me, arcs, n, drive, count)
            else:
                _offers(labels, label, field, me, goal, grain, arcs, drive, count, run, end)
    return 0


def chain(labels: Labels) -> FloatArray:
    """Return the best solution's arcs as rows (curvature, signed length, 1 if it stops before)."""
    rows = []
    label = int(labels.counters[3])
    while labels.link[label, 0] >= 0:
        rows.append(labels.arc[label, :3].copy())
        label = int(labels.link[label, 0])
    tail = np.zeros((int(labels.counters[4]), 3))
    tail[:, :2] = labels.tail[: len(tail)]
    tail[:1, 2] = labels.counters[5]
    return np.vstack([*rows[::-1], tail])
