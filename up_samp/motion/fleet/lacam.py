"""Joint moves of many robots on roadmaps: priority inheritance with backtracking, made complete.

LaCAM (Okumura, *LaCAM: search-based algorithm for quick multi-agent pathfinding*, AAAI 2023)
searches depth first over whole configurations; each of them gets its successors one by one from
PIBT (Okumura, Machida, Defago & Tamura, *Priority inheritance with backtracking for iterative
multi-agent path finding*, AIJ 2022) under constraints that are added lazily, so that in the end
every successor is tried. Robots here are extended bodies: a move may push several others out of the
way at once, and two moves conflict where the bodies, driven in step, come too close. The search is
complete on the roadmaps; what they leave out may still be possible.
"""

from __future__ import annotations

import itertools
import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from up_samp.model import Deadline
from up_samp.motion.fleet.edges import Edge
from up_samp.motion.fleet.phases import in_step, sweeps_meet
from up_samp.motion.fleet.roadmap import Roadmap
from up_samp.motion.tuning import KnotsTuning

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
    step: tuple[Edge, ...] = ()
    tree: deque[tuple[Edge, ...]] = field(default_factory=lambda: deque([()]))


class Joint:
    """Searches joint moves of ``agents``; ``heeds[i][j]``: whether i and j must keep apart by
    ``margin`` m; ``together``: also joint moves in which some have to go at the same time.
    """

    def __init__(
        self,
        agents: Sequence[Agent],
        heeds: Sequence[Sequence[bool]],
        margin: float,
        seed: int,
        together: bool = False,
        tuning: KnotsTuning | None = None,
    ) -> None:
        self.together = together
        self.tuning = tuning or KnotsTuning()
        self.agents, self.heeds, self.margin = agents, heeds, margin
        self.rng = random.Random(seed)
        self._lots = [self.rng.random() for _ in agents] if seed else []
        self.expanded = self.work = 0
        self.dry = False
        self._conflicts: dict[tuple[int, int, int, int], bool] = {}
        self._overlaps: dict[tuple[int, int, int, int], bool] = {}
        self._budget = 0

    def search(self, most: int, deadline: Deadline) -> list[tuple[Edge, ...]] | None:
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
            self.expanded += 1
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

    def meet(self, i: int, a: Edge, j: int, b: Edge) -> bool:
        """Return whether two robots' moves, driven in step, come too close to each other."""
        if not self.heeds[i][j] or not self._near(a, b):
            return False
        key = (i, a.number, j, b.number) if i < j else (j, b.number, i, a.number)
        known = self._conflicts.get(key)
        if known is None:
            known = self._conflicts[key] = in_step(a.swept, b.swept, self.margin)
        return known

    def _valid(self, state: State) -> bool:
        rests = [a.roadmap.rest(at) for a, at in zip(self.agents, state, strict=True)]
        return not any(
            self.meet(i, rests[i], j, rests[j]) for i in range(len(rests)) for j in range(i)
        )

    def _order(self, state: State, waited: Sequence[int]) -> tuple[int, ...]:
        """Return who moves first: who has been away from its goal longest, then who is farthest
        (or, with a seed other than 0, by lot).
        """
        if self._lots:
            return tuple(sorted(range(len(state)), key=lambda i: (-waited[i], self._lots[i])))
        away = [a.to_go[at] for a, at in zip(self.agents, state, strict=True)]
        return tuple(sorted(range(len(state)), key=lambda i: (-waited[i], -away[i], i)))

    def _options(self, robot: int, state: State) -> list[Edge]:
        """Return a robot's moves and its rest, in random order of equal ones, the best first."""
        agent, at = self.agents[robot], state[robot]
        moves = [e for e in agent.roadmap.out(at) if e.target in agent.to_go]
        moves.append(agent.roadmap.rest(at))
        self.rng.shuffle(moves)
        moves.sort(key=lambda e: agent.to_go[e.target])
        return moves

    def _joint_move(self, node: _Node, forced: tuple[Edge, ...]) -> tuple[Edge, ...] | None:
        """Return a move for everybody that keeps to the forced ones, if priority inheritance finds
        one.
        """
        chosen: dict[int, Edge] = {}
        for robot, edge in zip(node.order, forced, strict=False):
            if any(self.meet(robot, edge, other, e) for other, e in chosen.items()):
                return None
            chosen[robot] = edge
        self._budget = self.tuning.pushes
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
        return step if self.turns(step) is not None else None

    def turns(self, step: tuple[Edge, ...]) -> list[list[int]] | None:
        """Return groups of those that move, in an order in which one group after the other can
        move while all others rest. Those of a group move in step: in a full ring nobody can go
        first. None where that is not wanted, or a move in step stops on its way (``Move.steady``).
        """
        moving = [i for i, edge in enumerate(step) if edge.source != edge.target]
        # before[i]: who has to go before i does, or with it
        before: dict[int, set[int]] = {i: set() for i in moving}
        for i, j in itertools.permutations(moving, 2):
            if self._blocks(step, j, step[j].source, i):
                before[i].add(j)
            if self._blocks(step, j, step[j].target, i):
                before[j].add(i)
        for k, i in itertools.product(moving, moving):
            if k in before[i]:
                before[i] |= before[k]
        groups: list[list[int]] = []
        for i in sorted(moving, key=lambda i: (len(before[i] | {i}), i)):
            if not any(i in group for group in groups):
                groups.append(sorted({i} | {j for j in before[i] if i in before[j]}))
        for group in groups:
            steady = self.together and all(step[i].move.steady for i in group)
            if len(group) > 1 and not steady:
                return None
        return groups

    def _blocks(self, step: tuple[Edge, ...], j: int, place: int, i: int) -> bool:
        """Return whether robot j, at rest at a place, is in the way of i's move."""
        if not self.heeds[i][j]:
            return False
        return self.overlap(i, step[i], j, self.agents[j].roadmap.rest(place))

    def overlap(self, i: int, a: Edge, j: int, b: Edge) -> bool:
        """Return whether any parts of two robots' moves come too close to each other."""
        if not self.heeds[i][j] or not self._near(a, b):
            return False
        key = (i, a.number, j, b.number) if i < j else (j, b.number, i, a.number)
        if key not in self._overlaps:
            self._overlaps[key] = sweeps_meet(a.swept, b.swept, self.margin)
        return self._overlaps[key]

    def _near(self, a: Edge, b: Edge) -> bool:
        p, q = a.circle, b.circle
        reach = p[2] + q[2] + self.margin
        return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 < reach * reach

    def _push(
        self, robot: int, node: _Node, rests: Sequence[Edge], chosen: dict[int, Edge]
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


def _steps(node: _Node) -> list[tuple[Edge, ...]]:
    steps: list[tuple[Edge, ...]] = []
    at: _Node | None = node
    while at is not None and at.parent is not None:
        steps.append(at.step)
        at = at.parent
    return steps[::-1]
