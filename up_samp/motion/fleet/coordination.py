"""Several robots at once, in the plane, in the air, or both: a ladder of efforts, and a report of
what really conflicts.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from up_samp.model import (
    Deadline,
    GroupQuery,
    GroupReport,
    Outcome,
    TimedMotion,
    UnsupportedError,
    avoids,
)
from up_samp.model.arrays import IntArray
from up_samp.motion.budget import WorkBudget
from up_samp.motion.fleet.neighbourhoods import (
    MovingGroup,
    arrivals_and_lateness,
    first_runs,
    improve,
)
from up_samp.motion.fleet.one_robot import Attempt, failed, nothing, sample_one
from up_samp.motion.fleet.paths import TIMES, Path
from up_samp.motion.fleet.priority_search import Group, Node, alone, climb, window_of
from up_samp.motion.fleet.timed_path import TimedPath, fixed_run
from up_samp.motion.fleet.workspace import PathPlanner, Workspace, rest_run, workspace_of


def one_decides(runs: IntArray) -> bool:
    """Return whether conflicting cells, as rows (i, j first, j last) by rising i, are one piece in
    which each row and each column is without a gap.
    """
    if len(runs) == 0:
        return True
    i, low, high = runs.T
    if np.any(np.diff(i) != 1):
        return False  # a row is missing, or has a gap
    if np.any(np.maximum(low[1:], low[:-1]) > np.minimum(high[1:], high[:-1]) + 1):
        return False  # neighbouring rows do not touch
    for j in range(int(low.min()), int(high.max()) + 1):
        rows = np.flatnonzero((low <= j) & (j <= high))
        if len(rows) and rows[-1] - rows[0] + 1 != len(rows):
            return False
    return True


def _avoid_each_other(one: TimedMotion, other: TimedMotion) -> bool:
    return avoids(one.avoid, other.object) and avoids(other.avoid, one.object)


def order_decides(
    service: PathPlanner, first: TimedMotion, second: TimedMotion, deadline: Deadline
) -> bool:
    """Return whether it decides everything who goes first, on the fastest ways of two motions when
    nobody else is there.
    """
    if first.body.flies or second.body.flies:
        return False
    if not _avoid_each_other(first, second):
        return False
    workspace = workspace_of(service)
    ways = [workspace.path(m.body, m.poses, (), deadline) for m in (first, second)]
    one, other = ways
    if not isinstance(one, Path) or not isinstance(other, Path):
        return False
    return one_decides(workspace.conflicts(one, other))


# ------------------ A ladder of efforts, and a report of what really conflicts
# Everybody is first planned alone; then one after the other, with ejection
# (``up_samp.motion.fleet.neighbourhoods``). Where somebody is late, orders of priority are tried
# with more and more effort (``up_samp.motion.fleet.priority_search``), and a few robots for which
# no order works are moved together. A group that fails or is late is shrunk to the few motions that
# really conflict.


METHODS = ("ladder", "st-rrt*")

FEW, MUCH = 12, 1.5
"""Where fewer motions take so many times as long as alone, as much is tried as for so many."""


def coordinate(
    service: PathPlanner,
    query: GroupQuery,
    deadline: Deadline,
    *,
    seed: int = 0,
    method: str = "ladder",
) -> GroupReport:
    """Find trajectories for all motions of ``query`` that keep clear of each other, of what rests
    and of what is already decided; late if there is no other way found.

    ``method``: "ladder", or "st-rrt*" as in the paper: one robot after the other by ST-RRT* among
    those before it, without other priorities, for bodies in the plane.
    Deterministic for a ``seed`` as long as the ``deadline`` does not cut it short.
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    bodies = [m.body for m in query.motions] + [m.body for m in query.fixed]
    if method != "ladder" and any(body.flies for body in bodies):
        raise UnsupportedError(f"the method '{method}' is for planar bodies; one here is SE3")
    workspace = workspace_of(service)
    truncated = workspace.truncated
    report = _coordinated(workspace, query, deadline, seed, method)
    whole = not deadline.expired() and workspace.truncated == truncated
    return replace(report, complete=whole)


def _coordinated(
    workspace: Workspace, query: GroupQuery, deadline: Deadline, seed: int, method: str
) -> GroupReport:
    began = time.monotonic()
    group = _group_of(workspace, query, deadline)
    if method == "st-rrt*":
        return _one_by_one(group, seed, began)
    root, attempt, name = alone(group)
    if root is None:
        return _hopeless(name, attempt, deadline, time.monotonic() - began)
    _decide(group, root, seed)
    if group.best is None or not group.finished():
        climb(group, root)
    conflict = _shrunk(group, root) if _is_bad(group) else frozenset()
    report = _report(group, conflict, time.monotonic() - began)
    return replace(report, exhaustive=_is_tried_out(group, root))


def _decide(group: Group, root: Node, seed: int) -> None:
    """Plan a group whose members meet one after the other, with ejection; where somebody is late
    then, or all are much later than alone, a few of them again.
    """
    if not root.conflicts:
        return
    effort = group.workspace.tuning
    budget = WorkBudget(group.deadline, effort.first * len(root.runs))
    cost = arrivals_and_lateness(group.motions)
    ways = {name: [run.path] for name, run in root.runs.items()}
    motions = MovingGroup(group.workspace, group.motions, group.world, cost, budget, ways)
    runs = first_runs(motions)
    if runs is None:
        return
    group.best = Node(runs)
    group.least = group.lateness(root.runs)
    least = sum(group.motions[n].release + motions.alone(n) for n in runs)

    few = effort.again * len(runs)

    def enough(runs: Mapping[str, TimedPath]) -> bool:
        late = group.lateness(runs) > group.least + TIMES.on_time
        factor = effort.enough if motions.budget.used < few else MUCH
        return not late and sum(run.arrival for run in runs.values()) <= factor * least

    # who is late may have to be: that is not worth more
    late = group.lateness(runs) > group.least + TIMES.on_time
    plans = few if late else max(few, effort.again * FEW)
    motions.budget = WorkBudget(group.deadline, plans)
    group.best = Node(improve(motions, runs, list(runs), seed, enough))


