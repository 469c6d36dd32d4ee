"""Orders of priority: search over who goes before whom, and by how much effort each one is planned.

Priority-based search (Ma et al. 2019): conflicts are resolved one by one, earliest first, by giving
one of two robots priority and planning the other one again around all that come before it. The
first branch is prioritised planning by release time and slack; the others are other priorities.
Lateness orders the branches. Where no order works for a few robots, they are moved together.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from up_samp.model import (
    Deadline,
    Rest,
    TimedMotion,
    Trajectory,
)
from up_samp.motion.fleet.deadlocks import Drives, untie
from up_samp.motion.fleet.detours import pass_by
from up_samp.motion.fleet.one_robot import Attempt, plan_one
from up_samp.motion.fleet.paths import TIMES, Path, path_of
from up_samp.motion.fleet.speed import Window, first_start, fit
from up_samp.motion.fleet.timed_path import TimedPath, Timing, natural_timing, pose_at, run_of
from up_samp.motion.fleet.workspace import Workspace, rest_run

BEGINS = 40
"""Begins tried for drives that have to be at the same time."""

POLISH, POLISH_WORTH = 4, 0.1
"""Rounds in which each of those moved together is planned again; s that a round has to gain for
another one.
"""


def tied_by(conflicts: Iterable[tuple[str, str]]) -> list[set[str]]:
    """Return the sets of motions that hang together by conflicts."""
    parts: list[set[str]] = []
    for pair in sorted(conflicts):
        joined = set(pair).union(*(part for part in parts if part & set(pair)))
        parts = [part for part in parts if not part & joined]
        parts.append(joined)
    return parts


def couple(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    alone: Mapping[str, TimedPath],
    world: Sequence[TimedPath],
    deadline: Deadline,
    seed: int = 0,
) -> dict[str, TimedPath] | None:
    """Return runs of ``motions`` moved together that keep clear of each other and of the ``world``,
    or None if none are found or they are not of the kind that this can couple.

    ``alone`` are the runs of the motions without each other. The robots must drive in the plane,
    from one pose to another each, have different names, and be there before the first release.
    """
    if workspace.scene is None or not _can_couple(motions):
        return None
    beside = pass_by(workspace, motions, alone, world)
    if beside is not None:
        return beside
    sequences = untie(workspace, motions, alone, world, deadline, seed)
    timed = (_timed(workspace, motions, world, sequence) for sequence in sequences)
    found = [legs for legs in timed if legs is not None and not _collide(workspace, world, legs)]
    # who has no drive stays where it is
    options = [
        {
            m.name: _one_run(m, drives) if drives else alone[m.name]
            for m, drives in zip(motions, legs, strict=True)
        }
        for legs in found
    ]
    return min(options, key=lambda runs: sum(run.arrival for run in runs.values()), default=None)


def _can_couple(motions: Sequence[TimedMotion]) -> bool:
    first = min(m.release for m in motions)
    return (
        len(motions) > 1
        and len({m.object for m in motions}) == len(motions)
        and all(len(m.poses) == 2 and not m.body.flies for m in motions)
        and all(m.present_from <= first for m in motions)
    )


def _collide(
    workspace: Workspace, world: Sequence[TimedPath], legs: Sequence[Sequence[TimedPath]]
) -> bool:
    """Return whether any two robots' drives, or a drive and the world, meet."""
    pairs = [pair for a, b in itertools.combinations(legs, 2) for pair in itertools.product(a, b)]
    pairs += [(run, other) for runs in legs for run in runs for other in world]
    return any(workspace.meeting(a, b)[0] < math.inf for a, b in pairs)


def _timed(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    world: Sequence[TimedPath],
    sequence: Sequence[Drives],
) -> list[list[TimedPath]] | None:
    """Return the drives of each robot, every one as early as those before it in the sequence
    allow.
    """
    legs: list[list[TimedPath]] = [
        [replace(rest_run(workspace, Rest(m.object, m.body, m.poses[0])), avoid=m.avoid)]
        for m in motions
    ]
    for drives in sequence:
        robots = {robot for robot, _ in drives}
        others = [run for i, runs in enumerate(legs) if i not in robots for run in runs]
        parts = [_leg(motions[robot], legs[robot], path) for robot, path in drives]
        found = _begun(workspace, parts, [*world, *others])
        if found is None:
            return None
        for (robot, _), (_, window, _), run in zip(drives, parts, found, strict=True):
            last, moved = legs[robot][-1], len(legs[robot]) > 1
            # from then on the robot is where this drive leaves it
            until = min(last.until, window.since if moved else run.since)
            legs[robot][-1] = replace(last, until=until)
            legs[robot].append(run)
    return [runs[1:] for runs in legs]


