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

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import WorldData, inner, kernel
from up_samp.geometry.sweeps import arc_free
from up_samp.motion.curves.reeds_shepp import Pose, connect
from up_samp.motion.fleet.moving_obstacles import (
    ArcDrive,
    Begin,
    Me,
    Movers,
    clash,
    delayed,
    new_drive,
    ramp,
    safe_until,
    sample,
    stop,
    visits,
)
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


class Label(NamedTuple):
    """One label: a pose, the time (s), the signed length of the run it is in (m), until when it is
    safe to stay, and when the goal is reached at best.
    """

    pose: Pose
    time: float
    run: float
    until: float
    estimate: float


class Grain(NamedTuple):
    """Poses in one ``cell`` (m) and one of ``bins`` of the headings count as one."""

    cell: float
    bins: int


class Quest(NamedTuple):
    """What one search is about: a body that drives among movers to ``goal`` by arcs ``steps``
    (n, 2: curvature, signed length).
    """

    world: WorldData
    field: Field
    me: Me
    movers: Movers
    goal: Pose
    steps: FloatArray
    grain: Grain


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
def _label(labels: Labels, i: int) -> Label:
    row = labels.state[i]
    return Label((row[0], row[1], row[2]), row[3], row[4], row[5], row[6])


@inner
def _key(pose: Pose, run: float, grain: Grain) -> int:
    col, row = math.floor(pose[0] / grain.cell), math.floor(pose[1] / grain.cell)
    k = int((pose[2] % (2 * math.pi)) / (2 * math.pi) * grain.bins + 0.5) % grain.bins
    return ((int(row) * 1_000_003 + int(col)) * grain.bins + k) * 2 + (1 if run < 0 else 0)


@inner
def _offer(
    labels: Labels, quest: Quest, new: Label, parent: int, arcs: FloatArray, stopped: bool
) -> None:
    """Add a label unless another one at its key came earlier and may stay as long (``new`` comes
    without its estimate).
    """
    n = labels.counters[0]
    if n >= len(labels.heap):
        return
    me, field, goal = quest.me, quest.field, quest.goal
    key = _key(new.pose, new.run, quest.grain)
    slot = (key * 0x9E3779B1) & (len(labels.table) - 1)
    link = labels.link
    at = labels.table[slot]
    while at >= 0:
        if link[at, 1] == key:
            other = _label(labels, at)
            if other.time <= new.time + 1e-6 and other.until >= new.until - 1e-6:
                return
        at = link[at, 2]
    far = math.hypot(goal[0] - new.pose[0], goal[1] - new.pose[1])
    if field.values.shape[0] > 0:
        far = max(far, field_value(field, new.pose[0], new.pose[1]))
        if far == math.inf:
            return
    v, a, moving = me.car.v, me.car.a, abs(new.run)
    left = ramp(moving + far, v, a) - ramp(moving, v, a) + stop(moving + far, v, a)
    estimate = max(new.time + left, me.goal_free)
    if estimate >= labels.best[0]:
        return
    state = labels.state
    state[n, 0], state[n, 1], state[n, 2] = new.pose[0], new.pose[1], new.pose[2]
    state[n, 3], state[n, 4], state[n, 5] = new.time, new.run, new.until
    state[n, 6] = estimate
    labels.arc[n, 0], labels.arc[n, 1] = arcs[0, 0], arcs[0, 1]
    labels.arc[n, 2], labels.arc[n, 3] = 1.0 if stopped else 0.0, 0.0
    link[n, 0], link[n, 1], link[n, 2] = parent, key, labels.table[slot]
    labels.table[slot] = n
    labels.counters[0] += 1
    push(labels.heap, state, labels.counters, n)


def plant(labels: Labels, me: Me, movers: Movers, start: Pose) -> None:
    """Put the start into the labels, which are emptied."""
    labels.table[:] = -1
    labels.counters[:] = 0
    labels.counters[3] = -1
    labels.best[0] = math.inf
    busy = np.empty((me.fine.visits, 2))
    many, guard = visits(me, movers, start, True, busy), me.fine.guard
    soon = busy[:many][busy[:many, 1] - guard > me.release]
    until = float(np.min(soon[:, 0] + guard, initial=math.inf))
    if until >= me.release:
        # its order and key do not matter: it is taken first, and nothing is compared with it
        labels.state[0] = (*start, me.release, 0.0, until, me.release)
        labels.arc[0] = 0.0
        labels.link[0] = (-1, -1, -1)
        labels.heap[0] = 0
        labels.counters[:2] = 1


class Way(NamedTuple):
    """A sampled way from a label: its ``arcs``, the sampled ``drive`` of so ``many`` poses,
    the signed length of its last ``run`` (m), and its ``end``.
    """

    arcs: FloatArray
    drive: ArcDrive
    many: int
    run: float
    end: Pose