def _is_tried_out(group: Group, root: Node) -> bool:
    """Return whether there are no other ways to coordinate the group than were tried: two robots,
    each in time alone, of which the one goes first or the other, and nothing else that comes or
    goes on their ways.
    """
    if len(root.runs) != 2 or group.least > 0.0:
        return False
    one, other = group.motions.values()
    if one.object == other.object or not _avoid_each_other(one, other):
        return False
    if one.body.flies or other.body.flies:
        return False
    paths = [root.runs[m.name].path for m in (one, other)]
    if not one_decides(group.workspace.conflicts(*paths)):
        return False
    # who waits for a door may wait ahead of the other one or behind it: that was not tried
    return not any(
        len(group.workspace.forbidden(path, m.object, m.avoid, group.world))
        for m, path in zip((one, other), paths, strict=True)
    )


def _one_by_one(group: Group, seed: int, began: float) -> GroupReport:
    """Plan one motion after the other by ST-RRT*, each among those before it."""
    runs: dict[str, TimedPath] = {}
    for name in group.order:
        motion, window = group.motions[name], window_of(group, name, runs)
        others = [*group.world, *runs.values()]
        attempt = sample_one(group.workspace, motion, window, others, group.deadline, seed)
        group.met |= attempt.met
        if attempt.run is None:
            return GroupReport(
                nothing(group.deadline),
                conflict=frozenset({*runs, name}),
                blockers=_resting(group),
                reason=f"{name}: ST-RRT* found no way among those before it",
                seconds=time.monotonic() - began,
            )
        runs[name] = attempt.run
    group.best = Node(runs)
    conflict = frozenset(runs) if _is_bad(group) else frozenset()
    return _report(group, conflict, time.monotonic() - began)


def _is_bad(group: Group) -> bool:
    return group.best is None or group.lateness(group.best.runs) > 0.0


def _shrunk(group: Group, root: Node) -> frozenset[str]:
    """Return few motions that cannot meet their windows even without the others.

    One that is late alone; or else a pair; or else what is left when every motion that does not
    matter is dropped. Each set is checked again with the others gone (cheap rungs only).
    """
    late = [n for n in group.order if group.is_late(root.runs[n])]
    if late:
        return frozenset(late[:1])
    bad = group.best.runs if group.best else {}
    suspects = {n for n in bad if group.is_late(bad[n])} or set(group.stuck)
    suspects |= {n for pair in root.conflicts for n in pair if suspects & set(pair)}
    names = [n for n in group.order if n in (suspects or set(group.motions))]
    for pair in itertools.combinations(names, 2):
        if _fails(group, root, pair):
            return frozenset(pair)
    for name in list(names):
        rest = [n for n in names if n != name]
        if len(rest) > 1 and _fails(group, root, rest):
            names = rest
    return frozenset(names)


def _fails(group: Group, root: Node, names: Sequence[str]) -> bool:
    """Return whether these motions alone are found not to meet their windows."""
    if group.deadline.expired():
        return False
    chosen = {n: group.motions[n] for n in group.motions if n in names}
    conflicts = {pair: at for pair, at in root.conflicts.items() if set(pair) <= set(names)}
    if not conflicts:
        return False
    part = Group(group.workspace, chosen, group.world, group.deadline)
    runs = {n: root.runs[n] for n in chosen}
    climb(part, Node(runs, frozenset(), conflicts), coupled=False)
    return _is_bad(part) and not group.deadline.expired()


def _group_of(workspace: Workspace, query: GroupQuery, deadline: Deadline) -> Group:
    world = [rest_run(workspace, rest) for rest in query.rests]
    world += [fixed_run(motion) for motion in query.fixed]
    motions = {motion.name: motion for motion in query.motions}
    if len(motions) != len(query.motions):
        raise ValueError("two motions of a group have the same name")
    return Group(workspace, motions, world, deadline)


def _hopeless(name: str, attempt: Attempt, deadline: Deadline, seconds: float) -> GroupReport:
    report = attempt.report
    reason = report.reason if report else "no safe timing or detour found"
    return GroupReport(
        failed(attempt, deadline),
        conflict=frozenset({name}),
        blockers=report.blockers if report else attempt.met,
        reason=f"{name}: {reason}",
        seconds=seconds,
    )


def _report(group: Group, conflict: frozenset[str], seconds: float) -> GroupReport:
    if group.best is None:
        return GroupReport(
            nothing(group.deadline),
            conflict=conflict,
            blockers=_resting(group),
            reason="no order of the robots was found in which all can drive",
            seconds=seconds,
        )
    runs = group.best.runs
    late = {name: runs[name].arrival for name in sorted(runs) if group.is_late(runs[name])}
    return GroupReport(
        Outcome.FOUND,
        {name: runs[name].timing.trajectory for name in sorted(runs)},
        late,
        conflict,
        _resting(group) if late else frozenset(),
        f"late: {', '.join(late)}" if late else "",
        seconds,
    )


def _resting(group: Group) -> frozenset[str]:
    """Return the resting objects that were met."""
    return frozenset(o.object for o in group.world if o.path.cells == 0 and o.object in group.met)