def _leg(
    motion: TimedMotion, legs: Sequence[TimedPath], path: Path
) -> tuple[TimedMotion, Window, Path]:
    """Return a robot's next drive after those in ``legs``, and when it may begin."""
    last, moved = legs[-1], len(legs) > 1
    since = last.arrival if moved else motion.present_from
    window = Window(since, max(motion.release, last.arrival) if moved else motion.release)
    final = path.poses[-1][:2].tolist() == list(motion.poses[1][:2])
    leg = replace(
        motion,
        poses=(pose_at(path, 0), pose_at(path, -1)),
        release=window.release,
        present_until=motion.present_until if final else math.inf,
    )
    return leg, window, path


def _begun(
    workspace: Workspace,
    parts: Sequence[tuple[TimedMotion, Window, Path]],
    others: Sequence[TimedPath],
) -> list[TimedPath] | None:
    """Return the runs of drives that go at the same time: one with its speed tuned, several begun
    together, as early as all of them can.
    """
    if len(parts) == 1:
        run = fit(workspace, *parts[0], others)
        return None if run is None else [run]
    begin = max(window.release for _, window, _ in parts)
    for _ in range(BEGINS):
        found = []
        for leg, window, path in parts:
            start = first_start(workspace, leg, replace(window, release=begin), path, others)
            if start is None:
                return None
            found.append(start)
        if max(found) <= begin:
            return [
                run_of(leg, path, natural_timing(path, begin), window.since)
                for leg, window, path in parts
            ]
        begin = max(found)
    return None


def _one_run(motion: TimedMotion, legs: Sequence[TimedPath]) -> TimedPath:
    """Return the drives of one robot as one run, with rests in between."""
    times, poses = [legs[0].timing.trajectory.times], [legs[0].timing.trajectory.poses]
    for leg in legs[1:]:
        t, rows = leg.timing.trajectory.times, leg.timing.trajectory.poses.copy()
        rows[:, 2] += 2 * math.pi * round((poses[-1][-1, 2] - rows[0, 2]) / (2 * math.pi))
        # without a wait the last pose is already there
        skip = 1 if t[0] <= times[-1][-1] + 1e-9 else 0
        times.append(t[skip:])
        poses.append(rows[skip:])
    whole = Trajectory(np.concatenate(times), np.concatenate(poses))
    stops = [pose_at(leg.path, -1) for leg in legs]
    path = path_of(whole, motion.body, (motion.poses[0], *stops))
    return run_of(motion, path, Timing(whole, path.natural_s), legs[0].since)


# ------------------ Orders of priority


Pair = tuple[str, str]

NODES = (60, 8)
"""Nodes of the search over priorities on each rung, that is by effort for one robot: speeds and
lanes, detours.
"""


@dataclass(frozen=True, eq=False)
class Node:
    """Runs by motion name, who goes before whom, and which pairs still meet (at what time)."""

    runs: Mapping[str, TimedPath]
    before: frozenset[Pair] = frozenset()
    conflicts: Mapping[Pair, float] = field(default_factory=dict)


