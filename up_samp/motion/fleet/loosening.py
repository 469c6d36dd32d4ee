"""Joint moves made into few drives: moves that do not meet are independent of each other.

Each robot's moves are joined into as few drives as the others allow, in a sequence in which one
drives while the others rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from up_samp.motion.fleet.edges import Edge
from up_samp.motion.fleet.lacam import Joint


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


def loosened(joint: Joint, steps: Sequence[tuple[Edge, ...]]) -> list[Stage]:
    """Return joint moves (an edge for each robot) as drives with few stops and short ways: two
    drives of a robot become one, early or late, where the others do not need it to stand in
    between.
    """
    found = _joined(joint, _in_order(joint, steps))
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


def _in_order(joint: Joint, steps: Sequence[tuple[Edge, ...]]) -> list[Stage]:
    """Return the moves one by one, each clear of everybody else at rest; those that have to be at
    the same time together.
    """
    return [
        tuple(Trip(i, (step[i],)) for i in group)
        for step in steps
        for group in joint.turns(step) or ()
    ]


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
