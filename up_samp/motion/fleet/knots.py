"""Knots solved by construction: joint moves on roadmaps, made into drives that need few stops.

Where no order of priorities works, a plan for everybody is searched on roadmaps of rest poses
(:mod:`up_samp.motion.fleet.lacam`), coarse to fine. It is then loosened: moves that do not meet are
independent, so each robot's moves are joined into as few drives as the others allow, in a sequence
in which one drives while the others rest. A planner's own path replaces the moves of a drive where
it finds one. Finding nothing proves nothing: the roadmaps leave poses out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely

from up_samp.geometry.scene import Scene
from up_samp.model import Body, Configuration, Deadline, Placed, TimedMotion, Trajectory
from up_samp.motion.fleet.abilities import abilities_of
from up_samp.motion.fleet.lacam import Agent, Joint
from up_samp.motion.fleet.margins import kept
from up_samp.motion.fleet.moves import Move, drive, in_step
from up_samp.motion.fleet.paths import Path, hull_of, path_of
from up_samp.motion.fleet.roadmap import Edge, Roadmap, cells_of
from up_samp.motion.fleet.timed_path import TimedPath, avoids
from up_samp.motion.fleet.waiting import parked_all_the_time
from up_samp.motion.fleet.workspace import Workspace

DRAWS = (4, 5, 1, 1)
"""Searches on the roadmaps of each grain (see ``cells_of``), each with another draw. The fifth one
is the long one, for rooms of few places, where it sees them all.
"""
AIR = 0.02
"""Width (m) added to what rests beside a drive, so that it is clear of it by more than rounding."""


@dataclass(frozen=True)
class Trip:
    """A drive of one robot along moves (one or more) while all others rest that have no trip in the
    same stage.
    """

    robot: int
    edges: tuple[Edge, ...]

    @property
    def start(self) -> int:
        """The place where it begins."""
        return self.edges[0].source

    @property
    def end(self) -> int:
        """The place where it ends."""
        return self.edges[-1].target

    @property
    def seconds(self) -> float:
        """About how long it takes."""
        return sum(edge.cost for edge in self.edges)


Stage = tuple[Trip, ...]
"""Trips at the same time, while everybody else rests: one, or several of one move each that are
driven in step."""

Drives = tuple[tuple[int, Path], ...]
"""Paths of robots at the same time: one, or several with a timing in which they keep clear."""


@dataclass
class Knot:
    """Robots that have to be moved together, and what rests around them."""

    workspace: Workspace
    scene: Scene
    motions: Sequence[TimedMotion]
    world: Sequence[TimedPath]
    paths: Sequence[Path | None]
    deadline: Deadline
    seed: int = 0
    margin: float = field(init=False)
    static: list[tuple[Placed, ...]] = field(init=False)

    def __post_init__(self) -> None:
        self.margin = _margin(self.workspace.margin, self.motions)
        self.static = [tuple(parked_all_the_time(m, self.world)) for m in self.motions]

    @property
    def heeds(self) -> list[list[bool]]:
        """Who has to keep apart from whom."""
        pairs = [
            [
                a is not b and (avoids(a.avoid, b.object) or avoids(b.avoid, a.object))
                for b in self.motions
            ]
            for a in self.motions
        ]
        return pairs


def untie(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    alone: Mapping[str, TimedPath],
    world: Sequence[TimedPath],
    deadline: Deadline,
    seed: int = 0,
) -> list[Drives] | None:
    """Return drives (robot, path) in a sequence that brings everybody from start to goal, each one
    clear of all others at rest where the drives before left them; or None if none is found.

    ``alone`` are the runs of the motions without each other. For robots with two poses each and
    of different names.
    """
    scene = workspace.scene
    if scene is None or any(abilities_of(m.body).free for m in motions):
        return None
    paths = [alone[m.name].path if m.name in alone else None for m in motions]
    knot = Knot(workspace, scene, motions, world, paths, deadline, seed)
    known: list[list[Agent]] = []
    done: set[tuple[float, ...]] = set()
    tuning = workspace.tuning.knots
    for level, draws in enumerate(DRAWS):
        attempts = [tuning.short] * min(draws, 4) + [tuning.long] * (draws - 4)
        cells = tuple(cells_of(m.body)[level] for m in motions)
        if cells in done or deadline.expired():
            continue
        done.add(cells)
        for own in (False, True):
            # marks on the robots' own paths are few and close: only where the lattice fails
            agents = _agents(knot, cells, own)
            if agents is None or any(agent.start not in agent.to_go for agent in agents):
                continue
            drives = untied(knot, agents, attempts)
            if drives is not None:
                return drives
            if deadline.expired() or _places(agents) > tuning.many:
                return None
            known.append(agents)
    # nobody can go first: some at the same time, then; in a ring there are three at least
    for agents in known if len(motions) > 2 else ():
        drives = (
            None if deadline.expired() else untied(knot, agents, (tuning.short,), together=True)
        )
        if drives is not None:
            return drives
    return None


def untied(
    knot: Knot, agents: Sequence[Agent], attempts: Sequence[int], *, together: bool = False
) -> list[Drives] | None:
    """Return drives that bring everybody from start to goal, if some are found."""
    found = _joint_moves(knot, agents, attempts, together)
    if found is None:
        return None
    joint, steps = found
    return _drives(knot, joint, loosened(joint, _joined(joint, _in_order(joint, steps))))


def _places(agents: Sequence[Agent]) -> int:
    return max(len(agent.roadmap.poses) for agent in agents)


def _margin(wish: float, motions: Sequence[TimedMotion]) -> float:
    """Return the clearance to keep: less than usual where robots start or end closer than that."""
    margin = wish
    for a, b in itertools.combinations(motions, 2):
        g, h = hull_of(a.body), hull_of(b.body)
        for i in (0, -1):
            margin = kept(margin, [np.array(a.poses[i])], g, [np.array(b.poses[i])], h)
    return margin


def _joint_moves(
    knot: Knot, agents: Sequence[Agent], attempts: Sequence[int], together: bool
) -> tuple[Joint, list[tuple[Edge, ...]]] | None:
    """Return joint moves on roadmaps of one grain, and who found them, if some are found."""
    places, tuning = _places(agents), knot.workspace.tuning.knots
    for attempt, most in enumerate(attempts):
        if most > tuning.short and places > tuning.few:
            continue
        joint = Joint(agents, knot.heeds, knot.margin, 100 * knot.seed + attempt, together, tuning)
        steps = joint.search(most, knot.deadline)
        if steps is not None:
            return joint, steps
        if joint.dry or knot.deadline.expired():
            break
    return None


def _agents(knot: Knot, cells: Sequence[float], marks: bool) -> list[Agent] | None:
    """Return the robots on roadmaps, one for each kind of body among the same resting things;
    ``marks``: with places along the robots' own paths.
    """
    kinds: dict[object, list[int]] = {}
    for i, motion in enumerate(knot.motions):
        around = frozenset((p.body.footprint, p.pose) for p in knot.static[i])
        kinds.setdefault((motion.body, around), []).append(i)
    agents: dict[int, Agent] = {}
    for robots in kinds.values():
        ends = [pose for i in robots for pose in knot.motions[i].poses]
        own = [path for i in robots if marks and (path := knot.paths[i]) is not None]
        body, static = knot.motions[robots[0]].body, knot.static[robots[0]]
        roadmap = Roadmap(knot.scene, body, ends, own, static, cells[robots[0]])
        if not roadmap.usable or knot.deadline.expired():
            return None
        for i in robots:
            start, goal = (roadmap.place(pose) for pose in knot.motions[i].poses)
            agents[i] = Agent(roadmap, start, goal, roadmap.to_go(goal))
    return [agents[i] for i in range(len(knot.motions))]


def _in_order(joint: Joint, steps: Sequence[tuple[Edge, ...]]) -> list[Stage]:
    """Return the moves one by one, each clear of everybody else at rest; those that have to be at
    the same time together.
    """
    return [
        tuple(Trip(i, (step[i],)) for i in group)
        for step in steps
        for group in joint.turns(step) or ()
    ]


def _drives(knot: Knot, joint: Joint, loose: Sequence[Stage]) -> list[Drives] | None:
    """Return the drives with a planner's paths where it finds shorter ones."""
    at: list[Configuration] = [m.poses[0] for m in knot.motions]
    found: list[Drives] = []
    for stage in loose:
        ends = {t.robot: joint.agents[t.robot].roadmap.poses[t.end] for t in stage}
        if len(stage) == 1:
            path = _drive(knot, joint, stage[0], at, ends[stage[0].robot])
            if path is None:
                return None
            found.append(((stage[0].robot, path),))
        else:
            found.append(_together(knot, stage, at, ends))
        for robot, end in ends.items():
            at[robot] = end
    return found


