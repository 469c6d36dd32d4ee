"""One robot among movers: a ladder from the best path at full speed to new ways round.

1. the best path among what rests there all the time, begun as soon as its planner's own timing
   meets nothing; 2. its speed tuned; 3. other paths, in a lane beside it, around parked robots and
   the places where it would meet the movers, each tuned.

Here are these other paths, too, those past the places where others may stand, and for two robots
that meet on one line; and what a body can drive of a way.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from up_samp.geometry.kernels import first_hit, path_free
from up_samp.geometry.records import WorldData
from up_samp.geometry.scene import Scene
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Kinematics,
    Mobility,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    TimedMotion,
    Trajectory,
)
from up_samp.model.arrays import FloatArray
from up_samp.motion.curves.reeds_shepp import DriveLimits, merged, nodes_of
from up_samp.motion.curves.rolling import rolled, rolling_radius, thinned
from up_samp.motion.curves.trajectories import unwound
from up_samp.motion.curves.trapezoid import limits_of, trajectory_of
from up_samp.motion.fleet.conflicts import ROOM
from up_samp.motion.fleet.lanes import curves_through, lane_offsets
from up_samp.motion.fleet.paths import (
    LEVELS,
    Path,
    path_of,
    safe_intervals,
    shared_stretch,
)
from up_samp.motion.fleet.speed import fit, parked_all_the_time, tune
from up_samp.motion.fleet.timed_path import ON_TIME, TimedPath, natural_timing, run_of
from up_samp.motion.fleet.workspace import Workspace
from up_samp.motion.guides import widest_shape
from up_samp.motion.legs import before_docking, dock_of, docking_leg, strung
from up_samp.motion.protocol import Leg, LegQuery


@dataclass(frozen=True, eq=False)
class Attempt:
    """What came of planning one motion: a ``run``, or none and the ``report`` that says why."""

    run: TimedPath | None
    report: PathReport | None = None
    met: frozenset[str] = field(default_factory=frozenset)
    """Objects in the way of the best path at full speed."""


def plan_one(
    workspace: Workspace,
    motion: TimedMotion,
    others: Sequence[TimedPath],
    deadline: Deadline,
) -> Attempt:
    """Return a safe run of ``motion`` among ``others``: the first one found that is on time, or
    else the earliest.
    """
    static = parked_all_the_time(motion, others)
    first = workspace.path(motion.body, motion.poses, static, deadline)
    if not isinstance(first, Path):
        # perhaps something leaves later: what is there now need not be there for ever
        static = [p for p in static if _lasts(p, others)]
        second = workspace.path(motion.body, motion.poses, static, deadline)
        if not isinstance(second, Path):
            return Attempt(None, second, second.blockers or first.blockers)
        first = second
    best = fit(workspace, motion, first, others)
    if is_good(best, motion):
        return Attempt(best)
    met = met_at_full_speed(workspace, motion, first, others)
    best = with_lanes(workspace, motion, first, best, others)
    if not is_good(best, motion):
        best = with_detours(workspace, motion, first, best, others, static, deadline)
    names = frozenset(o.object for o, _, _ in met)
    why = PathReport(nothing(deadline), blockers=names, reason="no safe timing or detour found")
    return Attempt(best, why, names)


def _lasts(placed: Placed, others: Iterable[TimedPath]) -> bool:
    return any(
        o.object == placed.name and o.path.cells == 0 and o.until == math.inf for o in others
    )


def nothing(deadline: Deadline) -> Outcome:
    """Return what it means that nothing was found: the search is at its end, or the time is."""
    return Outcome.OUT_OF_TIME if deadline.expired() else Outcome.NOT_FOUND


# ------------------ Other paths: in a lane beside the best one, and around whom it would meet


CUTS = (math.inf, 0.3, 0.1, 0.02)
"""By how much a way's corners are cut off at most, in turn: shares of a footprint's diameter."""
ROUNDS = 4
"""Of paths around, and of lanes beside, what the last path met."""
BESIDE = (1.0, 1.4)
"""Shares, in turn, of the room that two lanes take at least."""
STRETCH = (2.0, 6.0)
"""How long two lanes are, in turn, in radii of both; a quarter of it lies before both meet."""


def is_good(run: TimedPath | None, motion: TimedMotion) -> bool:
    """Return whether a run arrives in time."""
    return run is not None and run.arrival <= motion.due + ON_TIME


def met_at_full_speed(
    workspace: Workspace,
    motion: TimedMotion,
    path: Path,
    others: Sequence[TimedPath],
) -> list[tuple[TimedPath, int, float]]:
    """Return the runs it meets when it drives ``path`` at once, with their cell and when."""
    run = run_of(motion, path, natural_timing(path, motion.release))
    found = []
    for other in others:
        at, _, cell = workspace.meeting(run, other)
        if at < math.inf:
            found.append((at, other.object, cell, other))
    found.sort(key=lambda item: item[:3])
    return [(other, cell, at) for at, _, cell, other in found]


def with_lanes(
    workspace: Workspace,
    motion: TimedMotion,
    path: Path,
    best: TimedPath | None,
    others: Sequence[TimedPath],
) -> TimedPath | None:
    """Return the best of ``best`` and of paths that change lanes where ``path`` meets somebody.

    Tight places, errands and first plans end as well without; proofs need it, of three robots
    through a doorway (``tests/search/test_strengths.py``) and of published job shops.
    """
    for _ in range(ROUNDS):
        met = met_at_full_speed(workspace, motion, path, others)
        if not met or len(before_docking(motion.body, motion.poses)) != 2:
            break
        options = []
        for lane in _lanes(workspace, motion, path, met[0][0]):
            best = fit(workspace, motion, lane, others, best)
            if is_good(best, motion):
                return best
            # go on from the lane that gets furthest at full speed
            again = met_at_full_speed(workspace, motion, lane, others)
            options.append((-again[0][2] if again else -math.inf, lane.number, lane))
        if not options:
            break
        path = min(options, key=lambda option: option[:2])[2]
    return best


def _lanes(
    workspace: Workspace, motion: TimedMotion, path: Path, other: TimedPath
) -> Iterator[Path]:
    """Yield versions of ``path`` that pass ``other`` sideways where it would be met."""
    run = run_of(motion, path, natural_timing(path, motion.release))
    at, _, _ = workspace.meeting(run, other)
    runs = workspace.conflicts(path, other.path)
    first, last = shared_stretch(runs, run.held, other.held, at)
    if workspace.scene is None or first < 1 or last > path.cells:
        return
    for offset in lane_offsets(path, other.path):
        lane = workspace.lane(path, float(path.edges[first - 1]), float(path.edges[last]), offset)
        if lane is not None:
            yield lane


def with_detours(
    workspace: Workspace,
    motion: TimedMotion,
    path: Path,
    best: TimedPath | None,
    others: Sequence[TimedPath],
    static: Sequence[Placed],
    deadline: Deadline,
) -> TimedPath | None:
    """Return the best of ``best``, of paths straight to where somebody leaves, and of paths around
    whatever the last path met at full speed.
    """
    for coming in _paths_in(workspace, motion, static, others, deadline):
        best = fit(workspace, motion, coming, others, best)
    copies: list[Placed] = []
    for _ in range(ROUNDS):
        met = met_at_full_speed(workspace, motion, path, others)
        virtual = virtual_obstacles(workspace, path, met[:2])
        if not virtual or deadline.expired():
            break
        copies += virtual
        other_path = workspace.detour(motion.body, motion.poses, static, copies, deadline)
        if other_path is None:
            break
        path = other_path
        best = fit(workspace, motion, path, others, best)
        if is_good(best, motion):
            break
    return best


def _paths_in(
    workspace: Workspace,
    motion: TimedMotion,
    static: Sequence[Placed],
    others: Sequence[TimedPath],
    deadline: Deadline,
) -> Iterator[Path]:
    """Yield paths that come nearly straight to a pose that somebody leaves, close behind: a tighter
    bend would be in the way for longer.
    """
    body, goal, kin = motion.body, motion.poses[-1], motion.body.kinematics
    if not (body.mobility.steers or body.mobility.rolls) or dock_of(body, goal):
        return
    rest = workspace.resting(body, goal)
    left = (workspace.conflicts(rest, o.path)[:, 1] for o in others if o.path.cells > 0)
    if not any(np.any(first == 0) for first in left):
        return
    braking = kin.v_max**2 / (2 * kin.a_max)
    radius = max(2 * braking, kin.bend_radius)
    for curvature in (0.0, 1.0 / radius, -1.0 / radius):
        nodes = nodes_of(np.array(goal, dtype=np.float64), np.array([[curvature, -braking]]))
        poses = (*motion.poses[:-1], tuple(map(float, nodes[-1])), goal)
        path = workspace.detour(body, poses, static, (), deadline)
        if path is not None:
            yield path


def virtual_obstacles(
    workspace: Workspace,
    path: Path,
    met: Sequence[tuple[TimedPath, int, float]],
) -> list[Placed]:
    """Return copies of the runs that were met, where their path conflicts with ``path``.

    Copies closer to the first or the last pose of the motion than the margin are left out: it has
    to be there, and with them no way would keep more of the margin, from anything.
    """
    virtual: list[Placed] = []
    for other, cell, _ in met:
        runs = workspace.conflicts(path, other.path)
        hits = np.unique(np.concatenate([np.arange(a, b + 1) for _, a, b in runs]))
        size, reach = (3 if other.path.body.flies else 2), other.path.radius + path.radius
        centre = other.path.middle(cell)[:size]
        last = (math.inf,) * size
        for j in hits:
            pose = other.path.middle(int(j))
            near = math.dist(pose[:size], centre) <= 4 * reach
            # copies of its body, a little less than its radius apart, leave no gap to go through
            if not near or math.dist(pose[:size], last) < 0.8 * other.path.radius:
                continue
            if workspace.crowds(path, other.path.body, pose):
                continue
            last = pose[:size]
            virtual.append(Placed(f"{other.object}~{j}", other.path.body, pose))
    return virtual


# ------------------ Ways past the places where others may stand
# A robot's best way leads through places where others load or wait. On it, it has to wait for
# them; on a way past all such places it meets only those that drive. Such ways depend on nobody's
# times, so they are looked for once, before anything is decided. (On a *well-formed* floor there
# is one for each motion; Čáp, Novák, Kleiner and Selecký, IEEE T-ASE 2015.)


Stand = tuple[Body, Configuration]
"""Who may stand where."""


def ways_past(
    workspace: Workspace,
    poses: tuple[Configuration, ...],
    best: Path,
    stands: Sequence[Stand],
    deadline: Deadline,
    *,
    tries: int,
) -> Iterator[Path]:
    """Yield ways through poses, as the ``best`` path drives through them: past those of some stands
    that it runs into, then past those, too, that this way runs into, and so on.

    Stands near its ends are left out: there it has to be.

    :param tries: so many ways are looked for.
    """
    others = [s for s in stands if not workspace.crowds(best, *s)]
    path, avoided = best, dict[Stand, Placed]()
    for _ in range(tries):
        met = [s for s in others if len(workspace.conflicts(path, workspace.resting(*s)))]
        if not met or deadline.expired():
            return
        avoided.update((s, Placed(f"stand {len(avoided) + n}", *s)) for n, s in enumerate(met))
        found = workspace.detour(path.body, poses, (), list(avoided.values()), deadline)
        if found is None:
            return
        yield found
        path = found


# ------------------ Two robots that would meet on one line pass each other
# Each in a lane of its own. Where a way is just wide enough for both, neither can stay in the
# middle of it: who goes first has to leave room for who comes. Lanes to both sides are tried, as
# far from the paths as it takes and a bit more, around where the two would meet and longer ones.


def pass_by(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    alone: Mapping[str, TimedPath],
    world: Sequence[TimedPath],
) -> dict[str, TimedPath] | None:
    """Return runs of two motions from pose to pose in the plane in lanes beside their best paths
    (``alone``: their runs without each other), those in which the last one arrives soonest; None if
    none are found, or there are not two.
    """
    if len(motions) != 2:
        return None
    runs = [alone[m.name] for m in motions]
    at, _, _ = workspace.meeting(*runs)
    if at == math.inf:
        return None
    for lanes in _passing_lanes(workspace, runs, at):
        found = [_runs(workspace, motions, lanes, order, world) for order in ((0, 1), (1, 0))]
        some = [f for f in found if f is not None]
        if some:
            return min(some, key=lambda f: max(run.arrival for run in f.values()))
    return None


def _runs(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    lanes: Sequence[Path],
    order: tuple[int, int],
    world: Sequence[TimedPath],
) -> dict[str, TimedPath] | None:
    """Return the runs in two lanes, the first one of an order as soon as it can."""
    found: dict[str, TimedPath] = {}
    for i in order:
        motion = motions[i]
        run = fit(workspace, motion, lanes[i], [*world, *found.values()])
        if run is None:
            return None
        found[motion.name] = run
    return found


def _passing_lanes(
    workspace: Workspace, runs: Sequence[TimedPath], at: float
) -> Iterator[tuple[Path, Path]]:
    """Yield pairs of lanes of two runs that meet at a time."""
    met = [float(np.interp(at, r.timing.trajectory.times, r.timing.s)) for r in runs]
    reach = sum(r.path.hull.radius for r in runs)
    air = workspace.margin + ROOM
    apart = 0.5 * (sum(_half_width(r.path, s) for r, s in zip(runs, met, strict=True)) + air)
    for stretch, share in itertools.product(STRETCH, BESIDE):
        for sides in ((-1, -1), (1, 1), (-1, 1), (1, -1)):
            found = []
            for run, s, side in zip(runs, met, sides, strict=True):
                first, last = s - 0.25 * stretch * reach, s + 0.75 * stretch * reach
                inside = 0.0 < first < last < run.path.length
                offset = side * share * apart
                lane = workspace.lane(run.path, first, last, offset) if inside else None
                if lane is None:
                    break
                found.append(lane)
            if len(found) == 2:
                yield found[0], found[1]


def _half_width(path: Path, s: float) -> float:
    """Return how far a body reaches to the side of its way at ``s`` m along its path."""
    near = 0.1 * path.hull.radius
    a, here, b = path.poses_at(np.clip([s - near, s, s + near], 0.0, path.length))
    way = math.atan2(b[1] - a[1], b[0] - a[0])
    turn = float(here[2]) - way
    corners = np.array(path.body.footprint)
    return float(np.abs(corners @ (math.sin(turn), math.cos(turn))).max())


# ------------------ What a body can drive of a way


def drivable(
    scene: Scene, body: Body, poses: tuple[Configuration, ...], points: FloatArray, flip: bool
) -> Path | None:
    """Return a path of a body along corners (k, 2), with its corners rounded, if the map allows."""
    kin, able = body.kinematics, body.mobility
    shape = widest_shape(scene, body, poses, ())
    if shape is None:
        return None
    world = scene.world(shape)
    if able.sideways or able.pivots:
        # where the widest bends meet something (a door's frame), sharper ones may not
        size = float(np.hypot(*np.ptp(np.array(body.footprint), axis=0)))
        bends = (_bent(points, able, kin, cut * size) for cut in CUTS)
        found = (_rolled(world, body, poses, rows, flip) for rows in bends)
        return next((path for path in found if path is not None), None)
    steered = (_steered(poses, points, limits_of(kin), flip, near) for near in (False, True))
    start = np.array(poses[0], dtype=np.float64)
    for arcs in steered:
        if arcs is None or path_free(world, start, arcs) >= 0:
            continue
        if math.dist(nodes_of(start, arcs)[-1][:2], poses[1][:2]) <= 1e-7:
            return path_of(trajectory_of(poses, arcs, kin), body, poses)
    return None


def docked(scene: Scene, path: Path, poses: tuple[Configuration, ...]) -> Path | None:
    """Return a path through ``poses`` that goes on straight to a dock after ``path``, if that is
    where they lead, and nothing of the map is in the way.
    """
    if poses == before_docking(path.body, poses):
        return path
    leg = docking_leg(scene, LegQuery(path.body, poses[-2], poses[-1]))
    if leg is None or leg.trajectory is None:
        return None
    whole, _ = strung(scene, PathQuery(path.body, poses), [Leg(path.natural), leg])
    return path_of(whole, path.body, poses)


def _bent(points: FloatArray, able: Mobility, kin: Kinematics, cut: float) -> FloatArray | None:
    """Return a way along corners with the bends that a body may drive fast."""
    if able.sideways:
        return _rounded(points, kin.v_max**2 / kin.a_max, cut)
    radius = rolling_radius(kin)
    # a tighter arc is slower than the lowest speed that a path's cells have
    return _rounded(points, radius, cut, radius / math.sqrt(LEVELS))


def _rolled(
    world: WorldData,
    body: Body,
    poses: tuple[Configuration, ...],
    rows: FloatArray | None,
    flip: bool,
) -> Path | None:
    """Return the path along a way of what moves sideways or turns on the spot, if it is free."""
    if rows is None:
        return None
    if body.mobility.sideways:
        return _slid(body, poses, rows, world)
    rows = thinned(_turned(poses, rows, flip), body.kinematics)
    if first_hit(world, rows) >= 0:
        return None
    return path_of(rolled(rows, body.kinematics), body, poses)


def _rounded(
    points: FloatArray, radius: float, cut: float, least: float = 0.0
) -> FloatArray | None:
    """Return a way (n, 3) along corners with arcs of up to ``radius`` m in them, that pass no more
    than ``cut`` m from them; headings are the directions of travel. Where it turns back there is no
    arc, and where there is room for none of ``least`` m it turns on the spot.
    """
    parts = [np.append(points[0], 0.0)[None, :]]
    for i in range(len(points) - 1):
        gone = points[i + 1] - points[i]
        size = float(np.hypot(*gone))
        if size < 1e-9:
            return None
        way = math.atan2(gone[1], gone[0])
        if i == 0:
            parts[0][0, 2] = way
        if i + 2 == len(points):
            parts.append(np.array([[*points[-1], way]]))
            break
        ahead = points[i + 2] - points[i + 1]
        turn = math.remainder(math.atan2(ahead[1], ahead[0]) - way, 2 * math.pi)
        if abs(turn) < 1e-6:
            continue
        if abs(turn) > 2.4:
            parts.append(np.array([[*points[i + 1], way]]))
            continue
        half = math.tan(0.5 * abs(turn))
        widest = min(radius, cut / (math.hypot(1.0, half) - 1.0))
        reach = min(widest * half, 0.45 * size, 0.45 * float(np.hypot(*ahead)))
        r = reach / half
        if r < least:
            parts.append(np.array([[*points[i + 1], way], [*points[i + 1], way + turn]]))
            continue
        corner = points[i + 1] - reach * gone / size
        count = max(2, math.ceil(r * abs(turn) / 0.05), math.ceil(abs(turn) / 0.08))
        arcs = np.array([[math.copysign(1.0 / r, turn), r * abs(turn) / count]] * count)
        parts.append(nodes_of(np.array([*corner, way]), arcs))
    return np.concatenate(parts)


def _slid(
    body: Body, poses: tuple[Configuration, ...], rows: FloatArray, world: WorldData
) -> Path | None:
    """Return the path of a body that moves sideways along a way, turning where there is room."""
    kin = body.kinematics
    turn = math.remainder(poses[1][2] - poses[0][2], 2 * math.pi)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rows[:, :2], axis=0).T))])
    length = float(way[-1])
    takes = min(length, abs(turn) * kin.v_max / kin.omega_max)
    # samples on straight pieces: to turn evenly, and as a bend keeps the speed up to the next one
    counts = [max(1, math.ceil((b - a) / 0.06)) for a, b in itertools.pairwise(way)]
    parts = [
        np.linspace(*ends, count + 1)[:-1]
        for ends, count in zip(itertools.pairwise(way), counts, strict=True)
    ]
    at = np.concatenate([*parts, way[-1:]])
    for first in dict.fromkeys((0.0, length - takes, 0.5 * (length - takes))):
        x, y = (np.interp(at, way, rows[:, k]) for k in (0, 1))
        share = np.clip((at - first) / max(takes, 1e-9), 0.0, 1.0)
        found = np.stack([x, y, poses[0][2] + turn * share], axis=1)
        found[0], found[-1, :2] = poses[0], poses[1][:2]
        if first_hit(world, found) < 0:
            return _timed_slide(body, poses, found)
    return None


def _timed_slide(body: Body, poses: tuple[Configuration, ...], rows: FloatArray) -> Path | None:
    """Return the path along a way, with the fastest timing that its bends allow."""
    kin = body.kinematics
    gone = np.diff(rows[:, :2], axis=0)
    steps = np.hypot(*gone.T)
    way = np.unwrap(np.arctan2(gone[:, 1], gone[:, 0]))
    bend = np.abs(np.diff(way)) / (0.5 * (steps[1:] + steps[:-1]))
    bend = np.concatenate([[0.0], np.where(np.abs(np.diff(way)) > 0.35, 0.0, bend), [0.0]])
    sharp = np.maximum(bend[1:], bend[:-1])
    speeds = np.minimum(kin.v_max, np.sqrt(kin.a_max / np.maximum(sharp, 1e-9)))
    times = np.concatenate([[0.0], np.cumsum(steps / speeds)])
    path = path_of(Trajectory(times, rows), body, poses)
    timing = tune(path, safe_intervals(np.empty((0, 3)), path.cells), 0.0, -math.inf)
    if timing is None:
        return None
    return replace(path, natural=timing.trajectory, natural_s=timing.s)


def _turned(poses: tuple[Configuration, ...], rows: FloatArray, flip: bool) -> FloatArray:
    """Return a way with turns on the spot where it begins, turns back and ends."""
    first, goal = (np.array([pose[:3]], dtype=np.float64) for pose in poses)
    rows = rows + np.array([0.0, 0.0, math.pi * flip])
    rows[:, 2] = np.unwrap(rows[:, 2])
    rows = unwound(rows, first[0])
    parts = [first]
    for a, b in itertools.pairwise(rows):
        parts.append(a[None, :])
        way = math.atan2(b[1] - a[1], b[0] - a[0]) + math.pi * flip
        if abs(math.remainder(way - a[2], 2 * math.pi)) > 1.0:  # it turned back here
            parts.append(np.array([[*a[:2], b[2]]]))
    return np.concatenate([*parts, rows[-1:], unwound(goal, rows[-1])])


def _steered(
    poses: tuple[Configuration, ...], points: FloatArray, car: DriveLimits, flip: bool, near: bool
) -> FloatArray | None:
    """Return a car's arcs from pose to pose by way of the middles of straight pieces, or from one
    end of each to the other, as ``near`` to the corners as its tightest arcs allow.
    """
    gone = np.diff(points, axis=0)
    headings = np.arctan2(gone[:, 1], gone[:, 0])
    turns = np.abs((np.diff(headings) + math.pi) % (2 * math.pi) - math.pi)
    bends = np.array([0.0, *car.radius * np.tan(0.5 * np.minimum(turns, 2.4)), 0.0])
    marks = [poses[0]]
    for i, size in enumerate(np.hypot(*gone.T)):
        spare = (bends[i], bends[i + 1]) if near else (0.4 * size, 0.4 * size)
        long = sum(spare) < size if near else size >= 2.0 * car.radius and len(points) > 2
        shares = (spare[0] / size, 1.0 - spare[1] / size) if long else (0.5,)
        way = float(headings[i]) + math.pi * flip
        marks += [(*(points[i] + s * gone[i]), way) for s in shares if 0.0 < s < 1.0]
    marks.append(poses[1])
    ways = (math.dist(p[:2], q[:2]) for p, q in itertools.pairwise(marks))
    found = curves_through(marks, ways, car)
    return None if found is None else merged(np.concatenate(found))