@dataclass
class Group:
    """A group under search, with the best answers so far."""

    workspace: Workspace
    motions: dict[str, TimedMotion]
    world: list[TimedPath]
    deadline: Deadline
    effort: int = 0
    best: Node | None = None
    least: float = 0.0
    """Lateness (s) of everybody alone."""
    stuck: set[str] = field(default_factory=set)
    """Motions that could not be planned in some branch, with those before them."""
    met: set[str] = field(default_factory=set)
    """Objects that were in the way of best paths."""

    @cached_property
    def order(self) -> list[str]:
        """The motions by release, then by due (less slack first), then by name."""
        return sorted(self.motions, key=lambda n: (self.motions[n].release, self.motions[n].due, n))

    @cached_property
    def previous(self) -> dict[str, str]:
        """The same object's motion just before each one (where there is one)."""
        last: dict[str, str] = {}
        found: dict[str, str] = {}
        for name in self.order:
            motion = self.motions[name]
            if motion.object in last:
                found[name] = last[motion.object]
            last[motion.object] = name
        return found

    def is_late(self, run: TimedPath) -> bool:
        """Return whether a run arrives after its motion's due."""
        return run.arrival > self.motions[run.name].due + TIMES.on_time

    def finished(self) -> bool:
        """Return whether nobody can be less late, as far as driving alone tells."""
        return self.best is not None and self.lateness(self.best.runs) <= self.least + TIMES.on_time

    def lateness(self, runs: Mapping[str, TimedPath]) -> float:
        """Return the sum of all lateness (s)."""
        late = (runs[name].arrival - self.motions[name].due for name in sorted(runs))
        return sum(x for x in late if x > TIMES.on_time)

    def cost(self, runs: Mapping[str, TimedPath]) -> tuple[float, float]:
        """Return (lateness, sum of arrivals), less is better."""
        return self.lateness(runs), sum(runs[name].arrival for name in sorted(runs))


def climb(group: Group, root: Node, *, coupled: bool = True) -> None:
    """Search with more and more effort until nobody is later than alone; where no order is found
    and that is wanted, move those together that meet (``coupled``).
    """
    group.least = group.lateness(root.runs)
    for effort, nodes in enumerate(NODES):
        if effort == 1:
            _pass(group, root)
            if group.finished():
                return
        group.effort = effort
        _search(group, root, nodes)
        if group.finished() or group.deadline.expired():
            return
    if coupled and group.best is None:
        _couple(group, root)


def _pass(group: Group, root: Node) -> None:
    """Let pairs that meet pass each other, each robot in a lane of its own, if that is better."""
    if len({m.object for m in group.motions.values()}) < len(group.motions):
        return  # who comes later would be late for its next motion
    runs: dict[str, TimedPath] | None = dict(root.runs)
    for part in tied_by(root.conflicts):
        runs = None if runs is None else _moved_together(group, root, runs, part, pass_by)
    if runs is None:
        return
    if group.best is None or group.cost(runs) < group.cost(group.best.runs):
        group.best = Node(runs)


def _couple(group: Group, root: Node) -> None:
    """Move those that meet together, where no order of them was found; or else everybody."""
    together = partial(couple, deadline=group.deadline)
    counts = Counter(motion.object for motion in group.motions.values())
    parts = tied_by(root.conflicts)
    if any(counts[group.motions[n].object] > 1 for part in parts for n in part):
        return  # the same object's other motions would have to give way, too
    runs: dict[str, TimedPath] | None = dict(root.runs)
    for part in parts:
        runs = None if runs is None else _moved_together(group, root, runs, part, together)
    everybody = parts == [set(group.motions)]
    if runs is None and not everybody and len(counts) == len(group.motions):
        runs = _moved_together(group, root, root.runs, set(group.motions), together)
    if runs is not None:
        group.best = Node(_polished(group, runs))


def _moved_together(
    group: Group,
    root: Node,
    runs: Mapping[str, TimedPath],
    part: set[str],
    by: Callable[..., dict[str, TimedPath] | None],
) -> dict[str, TimedPath] | None:
    """Return ``runs`` with those of a ``part`` moved together among the others, if found."""
    motions = [group.motions[n] for n in group.order if n in part]
    world = [*group.world, *(runs[n] for n in sorted(runs) if n not in part)]
    found = by(group.workspace, motions, root.runs, world)
    return None if found is None else {**runs, **found}


def _polished(group: Group, runs: Mapping[str, TimedPath]) -> dict[str, TimedPath]:
    """Return runs in which nobody arrives later: each motion planned again among the others, the
    last to arrive first.
    """
    found = dict(runs)
    for _ in range(POLISH):
        gained = 0.0
        for name in sorted(found, key=lambda n: (-found[n].arrival, n)):
            others = [n for n in found if n != name]
            attempt = _plan(group, name, found, others)
            old = found[name].arrival
            if attempt.run is not None and attempt.run.arrival < old - TIMES.on_time:
                found[name] = attempt.run
                gained += old - attempt.run.arrival
            if group.deadline.expired():
                return found
        if gained < POLISH_WORTH:
            break
    return found


