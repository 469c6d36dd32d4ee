"""One robot's way among reservations: safe intervals over a lattice of places (SIPP; Phillips and
Likhachev 2011), with what stopping and turning cost.

The lattice knows bodies as discs, and speeds as full or none: it proposes which side to pass on,
and whom to let go first. The way is then cut to what the body can drive
(:func:`up_samp.motion.fleet.one_robot.drivable`) and timed exactly by those who ask.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from up_samp.geometry.kernels import piece_obeys, point_clearance
from up_samp.geometry.memory import Memory
from up_samp.geometry.records import GridData, RuleData, inner, kernel
from up_samp.geometry.scene import Scene
from up_samp.geometry.shapes import shape_of
from up_samp.model import Body, Configuration, Mobility, TimedMotion
from up_samp.model.arrays import BoolArray, FloatArray, Int32Array, IntArray
from up_samp.motion.fleet.conflicts import noted
from up_samp.motion.fleet.one_robot import docked, drivable
from up_samp.motion.fleet.paths import (
    Path,
    TimeSets,
    hull_of,
    safe_intervals,
    times_of,
)
from up_samp.motion.fleet.timed_path import TimedPath, pair_flags
from up_samp.motion.fleet.workspace import Workspace
from up_samp.motion.guides import search_box
from up_samp.motion.legs import before_docking

STEP = 0.7
"""Circumscribed radii between places of the lattice."""

PLACES = 60_000
"""Places of a lattice, at most: on larger floors no ways are proposed."""

SAMPLE = 0.2
"""Seconds between the moments at which a run is looked at."""

EAGER = 1.1
"""Weight of what is left of a way: the first good one is nearly as good as the best, and as the
lattice has it, neither is exact.
"""

GAIN = 10.0
"""Seconds that are to be gained for all the effort; for fewer a search expands fewer states."""

WAYS = np.array(
    [(i, j) for i in range(-2, 3) for j in range(-2, 3) if math.gcd(i, j) == 1], dtype=np.int64
)
"""Steps to the neighbours of a place: 16 directions."""


class Lattice(NamedTuple):
    """Places ``step`` m apart from the corner ``x``, ``y`` (m) on, row by row; those that are
    ``free`` (rows, cols) for a disc of a ``radius`` (m) among what is fixed. ``rules`` are those of
    ways; ``near`` (places, 16) tells where the steps from each place lead (-1: nowhere).
    """

    x: float
    y: float
    step: float
    radius: float
    free: BoolArray
    rules: RuleData
    near: Int32Array


@kernel
def neighbours(
    frame: FloatArray, free: BoolArray, rules: RuleData, ways: IntArray, grid: GridData, need: float
) -> Int32Array:
    """Return where the steps from each place of a lattice lead (-1: nowhere), places by ``ways``.
    ``frame``: the lattice's corner x, y and step (m); ``need``: the room half-way (m).
    """
    rows, cols = free.shape
    found = np.full((rows * cols, len(ways)), -1, dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            x, y = frame[0] + col * frame[2], frame[1] + row * frame[2]
            for w in range(len(ways)):
                a, b = ways[w]
                i, j = col + a, row + b
                if i < 0 or j < 0 or i >= cols or j >= rows or not free[j, i]:
                    continue
                u, v = frame[0] + i * frame[2], frame[1] + j * frame[2]
                if point_clearance(grid, 0.5 * (x + u), 0.5 * (y + v)) < need:
                    continue
                if piece_obeys(rules, x, y, u, v, 0.0, 0.0):
                    found[row * cols + col, w] = j * cols + i
    return found


@kernel
def visits(
    lattice: Lattice, times: FloatArray, poses: FloatArray, ends: FloatArray, reach: float
) -> FloatArray:
    """Return when places are within ``reach`` m of a body that is there during ``ends`` (2,), and
    at ``poses`` (n, 3) at ``times`` (n,) (s): rows (place, from, until).
    """
    rows, cols = lattice.free.shape
    open_from = np.full(rows * cols, np.inf)
    open_until = np.full(rows * cols, -np.inf)
    out = np.empty((1024, 3))
    used = 0
    n = len(times)
    wide = int(reach / lattice.step) + 1
    for k in range(n + 1):
        # one row at the end closes what is still open
        at = times[min(k, n - 1)]
        low = ends[0] if k == 0 else 0.5 * (times[k - 1] + at)
        high = ends[1] if k >= n - 1 else 0.5 * (at + times[k + 1])
        x, y = poses[min(k, n - 1), 0], poses[min(k, n - 1), 1]
        col, row = round((x - lattice.x) / lattice.step), round((y - lattice.y) / lattice.step)
        if k == n:
            break
        for j in range(max(0, row - wide), min(rows, row + wide + 1)):
            for i in range(max(0, col - wide), min(cols, col + wide + 1)):
                dx, dy = lattice.x + i * lattice.step - x, lattice.y + j * lattice.step - y
                if dx * dx + dy * dy >= reach * reach:
                    continue
                place = j * cols + i
                if open_from[place] == np.inf or open_until[place] < low - 1e-6:
                    if open_from[place] < np.inf:
                        out = noted(out, used, place, open_from[place], open_until[place])
                        used += 1
                    open_from[place] = low
                open_until[place] = high
    for place in range(rows * cols):
        if open_from[place] < np.inf:
            out = noted(out, used, place, open_from[place], open_until[place])
            used += 1
    return out[:used].copy()


@kernel
def visits_of_ends(
    places: FloatArray, times: FloatArray, poses: FloatArray, ends: FloatArray, reach: float
) -> FloatArray:
    """Return the same for two ``places`` (2, 2; m), which are numbered 0 and 1."""
    n = len(times)
    out = np.empty((2 * n, 3))
    used = 0
    for place in range(2):
        for k in range(n):
            dx, dy = poses[k, 0] - places[place, 0], poses[k, 1] - places[place, 1]
            near = dx * dx + dy * dy < reach * reach
            if near:
                low = ends[0] if k == 0 else 0.5 * (times[k - 1] + times[k])
                high = ends[1] if k == n - 1 else 0.5 * (times[k] + times[k + 1])
                out[used, 0], out[used, 1], out[used, 2] = place, low, high
                used += 1
    return out[:used]


class Links(NamedTuple):
    """The places around an end: their numbers ``place`` (k,), how far they are (``way``, m), and
    which of the lattice's directions leads there best.
    """

    place: IntArray
    way: FloatArray
    direction: IntArray


@kernel
def links_of(lattice: Lattice, x: float, y: float, sign: int, ways: IntArray) -> Links:
    """Return the places around an end, 1.6 steps from it at most, with directions to them (from
    them, where ``sign`` < 0).
    """
    rows, cols = lattice.free.shape
    col, row = (x - lattice.x) / lattice.step, (y - lattice.y) / lattice.step
    places, metres = np.empty(36, dtype=np.int64), np.empty(36)
    directions, used = np.empty(36, dtype=np.int64), 0
    for j in range(max(0, math.floor(row) - 2), min(rows, math.floor(row) + 4)):
        for i in range(max(0, math.floor(col) - 2), min(cols, math.floor(col) + 4)):
            dx, dy = sign * (i - col), sign * (j - row)
            far = np.sqrt(dx * dx + dy * dy)
            u, v = lattice.x + i * lattice.step, lattice.y + j * lattice.step
            a, b, c, d = (x, y, u, v) if sign > 0 else (u, v, x, y)
            obeys = piece_obeys(lattice.rules, a, b, c, d, 0.0, 0.0)
            if far > 1.6 or not lattice.free[j, i] or not obeys:
                continue
            best = -np.inf
            for w in range(len(ways)):
                size = np.sqrt(ways[w, 0] ** 2 + ways[w, 1] ** 2)
                along = (ways[w, 0] * dx + ways[w, 1] * dy) / size
                if along > best:
                    best, directions[used] = along, w
            places[used], metres[used] = j * cols + i, far * lattice.step
            used += 1
    return Links(places[:used].copy(), metres[:used].copy(), directions[:used].copy())


class Errand(NamedTuple):
    """What one search is about. ``drives`` (16,): seconds of the steps to a place's neighbours at
    ``top`` speed (m/s); ``turns`` (17, 16): seconds more in one direction after another one, or
    after standing (last row; inf: not without a stop); ``to_go``: least seconds from each place to
    the goal; ``starts`` and ``goals``: seconds that setting off and arriving take by direction;
    seconds that a ``stop`` costs twice, how long a body may ``lag`` behind full speed (s) without a
    stop; it is ready at ``release`` (s), and what arrives after ``until`` (s) is of no use.
    """

    drives: FloatArray
    turns: FloatArray
    to_go: FloatArray
    starts: FloatArray
    goals: FloatArray
    source: Links
    target: Links
    top: float
    stop: float
    lag: float
    release: float
    until: float


@kernel
def distances(lattice: Lattice, goal: Links, ways: IntArray) -> FloatArray:
    """Return the metres from each place to a goal (Dijkstra 1959)."""
    rows, cols = lattice.free.shape
    far = np.full(rows * cols, np.inf)
    queue = [(0.0, -1)]
    queue.pop()
    for k in range(len(goal.place)):
        far[goal.place[k]] = goal.way[k]
        heapq.heappush(queue, (goal.way[k], goal.place[k]))
    while len(queue) > 0:
        d, place = heapq.heappop(queue)
        if d > far[place]:
            continue
        for w in range(len(ways)):
            i, j = place % cols - ways[w, 0], place // cols - ways[w, 1]
            if i < 0 or j < 0 or i >= cols or j >= rows or not lattice.free[j, i]:
                continue
            before = j * cols + i
            other = d + lattice.step * np.sqrt(ways[w, 0] ** 2 + ways[w, 1] ** 2)
            if other < far[before] - 1e-9 and lattice.near[before, w] == place:
                far[before] = other
                heapq.heappush(queue, (other, before))
    return far


@inner
def _free_at(head: IntArray, intervals: FloatArray, place: int, t: float) -> bool:
    for r in range(head[place], head[place + 1]):
        if intervals[r, 0] <= t and t <= intervals[r, 1]:
            return True
    return False


@inner
def _clear_between(
    cols: int, head: IntArray, intervals: FloatArray, place: int, e: int, half: float
) -> bool:
    """Return whether a long step passes between two places that are free then."""
    a, b = WAYS[e, 0], WAYS[e, 1]
    if abs(a) + abs(b) < 3:
        return True
    first = place + (b // 2) * cols + a // 2
    second = place + ((b + 1) // 2) * cols + (a + 1) // 2
    return _free_at(head, intervals, first, half) and _free_at(head, intervals, second, half)


@inner
def _traced(place_of: IntArray, best: FloatArray, parent: Int32Array, last: int) -> FloatArray:
    """Return the rows (place, time) of the way to a state."""
    count, key = 0, last
    while key >= 0:
        count += 1
        key = parent[key]
    found = np.empty((count, 2))
    key = last
    for k in range(count - 1, -1, -1):
        found[k, 0], found[k, 1] = place_of[key // 2], best[key]
        key = parent[key]
    return found


@inner
def _tables(task: Errand, safe: TimeSets, places: int) -> tuple[IntArray, IntArray]:
    """Return each safe interval's place, and each place's row among those around the goal."""
    place_of = np.empty(len(safe.intervals), dtype=np.int64)
    for place in range(places + 2):
        place_of[safe.head[place] : safe.head[place + 1]] = place
    links = np.full(places, -1, dtype=np.int64)
    for k in range(len(task.target.place)):
        links[task.target.place[k]] = k
    return place_of, links


@inner
def _begun(
    task: Errand, safe: TimeSets, places: int, best: FloatArray
) -> list[tuple[float, float, float, int]]:
    """Return a queue of where the body stands as it is released, and set when it is there."""
    queue = [(0.0, 0.0, 0.0, 0)]
    queue.pop()
    for r in range(safe.head[places], safe.head[places + 1]):
        if safe.intervals[r, 0] <= task.release and task.release < safe.intervals[r, 1]:
            best[2 * r + 1] = task.release
            heapq.heappush(queue, (task.release, 0.0, task.release, 2 * r + 1))
    return queue


@inner
def _goal_free(safe: TimeSets, goal: int) -> float:
    """Return from when on a goal stays free for good (inf: it does not)."""
    free = times_of(safe, goal)
    endless = len(free) > 0 and free[-1, 1] == np.inf
    return float(free[-1, 0]) if endless else np.inf


@inner
def _soonest(task: Errand, safe: TimeSets, goal: int, most: int) -> tuple[float, int]:
    """Return a time (s) before which nobody is at rest at a goal that gets free at some time, and
    how many of ``most`` states are worth expanding: as the nearest is expanded first, what may be
    gained then is found soon.
    """
    free, least = _goal_free(safe, goal), np.inf
    for k in range(len(task.target.place)):
        least = min(least, task.goals[task.target.direction[k]])
    if least == np.inf or free + task.stop + least >= task.until:
        return np.inf, 0
    soonest = free + task.stop + least
    return soonest, int(most * min(1.0, (task.until - soonest) / GAIN))


@inner
def _halt(
    queue: list[tuple[float, float, float, int]],
    best: FloatArray,
    parent: Int32Array,
    key: int,
    when: tuple[float, float, float],
) -> None:
    """Have a body that moves stand still from then on, if that is sooner than what is known.
    ``when``: that, how far it has to go, and before when nobody is at the goal (s).
    """
    stood, left, soonest = when
    if stood < best[key + 1] - 1e-9:
        best[key + 1], parent[key + 1] = stood, key
        heapq.heappush(queue, (max(stood + EAGER * left, soonest), left, stood, key + 1))


States = tuple[FloatArray, Int32Array, npt.NDArray[np.int8], IntArray, IntArray]
"""What a search knows of its states: when each is reached at best (s), from which one, in which
direction it goes on; and each safe interval's place, each place's row among the links around the
goal (-1: none)."""


@inner
def _arrived(lattice: Lattice, task: Errand, safe: TimeSets, states: States, most: int) -> int:
    """Return the state in which a body is at rest at its goal (-1: not found)."""
    places, cols, still = lattice.free.size, lattice.free.shape[1], len(task.drives)
    queue, done = _begun(task, safe, places, states[0]), 0
    soonest, most = _soonest(task, safe, places + 1, most)
    # what is taken out of records in the loop is counted as used each time: ten times as slow
    near, head, intervals = lattice.near, safe.head, safe.intervals
    best, parent, ahead, place_of, links = states
    drives, turns, to_go, starts, goals, source, target, top, stop, lag, _, due = task
    ways_off, ways_in = source.way / top, target.way / top
    set_off, towards, arriving = source.place, source.direction, target.direction
    while len(queue) > 0 and done < most:
        _, _, t, key = heapq.heappop(queue)
        if t > best[key] + 1e-9:
            continue
        done, r, d = done + 1, key // 2, ahead[key]
        place, until = place_of[r], intervals[r, 1]
        if place == places + 1:
            return key
        if d != still and t + stop <= until:
            _halt(queue, best, parent, key, (t + stop, to_go[place], soonest))
        latest = until if d == still else min(t + lag, until)
        for w in range(len(set_off) if place == places else still + 1):
            there, e, took = -1, 0, 0.0
            if place == places:
                there, e, took = set_off[w], towards[w], ways_off[w]
            elif w < still:
                there, e, took = near[place, w], w, drives[w]
            elif links[place] >= 0:
                there, e, took = places + 1, arriving[links[place]], ways_in[links[place]]
            if there < 0 or turns[d, e] == np.inf:
                continue
            half, ends = 0.5 * took, there == places + 1
            took += turns[d, e] + (starts[e] if place == places else 0.0)
            inside, left = place < places and not ends, 0.0 if ends else to_go[there]
            for q in range(head[there], head[there + 1]):
                low, high = intervals[q, 0], intervals[q, 1]
                if low > latest + took:
                    break
                at = max(t + took, low)
                after = at + stop + goals[e] if ends else at
                late = after + left >= due or after >= best[2 * q] - 1e-9
                if late or at >= high or (ends and high < np.inf):
                    continue
                if inside and not _clear_between(cols, head, intervals, place, e, at - half):
                    continue
                best[2 * q], parent[2 * q], ahead[2 * q] = after, key, e
                heapq.heappush(queue, (max(after + EAGER * left, soonest), left, after, 2 * q))
    return -1


@kernel
def search(lattice: Lattice, task: Errand, safe: TimeSets, most: int) -> FloatArray:
    """Return the rows (place, arrival s) of a way from the start to the goal (none: not found with
    ``most`` states expanded).

    ``safe``: when places are free, then the start, the goal. A state is a safe interval in which
    the body moves, in the direction in which it first came, or stands (odd). Of those that may
    arrive as soon, which is often when the goal gets free, the nearest is expanded first.
    """
    best = np.full(2 * len(safe.intervals), np.inf)
    parent = np.full(len(best), -1, dtype=np.int32)
    ahead = np.full(len(best), len(task.drives), dtype=np.int8)
    place_of, links = _tables(task, safe, lattice.free.size)
    last = _arrived(lattice, task, safe, (best, parent, ahead, place_of, links), most)
    return np.empty((0, 2)) if last < 0 else _traced(place_of, best, parent, last)


# ------------------ The lattice of a floor


_proposers: WeakKeyDictionary[Workspace, Proposer | None] = WeakKeyDictionary()


def proposer_of(workspace: Workspace) -> Proposer | None:
    """Return who proposes ways among reservations, if there is a scene to search in."""
    if workspace not in _proposers:
        scene = workspace.scene
        _proposers[workspace] = None if scene is None else Proposer(scene)
    return _proposers[workspace]


class Seen(NamedTuple):
    """What a run keeps from others: where it is at some ``times`` (s), ``during`` its first and
    last moment, and its ``visits`` to the places of a lattice, by the distance that counts (m).
    """

    times: FloatArray
    poses: FloatArray
    during: FloatArray
    visits: dict[tuple[float, float], FloatArray]


class Proposer:
    """Proposes ways for bodies on one floor. What a run keeps from others is remembered with it."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._lattices: Memory[Lattice | None] = Memory(16)
        self._tasks: Memory[tuple[Links, Links, FloatArray]] = Memory(4_000)
        self._paths: Memory[Path | None] = Memory(8_000)
        self._seen: WeakKeyDictionary[TimedPath, Seen] = WeakKeyDictionary()

    def propose(
        self,
        motion: TimedMotion,
        others: Sequence[TimedPath],
        *,
        until: float = math.inf,
        wide: bool = False,
        most: int = 40_000,
    ) -> Path | None:
        """Return a way of a motion among the runs of others, if one is found that it can drive.

        :param until: what arrives later (s) is of no use.
        :param wide: bodies are the discs around them, not discs of about their size.
        """
        able, whole = motion.body.mobility, motion.poses
        motion = replace(motion, poses=before_docking(motion.body, whole))
        if able.own_law or able.flies or len(motion.poses) != 2:
            return None
        hull = hull_of(motion.body)
        for radius in (hull.radius, _disc(motion.body)):
            lattice = self._lattice(motion.body, motion.poses, radius)
            if lattice is None:
                return None
            source, target, to_go = self._task(motion, lattice)
            if len(source.place) and np.any(np.isfinite(to_go[source.place])):
                break
        else:
            return None
        safe = self._safe(motion, lattice, others, wide)
        for flip in _sides(motion, able):
            times = float(motion.release), float(until)
            task = _timed_task(motion, lattice, times, (source, target, to_go), flip)
            rows = search(lattice, task, safe, most)
            if len(rows):
                path = self._drivable(motion, whole, lattice, rows, safe, flip)
                if path is not None:
                    return path
        return None

    def _lattice(self, body: Body, poses: Sequence[Configuration], radius: float) -> Lattice | None:
        hull = hull_of(body)

        def made() -> Lattice | None:
            low, high = search_box(self._scene, poses, (), 16 * hull.radius)
            step = STEP * hull.radius
            cols, rows = (max(1, math.ceil(v / step) + 1) for v in high - low)
            if cols * rows > PLACES:
                return None
            free, need = np.ones((rows, cols), dtype=np.bool_), radius + self._scene.margin
            if self._scene.grid is not None:
                for j, i in itertools.product(range(rows), range(cols)):
                    at = low[0] + i * step, low[1] + j * step
                    free[j, i] = self._scene.room(*at) >= need
            rules, frame = shape_of(body).data.ways, np.array([*low, step])
            near = neighbours(frame, free, rules, WAYS, self._scene.data, need)
            return Lattice(float(low[0]), float(low[1]), step, radius, free, rules, near)

        where = None if self._scene.grid is not None else tuple(poses)
        return self._lattices.get_or((body.footprint, body.kinematics.ways, where, radius), made)

    def _task(self, motion: TimedMotion, lattice: Lattice) -> tuple[Links, Links, FloatArray]:
        def made() -> tuple[Links, Links, FloatArray]:
            ends = [
                links_of(lattice, float(pose[0]), float(pose[1]), sign, WAYS)
                for pose, sign in zip(motion.poses, (1, -1), strict=True)
            ]
            metres = distances(lattice, ends[1], WAYS)
            return ends[0], ends[1], metres / motion.body.kinematics.v_max

        return self._tasks.get_or((motion.body, motion.poses, lattice.radius), made)

    def _safe(
        self, motion: TimedMotion, lattice: Lattice, others: Sequence[TimedPath], wide: bool
    ) -> TimeSets:
        """Return when places are free, then the start, then the goal."""
        count = lattice.free.size
        parts = []
        size = _around if wide else _disc
        mine = size(motion.body)
        ends = np.array([p[:2] for p in motion.poses], dtype=np.float64)
        for other in others:
            if other.object == motion.object or other.path.body.flies:
                continue
            if not pair_flags(motion.object, motion.avoid, other.object, other.avoid):
                continue
            reach = mine + size(other.path.body) + self._scene.margin
            if other not in self._seen:
                during = np.array([other.since, other.until])
                self._seen[other] = Seen(*_sampled(other), during, {})
            seen = self._seen[other]
            rows = visits_of_ends(ends, seen.times, seen.poses, seen.during, reach)
            rows[:, 0] += count
            parts += [self._visited(lattice, seen, reach), rows]
        rows = np.concatenate(parts) if parts else np.empty((0, 3))
        return safe_intervals(rows, count)

    def _visited(self, lattice: Lattice, seen: Seen, reach: float) -> FloatArray:
        key = (reach, lattice.step)
        if key not in seen.visits:
            seen.visits[key] = visits(lattice, seen.times, seen.poses, seen.during, reach)
        return seen.visits[key]

    def _drivable(
        self,
        motion: TimedMotion,
        whole: tuple[Configuration, ...],
        lattice: Lattice,
        rows: FloatArray,
        safe: TimeSets,
        flip: bool,
    ) -> Path | None:
        points = _points(lattice, motion, rows)
        able = motion.body.mobility
        pivots = able.pivots and not able.sideways
        points = _pulled(self._scene, lattice, points, rows, safe, pivots)
        key = (motion.body, whole, points.tobytes(), flip)

        def made() -> Path | None:
            path = drivable(self._scene, motion.body, motion.poses, points, flip)
            return path if path is None else docked(self._scene, path, whole)

        return self._paths.get_or(key, made)


