"""Several robots at once: priority-based search over a ladder for one robot.

Everybody is first planned alone. Conflicts are then resolved one by one, earliest first, by
giving one of two robots priority and planning the other one again around all that come before it
(priority-based search, Ma et al. 2019). The first branch is prioritised planning by release time
and slack; the others are other priorities. Lateness orders the branches.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from up_samp.model import Deadline, GroupQuery, GroupReport, Outcome, TimedMotion
from up_samp.motion.spacetime.runs import (
    PathPlanner,
    Run,
    Workspace,
    fixed_run,
    rest_run,
    workspace_of,
)
from up_samp.motion.spacetime.single import ON_TIME, Attempt, Window, failed, plan_one

Pair = tuple[str, str]

EFFORTS = ((0, 60), (1, 40), (2, 30))
"""Rungs of the ladder for a group: (effort for one robot, nodes of the priority search)."""


@dataclass(frozen=True, eq=False)
class Node:
    """Runs by motion name, who goes before whom, and which pairs still meet (at what time)."""

    runs: Mapping[str, Run]
    before: frozenset[Pair] = frozenset()
    meetings: Mapping[Pair, float] = field(default_factory=dict)


@dataclass
class Group:
    """A group under search, with the best answers so far."""

    workspace: Workspace
    motions: dict[str, TimedMotion]
    world: list[Run]
    deadline: Deadline
    effort: int = 0
    best: Node | None = None
    stuck: set[str] = field(default_factory=set)
    """Motions that could not be planned in some branch, with those before them."""

    def lateness(self, runs: Mapping[str, Run]) -> float:
        """Return the sum of all lateness (s)."""
        late = (runs[name].arrival - self.motions[name].due for name in sorted(runs))
        return sum(x for x in late if x > ON_TIME)

    def cost(self, runs: Mapping[str, Run]) -> tuple[float, float]:
        """Return (lateness, sum of arrivals), less is better."""
        return self.lateness(runs), sum(runs[name].arrival for name in sorted(runs))


def coordinate(
    service: PathPlanner, query: GroupQuery, deadline: Deadline, *, seed: int = 0
) -> GroupReport:
    """Find trajectories for all motions of ``query`` that keep clear of each other, of what rests
    and of what is already decided; late if there is no other way found.

    Deterministic for a ``seed`` as long as the ``deadline`` does not cut it short.
    """
    began = time.monotonic()
    group = _group_of(workspace_of(service), query, deadline)
    root, attempt, name = _alone(group)
    if root is None:
        return _hopeless(name, attempt, time.monotonic() - began)
    for effort, nodes in EFFORTS:
        group.effort = effort
        _search(group, root, nodes)
        if group.best is not None and group.lateness(group.best.runs) == 0.0:
            break
        if deadline.expired():
            break
    return _report(group, began)


def _group_of(workspace: Workspace, query: GroupQuery, deadline: Deadline) -> Group:
    world = [rest_run(workspace, rest) for rest in query.rests]
    world += [fixed_run(motion) for motion in query.fixed]
    motions = {motion.name: motion for motion in query.motions}
    if len(motions) != len(query.motions):
        raise ValueError("two motions of a group have the same name")
    return Group(workspace, motions, world, deadline)


def _order(group: Group) -> list[str]:
    """Return the motions by release, then by due (less slack first), then by name."""
    return sorted(group.motions, key=lambda n: (group.motions[n].release, group.motions[n].due, n))


def _previous(group: Group, name: str) -> str | None:
    """Return the same object's motion just before this one."""
    motion = group.motions[name]
    earlier = [
        other
        for other in _order(group)
        if group.motions[other].object == motion.object and other != name
    ]
    earlier = [o for o in earlier if group.motions[o].release < motion.release]
    return earlier[-1] if earlier else None


def _window(group: Group, name: str, runs: Mapping[str, Run]) -> Window:
    """Return when a motion may happen: not before its object has arrived from the last one."""
    motion = group.motions[name]
    previous = _previous(group, name)
    if previous is None or previous not in runs:
        return Window(motion.present_from, motion.release)
    arrival = runs[previous].arrival
    since = max(motion.present_from, arrival) if motion.present_from > -math.inf else arrival
    return Window(min(since, max(motion.release, arrival)), max(motion.release, arrival))


def _plan(group: Group, name: str, runs: Mapping[str, Run], first: Iterable[str]) -> Attempt:
    """Plan one motion around the world and the runs of those that go ``first``."""
    others = [*group.world, *(runs[other] for other in sorted(first))]
    window = _window(group, name, runs)
    motion = group.motions[name]
    return plan_one(group.workspace, motion, window, others, group.deadline, group.effort)