def window_of(group: Group, name: str, runs: Mapping[str, TimedPath]) -> Window:
    """Return when a motion may happen: not before its object has arrived from the last one."""
    motion = group.motions[name]
    previous = group.previous.get(name)
    if previous is None or previous not in runs:
        return Window(motion.present_from, motion.release)
    arrival = runs[previous].arrival
    since = max(motion.present_from, arrival) if motion.present_from > -math.inf else arrival
    return Window(min(since, max(motion.release, arrival)), max(motion.release, arrival))


def _plan(group: Group, name: str, runs: Mapping[str, TimedPath], first: Iterable[str]) -> Attempt:
    """Plan one motion around the world and the runs of those that go ``first``."""
    others = [*group.world, *(runs[other] for other in sorted(first))]
    window, motion = window_of(group, name, runs), group.motions[name]
    attempt = plan_one(group.workspace, motion, window, others, group.deadline, group.effort)
    group.met |= attempt.met
    return attempt


def alone(group: Group) -> tuple[Node | None, Attempt, str]:
    """Plan everybody alone; return the node, or the first motion that is impossible on its own."""
    runs: dict[str, TimedPath] = {}
    attempt = Attempt(None)
    for name in group.order:
        for effort in range(len(NODES)):
            group.effort = effort
            attempt = _plan(group, name, runs, ())
            if attempt.run is not None and not group.is_late(attempt.run):
                break
        if attempt.run is None:
            return None, attempt, name
        runs[name] = attempt.run
    return Node(runs, frozenset(), _all_conflicts(group, runs)), attempt, ""


def _all_conflicts(group: Group, runs: Mapping[str, TimedPath]) -> dict[Pair, float]:
    names = sorted(runs)
    conflicts: dict[Pair, float] = {}
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            at = group.workspace.meeting(runs[a], runs[b])[0]
            if at < math.inf:
                conflicts[a, b] = at
    return conflicts


def _search(group: Group, root: Node, budget: int) -> None:
    """Search priorities depth first, children by cost; keeps the best node without a meeting."""
    stack = [root]
    while stack and budget > 0 and not group.deadline.expired():
        node = stack.pop()
        budget -= 1
        if group.best is not None and group.lateness(node.runs) >= group.lateness(group.best.runs):
            continue
        if not node.conflicts:
            group.best = node
            if group.finished():
                return
            continue
        a, b = min(node.conflicts, key=lambda pair: (node.conflicts[pair], pair))
        children = [_child(group, node, a, b), _child(group, node, b, a)]
        order = {name: i for i, name in enumerate(group.order)}
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
    runs, conflicts = dict(node.runs), dict(node.conflicts)
    queue = [second]
    while queue:
        name = queue.pop(0)
        ahead = _ahead(before, name)
        attempt = _plan(group, name, runs, ahead)
        if attempt.run is None:
            group.stuck |= {name, *ahead}
            return None
        runs[name] = attempt.run
        _renew_conflicts(group, runs, conflicts, name)
        for other in sorted(_partners(conflicts, name)):
            if other in ahead:
                # it rests in the way before it may leave: whoever comes first cannot come there
                group.stuck |= {name, other}
                return None
            # somebody of lower rank is in the way now: it has to give way again
            if name in _ahead(before, other) and other not in queue:
                queue.append(other)
        follower = next((n for n, p in group.previous.items() if p == name), None)
        if follower and runs[follower].timing.trajectory.start < runs[name].arrival:
            queue.append(follower)
        if group.deadline.expired():
            return None
    return Node(runs, before, conflicts)


def _partners(conflicts: Mapping[Pair, float], name: str) -> set[str]:
    """Return who meets ``name``."""
    return {a if b == name else b for a, b in conflicts if name in (a, b)}


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


def _renew_conflicts(
    group: Group, runs: Mapping[str, TimedPath], conflicts: dict[Pair, float], name: str
) -> None:
    for other in runs:
        pair = (name, other) if name < other else (other, name)
        conflicts.pop(pair, None)
        if other != name:
            at = group.workspace.meeting(runs[pair[0]], runs[pair[1]])[0]
            if at < math.inf:
                conflicts[pair] = at