def _disc(body: Body) -> float:
    """Return the radius (m) of the disc that stands for a body."""
    hull = hull_of(body)
    return 0.5 * (hull.radius + max(0.0, hull.core))


def _around(body: Body) -> float:
    """Return the radius (m) of the disc around a body."""
    return hull_of(body).radius


def _sides(motion: TimedMotion, able: Mobility) -> tuple[bool, ...]:
    """Return whether to drive ahead or backwards (True), what turns less first."""
    if able.sideways or not motion.body.kinematics.reverse:
        return (False,)
    (x, y, first), (u, v, last) = (pose[:3] for pose in motion.poses)
    way = math.atan2(v - y, u - x)
    ahead = math.cos(first - way) + math.cos(last - way) >= 0.0
    return (False, True) if ahead else (True, False)


def _timed_task(
    motion: TimedMotion,
    lattice: Lattice,
    times: tuple[float, float],
    known: tuple[Links, Links, FloatArray],
    flip: bool,
) -> Errand:
    kin, able = motion.body.kinematics, motion.body.mobility
    ways = np.arctan2(WAYS[:, 1], WAYS[:, 0]) + math.pi * flip
    costs = []
    for pose in motion.poses:
        turn = np.abs(np.remainder(ways - pose[2] + math.pi, 2 * math.pi) - math.pi)
        if able.sideways:
            costs.append(np.zeros(len(ways)))
        elif able.pivots:
            costs.append(turn / kin.omega_max)
        else:
            costs.append(np.maximum(0.0, turn - 0.4) * 2.0 * kin.bend_radius / kin.v_max)
    source, target, to_go = known
    stop = kin.v_max / (2 * kin.a_max)
    units = WAYS / np.hypot(*WAYS.T)[:, None]
    turns = 1.0 - units @ units.T
    # a right angle costs 0.3 s, and hardly more than one is not driven without a stop
    turns = np.vstack([np.where(turns > 1.2, np.inf, 0.3 * turns), np.full(len(WAYS), stop)])
    drives = lattice.step * np.hypot(*WAYS.T) / kin.v_max
    return Errand(
        drives,
        turns,
        to_go,
        costs[0],
        costs[1],
        source,
        target,
        kin.v_max,
        stop,
        1.2 * stop,
        *times,
    )