def _together(
    knot: Knot, stage: Stage, at: Sequence[Configuration], ends: Mapping[int, Configuration]
) -> Drives:
    """Return the paths of trips that are driven in step."""
    robots = [t.robot for t in stage]
    moves = [t.edges[0].move for t in stage]
    motions = in_step(moves, [knot.motions[i].body.kinematics for i in robots])
    return tuple(
        (i, path_of(_between(motion, at[i], ends[i]), knot.motions[i].body, _marks([move])))
        for i, move, motion in zip(robots, moves, motions, strict=True)
    )


def _drive(
    knot: Knot, joint: Joint, trip: Trip, at: Sequence[Configuration], end: Configuration
) -> Path | None:
    """Return a path for a trip: a planner's, or the moves themselves."""
    robot, motion = trip.robot, knot.motions[trip.robot]
    parked = [
        Placed(other.object, other.body, at[j])
        for j, other in enumerate(knot.motions)
        if joint.heeds[robot][j]
    ]
    wide = [Placed(p.name, grown(p.body, AIR), p.pose) for p in parked]
    path = knot.workspace.detour(
        motion.body, (at[robot], end), [*knot.static[robot], *wide], knot.deadline
    )
    moves = [edge.move for edge in trip.edges]
    whole = _between(drive(moves, motion.body.kinematics), at[robot], end)
    own = path_of(whole, motion.body, _marks(moves))
    options = sorted((p for p in (path, own) if p is not None), key=lambda p: p.natural.duration)
    rests = [knot.workspace.resting(p.body, p.pose) for p in parked]
    clear = (p for p in options if not any(len(knot.workspace.conflicts(p, r)) for r in rests))
    return next(clear, None)


