"""Deadlocks solved by construction: joint moves on roadmaps, made into drives with few stops."""

from __future__ import annotations

import itertools
import math
import random
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely

from up_samp.geometry.meshes import met_by
from up_samp.geometry.scene import Scene
from up_samp.model import Body, Configuration, Deadline, Placed, TimedMotion, avoids
from up_samp.motion.curves.trajectories import with_ends
from up_samp.motion.fleet.conflicts import Swept, kept, sweeps_meet, swept_in_step
from up_samp.motion.fleet.paths import Path, hull_of, path_of
from up_samp.motion.fleet.roadmap import Roadmap, RoadmapEdge, cells_of
from up_samp.motion.fleet.speed import parked_all_the_time
from up_samp.motion.fleet.timed_path import TimedPath
from up_samp.motion.fleet.workspace import Workspace
from up_samp.motion.moves import drive

State = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Agent:
    """A robot on its roadmap; ``to_go``: seconds from each place to its goal."""

    roadmap: Roadmap
    start: int
    goal: int
    to_go: dict[int, float]


@dataclass(eq=False)
class _Node:
    """A configuration, with constraints still to be tried: (robots in order, their edges)."""

    state: State
    order: tuple[int, ...]
    waited: tuple[int, ...]
    parent: _Node | None
    step: tuple[RoadmapEdge, ...] = ()
    tree: deque[tuple[RoadmapEdge, ...]] = field(default_factory=lambda: deque([()]))