def _sampled(run: TimedPath) -> tuple[FloatArray, FloatArray]:
    """Return a run's moments about ``SAMPLE`` s apart, and where it is then."""
    times, poses = run.timing.trajectory.times, run.timing.trajectory.poses
    if len(times) == 1:
        return times.copy(), poses.copy()  # numba compiles anew for arrays that cannot be written
    count = max(2, math.ceil((times[-1] - times[0]) / SAMPLE) + 1)
    at = np.linspace(times[0], times[-1], count)
    rows = np.stack([np.interp(at, times, poses[:, k]) for k in range(3)], axis=1)
    return at, rows


def _points(lattice: Lattice, motion: TimedMotion, rows: FloatArray) -> FloatArray:
    """Return the corners (k, 2) of a way over places, each place once."""
    cols = lattice.free.shape[1]
    count = lattice.free.size
    keep = np.concatenate([[True], np.diff(rows[:, 0]) != 0])
    places = rows[keep, 0].astype(np.int64)
    inside = places < count
    points = np.empty((len(places), 2))
    points[:, 0] = lattice.x + (places % cols) * lattice.step
    points[:, 1] = lattice.y + (places // cols) * lattice.step
    points[~inside & (places == count)] = motion.poses[0][:2]
    points[~inside & (places == count + 1)] = motion.poses[-1][:2]
    return points


def _pulled(
    scene: Scene,
    lattice: Lattice,
    points: FloatArray,
    rows: FloatArray,
    safe: TimeSets,
    pivots: bool,
) -> FloatArray:
    """Return a way without the corners that can be left out, as far as the lattice tells."""
    arrive = np.array([rows[rows[:, 0] == p, 1].min() for p in dict.fromkeys(rows[:, 0])])
    if len(arrive) != len(points):  # it comes by the same place twice
        return points
    need = lattice.radius + scene.margin
    # who turns on the spot needs no more there than on straight ways
    room = need, 0.0 if pivots else need
    return points[pulled(lattice, np.column_stack((points, arrive)), safe, scene.data, room)]


@inner
def _straight(
    lattice: Lattice,
    run: FloatArray,
    pair: tuple[int, int],
    safe: TimeSets,
    grid: GridData,
    room: tuple[float, float],
) -> bool:
    """Return whether a body can go straight between two corners of a ``run`` (x, y, arrival) where
    it may and the map has ``room`` for it (m: amid, and near to corners; near both ends of the
    run it needs none), at times at which it is safe.
    """
    i, j = pair
    if not piece_obeys(lattice.rules, run[i, 0], run[i, 1], run[j, 0], run[j, 1], 0.0, 0.0):
        return False
    rows, cols = lattice.free.shape
    dx, dy = run[j, 0] - run[i, 0], run[j, 1] - run[i, 1]
    length = np.sqrt(dx * dx + dy * dy)
    count = int(length / (0.5 * lattice.step)) + 1
    for k in range(1, count):
        share = k / count
        x, y = run[i, 0] + share * dx, run[i, 1] + share * dy
        amid = min(share, 1.0 - share) * length > 2 * lattice.step
        begins = i == 0 and share * length <= 2 * lattice.step
        ends = j == len(run) - 1 and (1.0 - share) * length <= 2 * lattice.step
        least = room[0] if amid else -np.inf if begins or ends else room[1]
        if point_clearance(grid, x, y) < least:
            return False
        col = min(cols - 1, max(0, round((x - lattice.x) / lattice.step)))
        row = min(rows - 1, max(0, round((y - lattice.y) / lattice.step)))
        t = run[i, 2] + share * (run[j, 2] - run[i, 2])
        if lattice.free[row, col] and not _free_at(safe.head, safe.intervals, row * cols + col, t):
            return False
    return True


@kernel
def pulled(
    lattice: Lattice, run: FloatArray, safe: TimeSets, grid: GridData, room: tuple[float, float]
) -> IntArray:
    """Return which corners of a ``run`` (x, y, arrival) to keep: each leads straight on to the
    farthest one that it can reach, at times between those of the way.
    """
    n = len(run)
    keep = np.empty(n, dtype=np.int64)
    keep[0], used, i = 0, 1, 0
    while i < n - 1:
        best = i + 1
        for j in range(i + 2, n):
            if _straight(lattice, run, (i, j), safe, grid, room):
                best = j
        keep[used] = best
        used += 1
        i = best
    return keep[:used].copy()