def _between(motion: Trajectory, start: Configuration, goal: Configuration) -> Trajectory:
    """Return a motion with its ends exactly at two poses: a lattice's are off by rounding."""
    rows = motion.poses.copy()
    for k, pose in ((0, start), (-1, goal)):
        turns = 2 * math.pi * round((float(rows[k, 2]) - pose[2]) / (2 * math.pi))
        rows[k] = (pose[0], pose[1], pose[2] + turns)
    return Trajectory(motion.times.copy(), rows)


def grown(body: Body, by: float) -> Body:
    """Return the body with a footprint that is wider by ``by`` m on all sides."""
    ring = shapely.Polygon(body.footprint).buffer(by, join_style="mitre").exterior
    return replace(body, footprint=tuple((float(x), float(y)) for x, y in ring.coords[:-1]))


def _marks(moves: Sequence[Move]) -> list[Configuration]:
    marks = [tuple(float(v) for v in moves[0].rows[0])]
    return marks + [tuple(float(v) for v in m.rows[-1]) for m in moves]


def _joined(joint: Joint, order: Sequence[Stage]) -> list[Stage]:
    """Return the moves as drives, in an order that keeps who goes before whom where
    two moves meet.

    The next drive is one that brings its robot to its end, or else the longest one.
    """
    count = len(joint.agents)
    mine: list[list[int]] = [[] for _ in range(count)]
    waits = [{q for q in range(k) if _meet(joint, order[k], order[q])} for k in range(len(order))]
    for k, stage in enumerate(order):
        for trip in stage:
            mine[trip.robot].append(k)
    done: set[int] = set()
    drives: list[Stage] = []
    while len(done) < len(order):
        options: list[tuple[bool, int, int, list[int]]] = []
        for robot in range(count):
            left = [k for k in mine[robot] if k not in done]
            ready: list[int] = []
            for k in left:
                if not waits[k] <= done or len(order[k]) > 1:
                    break
                ready.append(k)
            if ready:
                options.append((len(ready) < len(left), -len(ready), robot, ready))
        # the first of those left can always go: the given order is one that works
        first = next(k for k in range(len(order)) if k not in done)
        if len(order[first]) > 1:
            options.append((True, -1, count, [first]))
        _, _, robot, ready = min(options, key=lambda option: option[:3])
        done |= set(ready)
        if robot == count:
            drives.append(order[first])
        else:
            drives.append((Trip(robot, tuple(order[k][0].edges[0] for k in ready)),))
    return drives