def _alone(group: Group) -> tuple[Node | None, Attempt, str]:
    """Plan everybody alone; return the node, or the first motion that is impossible on its own."""
    runs: dict[str, Run] = {}
    attempt = Attempt(None)
    for name in _order(group):
        attempt = _plan(group, name, runs, ())
        if attempt.run is None:
            return None, attempt, name
        runs[name] = attempt.run
    return Node(runs, frozenset(), _all_meetings(group, runs)), attempt, ""


def _all_meetings(group: Group, runs: Mapping[str, Run]) -> dict[Pair, float]:
    names = sorted(runs)
    meetings: dict[Pair, float] = {}
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            at = group.workspace.meeting(runs[a], runs[b])[0]
            if at < math.inf:
                meetings[a, b] = at
    return meetings


def _search(group: Group, root: Node, budget: int) -> None:
    """Search priorities depth first, children by cost; keeps the best node without a meeting."""
    stack = [root]
    while stack and budget > 0 and not group.deadline.expired():
        node = stack.pop()
        budget -= 1
        if group.best is not None and group.lateness(node.runs) >= group.lateness(group.best.runs):
            continue
        if not node.meetings:
            group.best = node
            if group.lateness(node.runs) == 0.0:
                return
            continue
        a, b = min(node.meetings, key=lambda pair: (node.meetings[pair], pair))
        children = [_child(group, node, a, b), _child(group, node, b, a)]
        order = {name: i for i, name in enumerate(_order(group))}
        ranked = [
            (group.lateness(child.runs), order[first], child)
            for first, child in zip((a, b), children, strict=True)
            if child is not None
        ]
        ranked.sort(key=lambda item: item[:2], reverse=True)
        stack += [child for _, _, child in ranked]


def _child(group: Group, node: Node, first: str, second: str) -> Node | None:
    """Return the node in which ``first`` goes before ``second``, or nothing if that fails."""
    before = node.before | {(first, second)}
    if _ahead(before, first) & {second}:
        return None
    runs, meetings = dict(node.runs), dict(node.meetings)
    queue = [second]
    while queue:
        name = queue.pop(0)
        ahead = _ahead(before, name)
        attempt = _plan(group, name, runs, ahead)
        if attempt.run is None:
            group.stuck |= {name, *ahead}
            return None
        runs[name] = attempt.run
        _renew_meetings(group, runs, meetings, name)
        for pair in sorted(meetings):
            if name in pair:
                other = pair[0] if pair[1] == name else pair[1]
                # somebody of lower rank is in the way now: it has to give way again
                if name in _ahead(before, other) and other not in queue:
                    queue.append(other)
        follower = next((n for n in _order(group) if _previous(group, n) == name), None)
        if follower and runs[follower].timing.trajectory.start < runs[name].arrival:
            queue.append(follower)
        if group.deadline.expired():
            return None
    return Node(runs, before, meetings)


def _ahead(before: frozenset[Pair], name: str) -> set[str]:
    """Return everybody who goes before ``name``, directly or not."""
    found: set[str] = set()
    todo = [name]
    while todo:
        last = todo.pop()
        for a, b in before:
            if b == last and a not in found:
                found.add(a)
                todo.append(a)
    return found


def _renew_meetings(
    group: Group, runs: Mapping[str, Run], meetings: dict[Pair, float], name: str
) -> None:
    for other in runs:
        pair = (name, other) if name < other else (other, name)
        meetings.pop(pair, None)
        if other != name:
            at = group.workspace.meeting(runs[pair[0]], runs[pair[1]])[0]
            if at < math.inf:
                meetings[pair] = at


def _hopeless(name: str, attempt: Attempt, seconds: float) -> GroupReport:
    report = attempt.report
    reason = report.reason if report else "no safe timing or detour found"
    return GroupReport(
        failed(attempt),
        conflict=frozenset({name}),
        blockers=report.blockers if report else attempt.met,
        reason=f"{name}: {reason}",
        seconds=seconds,
    )


def _report(group: Group, began: float) -> GroupReport:
    if group.best is None:
        return GroupReport(
            Outcome.OUT_OF_TIME,
            conflict=frozenset(group.stuck) or frozenset(group.motions),
            reason="no order of the robots was found in which all can drive",
            seconds=time.monotonic() - began,
        )
    runs = group.best.runs
    late = {
        name: runs[name].arrival
        for name in sorted(runs)
        if runs[name].arrival > group.motions[name].due + ON_TIME
    }
    return GroupReport(
        Outcome.FOUND,
        {name: runs[name].timing.trajectory for name in sorted(runs)},
        late,
        frozenset(group.stuck) | frozenset(late) if late else frozenset(),
        seconds=time.monotonic() - began,
    )


def sequence(names: Sequence[str]) -> str:
    """Return names for a sentence."""
    return ", ".join(sorted(names))