class Joint:
    """Searches joint moves of ``agents``; ``heeds[i][j]``: whether i and j must keep apart by
    ``margin`` m.
    """

    def __init__(
        self, agents: Sequence[Agent], heeds: Sequence[Sequence[bool]], margin: float
    ) -> None:
        self.agents, self.heeds, self.margin = agents, heeds, margin
        self.rng = random.Random(0)
        self.work = 0
        self.dry = False
        self._known: dict[tuple[object, ...], bool] = {}
        self._budget = 0

    def search(self, most: int, deadline: Deadline) -> list[tuple[RoadmapEdge, ...]] | None:
        """Return joint moves (an edge for each robot) from all starts to all goals, or None where
        none are found within ``most`` moves looked at (``dry``: the roadmaps have none).
        """
        count = len(self.agents)
        start, goal = (tuple(a.start for a in self.agents), tuple(a.goal for a in self.agents))
        if any(a.start not in a.to_go for a in self.agents) or not self._valid(start):
            return None
        first = _Node(start, self._order(start, (0,) * count), (0,) * count, None)
        stack, known = [first], {start: first}
        while stack and self.work < most and not deadline.expired():
            node = stack[-1]
            if node.state == goal:
                return _steps(node)
            if not node.tree:
                stack.pop()
                continue
            forced = node.tree.popleft()
            if len(forced) < count:
                robot = node.order[len(forced)]
                options = self._options(robot, node.state)
                node.tree.extend((*forced, edge) for edge in options)
                self.work += len(options)
            step = self._joint_move(node, forced)
            if step is None:
                continue
            state = tuple(edge.target for edge in step)
            if state in known:
                stack.append(known[state])
                continue
            waited = tuple(
                0 if at == a.goal else w + 1
                for at, a, w in zip(state, self.agents, node.waited, strict=True)
            )
            after = _Node(state, self._order(state, waited), waited, node, step)
            known[state] = after
            stack.append(after)
        self.dry = not stack
        return None

    def meet(self, i: int, a: RoadmapEdge, j: int, b: RoadmapEdge) -> bool:
        """Return whether two robots' moves, driven in step, come too close to each other."""
        return self._too_close(swept_in_step, i, a, j, b)

    def _valid(self, state: State) -> bool:
        rests = [a.roadmap.rest(at) for a, at in zip(self.agents, state, strict=True)]
        return not any(
            self.meet(i, rests[i], j, rests[j]) for i in range(len(rests)) for j in range(i)
        )

    def _order(self, state: State, waited: Sequence[int]) -> tuple[int, ...]:
        """Return who moves first: who has been away from its goal longest, then who is farthest."""
        away = [a.to_go[at] for a, at in zip(self.agents, state, strict=True)]
        return tuple(sorted(range(len(state)), key=lambda i: (-waited[i], -away[i], i)))

    def _options(self, robot: int, state: State) -> list[RoadmapEdge]:
        """Return a robot's moves and its rest, in random order of equal ones, the best first."""
        agent, at = self.agents[robot], state[robot]
        moves = [e for e in agent.roadmap.out(at) if e.target in agent.to_go]
        moves.append(agent.roadmap.rest(at))
        self.rng.shuffle(moves)
        moves.sort(key=lambda e: agent.to_go[e.target])
        return moves

    def _joint_move(
        self, node: _Node, forced: tuple[RoadmapEdge, ...]
    ) -> tuple[RoadmapEdge, ...] | None:
        """Return a move for everybody that keeps to the forced ones, if priority inheritance finds
        one.
        """
        chosen: dict[int, RoadmapEdge] = {}
        for robot, edge in zip(node.order, forced, strict=False):
            if any(self.meet(robot, edge, other, e) for other, e in chosen.items()):
                return None
            chosen[robot] = edge
        self._budget = 2_000  # moves tried before the next constraint is added
        rests = [a.roadmap.rest(at) for a, at in zip(self.agents, node.state, strict=True)]
        # those that a forced move drives into go first
        pushed = [
            r
            for r in node.order
            if r not in chosen and any(self.meet(r, rests[r], o, e) for o, e in chosen.items())
        ]
        for robot in (*pushed, *node.order):
            if robot not in chosen and not self._push(robot, node, rests, chosen):
                return None
        step = tuple(chosen[i] for i in range(len(self.agents)))
        return step if self.in_turns(step) is not None else None

    def in_turns(self, step: tuple[RoadmapEdge, ...]) -> list[int] | None:
        """Return those that move, in an order in which one after the other can move while all
        others rest (None: there is none).
        """
        moving = [i for i, edge in enumerate(step) if edge.source != edge.target]
        # before[i]: who has to go before i does
        before: dict[int, set[int]] = {i: set() for i in moving}
        for i, j in itertools.permutations(moving, 2):
            if self._blocks(step, j, step[j].source, i):
                before[i].add(j)
            if self._blocks(step, j, step[j].target, i):
                before[j].add(i)
        for k, i in itertools.product(moving, moving):
            if k in before[i]:
                before[i] |= before[k]
        if any(i in before[i] for i in moving):
            return None
        return sorted(moving, key=lambda i: (len(before[i]), i))

    def _blocks(self, step: tuple[RoadmapEdge, ...], j: int, place: int, i: int) -> bool:
        """Return whether robot j, at rest at a place, is in the way of i's move."""
        if not self.heeds[i][j]:
            return False
        return self.overlap(i, step[i], j, self.agents[j].roadmap.rest(place))

    def overlap(self, i: int, a: RoadmapEdge, j: int, b: RoadmapEdge) -> bool:
        """Return whether any parts of two robots' moves come too close to each other."""
        return self._too_close(sweeps_meet, i, a, j, b)

    def _too_close(
        self,
        test: Callable[[Swept, Swept, float], bool],
        i: int,
        a: RoadmapEdge,
        j: int,
        b: RoadmapEdge,
    ) -> bool:
        """Return what a test of two robots' moves says, asked once where they are near."""
        if not self.heeds[i][j]:
            return False
        p, q = a.circle, b.circle
        reach = p[2] + q[2] + self.margin
        if (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 >= reach * reach:
            return False
        pair = (i, a.number, j, b.number) if i < j else (j, b.number, i, a.number)
        known = self._known.get((test, *pair))
        if known is None:
            known = self._known[(test, *pair)] = test(a.swept, b.swept, self.margin)
        return known

    def _push(
        self, robot: int, node: _Node, rests: Sequence[RoadmapEdge], chosen: dict[int, RoadmapEdge]
    ) -> bool:
        """Choose a move for ``robot``, and for all that it drives into, or nothing at all."""
        for edge in self._options(robot, node.state):
            self._budget -= 1
            self.work += 1
            if self._budget < 0:
                return False
            if any(self.meet(robot, edge, other, e) for other, e in chosen.items()):
                continue
            before = set(chosen)
            chosen[robot] = edge
            victims = [
                r for r in node.order if r not in chosen and self.meet(r, rests[r], robot, edge)
            ]
            if all(r in chosen or self._push(r, node, rests, chosen) for r in victims):
                return True
            for r in set(chosen) - before:
                del chosen[r]
        return False


def _steps(node: _Node) -> list[tuple[RoadmapEdge, ...]]:
    steps: list[tuple[RoadmapEdge, ...]] = []
    at: _Node | None = node
    while at is not None and at.parent is not None:
        steps.append(at.step)
        at = at.parent
    return steps[::-1]


# ------------------ Joint moves made into few drives
# Moves that do not meet are independent of each other. Each robot's moves are joined into as few
# drives as the others allow, in a sequence in which one drives while the others rest.


@dataclass(frozen=True)
class LooseMove:
    """A drive of one robot along moves (one or more) while all others rest."""

    robot: int
    edges: tuple[RoadmapEdge, ...]

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


def loosened(joint: Joint, steps: Sequence[tuple[RoadmapEdge, ...]]) -> list[LooseMove]:
    """Return joint moves (an edge for each robot) as drives with few stops and short ways: two
    drives of a robot become one, early or late, where the others do not need it to stand in
    between.
    """
    found = _joined(joint, _in_order(joint, steps))
    for _ in range(8):
        before = len(found), _seconds(found)
        k = 0
        while k < len(found):
            k += 0 if _merge(joint, found, k) else 1
        for k in range(len(found)):
            _shorten(joint, found, k)
        if (len(found), _seconds(found)) == before:
            break
    return found


def _in_order(joint: Joint, steps: Sequence[tuple[RoadmapEdge, ...]]) -> list[LooseMove]:
    """Return the moves one by one, each clear of everybody else at rest."""
    return [LooseMove(i, (step[i],)) for step in steps for i in joint.in_turns(step) or ()]


def _joined(joint: Joint, order: Sequence[LooseMove]) -> list[LooseMove]:
    """Return the moves as drives, in an order that keeps who goes before whom where
    two moves meet.

    The next drive is one that brings its robot to its end, or else the longest one.
    """
    waits = [{q for q in range(k) if _meet(joint, order[k], order[q])} for k in range(len(order))]
    done: set[int] = set()
    drives: list[LooseMove] = []
    while len(done) < len(order):
        # the first of those left can always go: the given order is one that works
        options: list[tuple[bool, int, int, list[int]]] = []
        for robot in range(len(joint.agents)):
            left = [k for k, trip in enumerate(order) if trip.robot == robot and k not in done]
            held = (n for n, k in enumerate(left) if not waits[k] <= done)
            ready = left[: next(held, len(left))]
            if ready:
                options.append((len(ready) < len(left), -len(ready), robot, ready))
        _, _, robot, ready = min(options)
        done |= set(ready)
        drives.append(LooseMove(robot, tuple(order[k].edges[0] for k in ready)))
    return drives


def _meet(joint: Joint, a: LooseMove, b: LooseMove) -> bool:
    """Return whether any moves of two drives come too close to each other."""
    pairs = itertools.product(a.edges, b.edges)
    return any(joint.overlap(a.robot, e, b.robot, f) for e, f in pairs)


def _seconds(trips: Sequence[LooseMove]) -> float:
    return sum(trip.seconds for trip in trips)


def _merge(joint: Joint, trips: list[LooseMove], k: int) -> bool:
    """Join drive ``k`` with the same robot's next one, in place; return whether that works."""
    first = trips[k]
    n = next((i for i in range(k + 1, len(trips)) if trips[i].robot == first.robot), -1)
    if n < 0:
        return False
    second, roadmap = trips[n], joint.agents[first.robot].roadmap
    for place, when in ((first.start, n), (second.end, k)):
        rest = LooseMove(first.robot, (roadmap.rest(place),))
        if any(_meet(joint, rest, between) for between in trips[k + 1 : n]):
            continue
        if first.start == second.end:
            del trips[n], trips[k]
            return True
        limit = first.seconds + second.seconds + 1.0  # what a stop is worth
        rests = _rests(joint, trips, when)
        way = _route(joint, first.robot, (first.start, second.end), rests, limit)
        if way is not None:
            trips[when] = LooseMove(first.robot, way)
            del trips[k if when == n else n]
            return True
    return False


def _shorten(joint: Joint, trips: list[LooseMove], k: int) -> None:
    """Replace a drive by the shortest one among the others at rest."""
    trip = trips[k]
    ends, limit = (trip.start, trip.end), trip.seconds - 1e-9
    way = _route(joint, trip.robot, ends, _rests(joint, trips, k), limit)
    if way:
        trips[k] = LooseMove(trip.robot, way)


def _rests(joint: Joint, trips: Sequence[LooseMove], k: int) -> list[RoadmapEdge]:
    """Return everybody's rest before drive ``k``."""
    at = [agent.start for agent in joint.agents]
    for trip in trips[:k]:
        at[trip.robot] = trip.end
    return [agent.roadmap.rest(place) for agent, place in zip(joint.agents, at, strict=True)]


def _route(
    joint: Joint, robot: int, ends: tuple[int, int], rests: Sequence[RoadmapEdge], limit: float
) -> tuple[RoadmapEdge, ...] | None:
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

    def allowed(edge: RoadmapEdge) -> bool:
        return not any(joint.overlap(robot, edge, j, rests[j]) for j in near)

    return roadmap.route(ends, estimate, allowed, limit)


# ------------------ Knots solved by construction
# Joint moves on roadmaps, made into drives that need few stops. Where no order of priorities works,
# a plan for everybody is searched on roadmaps of rest poses, coarse to fine. It is then made into
# few drives. A planner's own path replaces the moves of a drive where it finds one. Finding nothing
# proves nothing: the roadmaps leave poses out.


Drive = tuple[int, Path]
"""A robot (its number) and its path."""


@dataclass
class Knot:
    """Robots that have to be moved together, and what rests around them."""

    workspace: Workspace
    scene: Scene
    motions: Sequence[TimedMotion]
    world: Sequence[TimedPath]
    deadline: Deadline
    margin: float = field(init=False)
    static: list[tuple[Placed, ...]] = field(init=False)

    def __post_init__(self) -> None:
        self.margin = _margin(self.workspace.margin, self.motions)
        self.static = [met_by(m.body, parked_all_the_time(m, self.world)) for m in self.motions]

    @property
    def heeds(self) -> list[list[bool]]:
        """Who has to keep apart from whom."""
        return [
            [
                a is not b and (avoids(a.avoid, b.object) or avoids(b.avoid, a.object))
                for b in self.motions
            ]
            for a in self.motions
        ]


def untie(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    world: Sequence[TimedPath],
    deadline: Deadline,
) -> list[Drive] | None:
    """Return drives (robot, path) in a sequence that brings everybody from start to goal, each one
    clear of all others at rest where the drives before left them; None if none is found.

    For robots with two poses each and of different names. Little work is done on all roadmaps
    before more is on any.
    """
    scene = workspace.scene
    if scene is None or any(m.body.mobility.own_law for m in motions):
        return None
    knot = Knot(workspace, scene, motions, world, deadline)
    left: Iterable[list[Agent]] = _coarse_to_fine(knot)
    for most in workspace.tuning.knots:
        cut = []
        for agents in left:
            joint = Joint(agents, knot.heeds, knot.margin)
            steps = joint.search(most, deadline)
            drives = None if steps is None else drives_of(knot, joint, loosened(joint, steps))
            if drives is not None or deadline.expired():
                return drives
            cut += [] if joint.dry else [agents]
        left = cut
    return None


def drives_of(knot: Knot, joint: Joint, trips: Sequence[LooseMove]) -> list[Drive] | None:
    """Return the drives with a planner's paths where it finds shorter ones."""
    at: list[Configuration] = [m.poses[0] for m in knot.motions]
    found: list[Drive] = []
    for trip in trips:
        end = joint.agents[trip.robot].roadmap.poses[trip.end]
        path = _drive(knot, joint, trip, at, end)
        if path is None:
            return None
        found.append((trip.robot, path))
        at[trip.robot] = end
    return found


def _coarse_to_fine(knot: Knot) -> Iterator[list[Agent]]:
    """Yield the robots on roadmaps of each grain, until one has so many places that a finer one is
    not worth its making.
    """
    grains = dict.fromkeys(zip(*(cells_of(m.body) for m in knot.motions), strict=True))
    for cells in grains:
        agents = _agents(knot, cells)
        if agents is not None and all(agent.start in agent.to_go for agent in agents):
            yield agents
            if max(len(agent.roadmap.poses) for agent in agents) > 3_000:
                return


def _margin(wish: float, motions: Sequence[TimedMotion]) -> float:
    """Return the clearance to keep: less than usual where robots start or end closer than that."""
    margin = wish
    for a, b in itertools.combinations(motions, 2):
        g, h = hull_of(a.body), hull_of(b.body)
        for i in (0, -1):
            margin = kept(margin, [np.array(a.poses[i])], g, [np.array(b.poses[i])], h)
    return margin


def _agents(knot: Knot, cells: Sequence[float]) -> list[Agent] | None:
    """Return the robots on roadmaps, one for each kind of body among the same resting things."""
    kinds: dict[object, list[int]] = {}
    for i, motion in enumerate(knot.motions):
        around = frozenset((p.body.footprint, p.pose) for p in knot.static[i])
        kinds.setdefault((motion.body, around), []).append(i)
    agents: dict[int, Agent] = {}
    for robots in kinds.values():
        ends = [pose for i in robots for pose in knot.motions[i].poses]
        body, static = knot.motions[robots[0]].body, knot.static[robots[0]]
        roadmap = Roadmap(knot.scene, body, ends, static, cells[robots[0]])
        if not roadmap.usable or knot.deadline.expired():
            return None
        for i in robots:
            start, goal = (roadmap.place(pose) for pose in knot.motions[i].poses)
            agents[i] = Agent(roadmap, start, goal, roadmap.to_go(goal))
    return [agents[i] for i in range(len(knot.motions))]


def _drive(
    knot: Knot, joint: Joint, trip: LooseMove, at: Sequence[Configuration], end: Configuration
) -> Path | None:
    """Return a path for a trip: a planner's, or the moves themselves."""
    robot, motion = trip.robot, knot.motions[trip.robot]
    parked = [
        Placed(other.object, other.body, at[j])
        for j, other in enumerate(knot.motions)
        if joint.heeds[robot][j]
    ]
    # a little more room, for rounding
    wide = [Placed(p.name, grown(p.body, 0.02), p.pose) for p in parked]
    path = knot.workspace.detour(
        motion.body, (at[robot], end), knot.static[robot], wide, knot.deadline
    )
    moves = [edge.move for edge in trip.edges]
    whole = with_ends(drive(moves, motion.body.kinematics), at[robot], end)
    rows = [moves[0].rows[0], *(move.rows[-1] for move in moves)]
    own = path_of(whole, motion.body, [tuple(row.tolist()) for row in rows])
    options = sorted((p for p in (path, own) if p is not None), key=lambda p: p.natural.duration)
    rests = [knot.workspace.resting(p.body, p.pose) for p in parked]
    clear = (p for p in options if not any(len(knot.workspace.conflicts(p, r)) for r in rests))
    return next(clear, None)


def grown(body: Body, by: float) -> Body:
    """Return the body with a footprint that is wider by ``by`` m on all sides."""
    ring = shapely.Polygon(body.footprint).buffer(by, join_style="mitre").exterior
    return replace(body, footprint=tuple((float(x), float(y)) for x, y in ring.coords[:-1]))