@inner
def _offers(labels: Labels, label: int, quest: Quest, way: Way) -> None:
    """Offer what can be reached along one sampled arc: at once, and later after a stop."""
    drive, last = way.drive, way.many - 1
    here = _label(labels, label)
    takes = drive.at[last]
    begin = here.time + stop(here.run, quest.me.car.v, quest.me.car.a)
    after = -math.inf
    for attempt in range(4):
        stopped = attempt > 0
        if not stopped:
            turns = here.run * way.arcs[0, 1] <= 0
            if turns or clash(drive, way.many, drive.on, here.time) > 0.0:
                continue
            t = here.time + drive.on[last]
        else:
            # the next safe interval at the end of the arc begins when a visit ends
            if after > -math.inf:
                begin = max(begin, after - takes + 1e-6)
            begin = delayed(drive, way.many, begin, here.until)
            if begin == math.inf:
                return
            t = begin + takes
        after = safe_until(drive, last, t)
        length = way.run if stopped else here.run + way.run
        new = Label(way.end, t, length, after, 0.0)
        _offer(labels, quest, new, label, way.arcs, stopped)
        if after == math.inf:
            return


@inner
def _finish(labels: Labels, label: int, me: Me, way: Way, n: int) -> None:
    """Keep a sampled way of ``n`` arcs to the goal if it arrives earlier than what is known: at
    once, or else after a stop.
    """
    drive, last = way.drive, way.many - 1
    here = _label(labels, label)
    stopped = False
    arrival = here.time + drive.on[last]
    blocked = here.run * way.arcs[0, 1] <= 0 or arrival < me.goal_free
    if blocked or clash(drive, way.many, drive.on, here.time) > 0.0:
        takes = drive.at[last]
        wish = max(here.time + stop(here.run, me.car.v, me.car.a), me.goal_free - takes)
        arrival, stopped = delayed(drive, way.many, wish, here.until) + takes, True
    if arrival < labels.best[0] - 1e-6:
        if labels.best[0] == math.inf:
            labels.counters[6] = labels.counters[2]
        labels.best[0] = arrival
        labels.counters[3], labels.counters[4] = label, n
        labels.counters[5] = 1 if stopped else 0
        for i in range(n):
            labels.tail[i, 0], labels.tail[i, 1] = way.arcs[i, 0], way.arcs[i, 1]


@kernel
def expand(labels: Labels, quest: Quest, rounds: int, extra: int) -> int:
    """Expand up to ``rounds`` labels; return 0 to go on, 1 if solved, 2 if nothing is left.

    Each callee has one call site: that keeps compiling short.
    """
    world, me, goal, steps = quest.world, quest.me, quest.goal, quest.steps
    drive, arcs = new_drive(me.fine), np.empty((5, 2))
    for _ in range(rounds):
        solved = labels.counters[3] >= 0
        if labels.counters[1] == 0:
            return 1 if solved else 2
        number = pop(labels.heap, labels.state, labels.counters)
        label = _label(labels, number)
        spent = labels.counters[2] - labels.counters[6]
        if solved and (label.estimate >= labels.best[0] or spent >= extra):
            return 1
        away = math.hypot(goal[0] - label.pose[0], goal[1] - label.pose[1])
        guides = away < 12 * me.car.radius and labels.arc[number, 3] == 0.0
        shoots = away < 8 * me.car.radius or labels.counters[2] % 8 == 0
        n = 0
        if guides or shoots:
            time, n = connect(label.pose, goal, me.car, (label.run, 0.0), arcs)
            if guides:
                # estimates that know the curve are made when a label's turn comes, not before
                labels.arc[number, 3] = 1.0
                estimate = label.time + time - ramp(abs(label.run), me.car.v, me.car.a)
                if estimate > label.estimate:
                    labels.state[number, 6] = estimate
                    if estimate < labels.best[0]:
                        push(labels.heap, labels.state, labels.counters, number)
                    continue
        labels.counters[2] += 1
        for k in range(-1 if shoots and n > 0 else 0, len(steps)):
            if k >= 0:
                n = 1
                arcs[0, 0], arcs[0, 1] = steps[k, 0], steps[k, 1]
            x, y, th = label.pose
            free = True
            for i in range(n):
                if not arc_free(world, x, y, th, arcs[i, 0], arcs[i, 1]):
                    free = False
                    break
                x, y, th = advance(x, y, th, arcs[i, 0], arcs[i, 1])
            if not free:
                continue
            begin = Begin(label.pose, label.run)
            count, run, end = sample(me, quest.movers, begin, arcs, n, k < 0, drive)
            way = Way(arcs, drive, count, run, end)
            if k < 0:
                _finish(labels, number, me, way, n)
            else:
                _offers(labels, number, quest, way)
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