def _meet(joint: Joint, a: Stage, b: Stage) -> bool:
    """Return whether any moves of two stages come too close to each other."""
    return any(
        joint.overlap(t.robot, e, u.robot, f)
        for t in a
        for u in b
        for e in t.edges
        for f in u.edges
    ) or bool({t.robot for t in a} & {t.robot for t in b} and len(a) + len(b) > 2)


def loosened(joint: Joint, stages: Sequence[Stage]) -> list[Stage]:
    """Return a sequence with fewer stops and shorter ways: two drives of a robot become one, early
    or late, where the others do not need it to stand in between.
    """
    found = list(stages)
    for _ in range(joint.tuning.passes):
        before = len(found), _seconds(found)
        k = 0
        while k < len(found):
            k += 0 if _merge(joint, found, k) else 1
        for k in range(len(found)):
            _shorten(joint, found, k)
        if (len(found), _seconds(found)) == before:
            break
    return found


def _seconds(stages: Sequence[Stage]) -> float:
    return sum(trip.seconds for stage in stages for trip in stage)


def _merge(joint: Joint, stages: list[Stage], k: int) -> bool:
    """Join drive ``k`` with the same robot's next one, in place; return whether that works."""
    first = stages[k][0]
    after = range(k + 1, len(stages))
    n = next((i for i in after if any(t.robot == first.robot for t in stages[i])), -1)
    if n < 0 or len(stages[k]) > 1 or len(stages[n]) > 1:
        return False
    second, roadmap = stages[n][0], joint.agents[first.robot].roadmap
    between = [trip for stage in stages[k + 1 : n] for trip in stage]
    for place, when in ((first.start, n), (second.end, k)):
        rest = roadmap.rest(place)
        if any(joint.overlap(first.robot, rest, t.robot, e) for t in between for e in t.edges):
            continue
        if first.start == second.end:
            del stages[n], stages[k]
            return True
        limit = first.seconds + second.seconds + joint.tuning.stop
        rests = _rests(joint, stages, when)
        way = _route(joint, first.robot, (first.start, second.end), rests, limit)
        if way is not None:
            stages[when] = (Trip(first.robot, way),)
            del stages[k if when == n else n]
            return True
    return False


def _shorten(joint: Joint, stages: list[Stage], k: int) -> None:
    """Replace a drive by the shortest one among the others at rest."""
    if len(stages[k]) > 1:
        return
    trip = stages[k][0]
    ends, limit = (trip.start, trip.end), trip.seconds - 1e-9
    way = _route(joint, trip.robot, ends, _rests(joint, stages, k), limit)
    if way:
        stages[k] = (Trip(trip.robot, way),)


def _rests(joint: Joint, stages: Sequence[Stage], k: int) -> list[Edge]:
    """Return everybody's rest before drive ``k``."""
    at = [agent.start for agent in joint.agents]
    for stage in stages[:k]:
        for trip in stage:
            at[trip.robot] = trip.end
    return [agent.roadmap.rest(place) for agent, place in zip(joint.agents, at, strict=True)]


def _route(
    joint: Joint, robot: int, ends: tuple[int, int], rests: Sequence[Edge], limit: float
) -> tuple[Edge, ...] | None:
    """Return the shortest way on a robot's roadmap among the others at rest, of a cost of at most
    ``limit`` (A*).
    """
    agent = joint.agents[robot]
    roadmap, to_go = agent.roadmap, agent.to_go
    speed, aim = roadmap.body.kinematics.v_max, roadmap.poses[ends[1]]
    near = [j for j in range(len(rests)) if joint.heeds[robot][j]]

    def estimate(node: int) -> float:
        if ends[1] == agent.goal:
            return to_go.get(node, math.inf)
        return math.dist(roadmap.poses[node][:2], aim[:2]) / speed

    def allowed(edge: Edge) -> bool:
        return not any(joint.overlap(robot, edge, j, rests[j]) for j in near)

    return roadmap.route(ends, estimate, allowed, limit)[0]
