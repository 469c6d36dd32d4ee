"""Coordination of several robots, in the plane, in the air, or both: a ladder of efforts, and a
report of what really conflicts.

Everybody is first planned alone; then one after the other, with ejection
(:mod:`up_samp.motion.fleet.neighbourhoods`). Where somebody is late, others go first, with more and
more effort for each one, and a few robots for which no order works are moved together
(:mod:`up_samp.motion.fleet.together`). A group that fails or is late is shrunk to the few motions
that really conflict.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from up_samp.model import (
    Deadline,
    GroupQuery,
    GroupReport,
    Outcome,
    Placed,
    TimedMotion,
)
from up_samp.motion.fleet.neighbourhoods import MovingGroup, Runs, first_runs, improve
from up_samp.motion.fleet.one_robot import Attempt, nothing, plan_one, virtual_obstacles
from up_samp.motion.fleet.paths import SAME_TIME, Path
from up_samp.motion.fleet.speed import parked_all_the_time
from up_samp.motion.fleet.timed_path import ON_TIME, TimedPath
from up_samp.motion.fleet.together import couple
from up_samp.motion.fleet.workspace import PathPlanner, Workspace, rest_run, workspace_of
from up_samp.motion.protocol import WorkBudget

Pair = tuple[str, str]

FIRST, AGAIN = 20, 30
"""Motions planned for each one of a group: with who is in the way ejected; and once more, where
somebody is late, or all much later than alone.
"""

ENOUGH = 1.15
"""Of the arrivals alone, with which a group on time is content."""

FEW, MUCH = 12, 1.5
"""Where fewer motions take so many times as long as alone, as much is tried as for so many."""

ORDERS = 4
"""Orders that are tried at most."""

POLISH, POLISH_WORTH = 4, 0.1
"""Rounds in which each of those moved together is planned again; s that a round has to gain for
another one.
"""


def coordinate(
    service: PathPlanner,
    query: GroupQuery,
    deadline: Deadline,
    *,
    seed: int = 0,
    anytime: bool = False,
) -> GroupReport:
    """Find trajectories for all motions of ``query`` that keep clear of each other, of what rests
    and of what is already decided; late if there is no other way found.

    Where motions meet, a few are planned again until all arrive about as soon as alone (``ENOUGH``)
    or counted work is done; ``anytime``: until the ``deadline``, for the least sum of arrivals. The
    report's ``reason`` says what ended it. Deterministic for a ``seed`` as long as the ``deadline``
    does not cut it short.
    """
    workspace = workspace_of(service)
    truncated = workspace.truncated
    report = _coordinated(workspace, query, deadline, seed, anytime)
    whole = not deadline.expired() and workspace.truncated == truncated
    return replace(report, complete=whole)


def _coordinated(
    workspace: Workspace, query: GroupQuery, deadline: Deadline, seed: int, anytime: bool
) -> GroupReport:
    group = _group_of(workspace, query, deadline)
    alone, attempt, name = _alone(group)
    if len(alone) < len(group.motions):
        return _hopeless(name, attempt)
    group.least = group.lateness(alone)
    conflicts = _meetings(group, alone)
    if conflicts:
        _eject(group, alone, seed, anytime)
        if group.best is None or not group.finished():
            climb(group, alone, conflicts)
    else:
        group.best = alone
    conflict = _shrunk(group, alone, conflicts) if _is_bad(group) else frozenset()
    return _report(group, conflict)


def _alone(group: MovingGroup) -> tuple[dict[str, TimedPath], Attempt, str]:
    """Plan everybody alone, up to the first motion that is impossible on its own; return the runs,
    and the last attempt with its motion.
    """
    runs: dict[str, TimedPath] = {}
    attempt, name = Attempt(None), ""
    for name in group.order:
        attempt = _plan(group, name, runs, group.world)
        if attempt.run is None:
            break
        runs[name] = attempt.run
    return runs, attempt, name


def _plan(group: MovingGroup, name: str, runs: Runs, others: Sequence[TimedPath]) -> Attempt:
    """Plan one motion around others, after its object's last one in ``runs``."""
    motion = group.after_last(name, runs)
    attempt = plan_one(group.workspace, motion, others, group.deadline)
    group.passed |= attempt.met
    return attempt


def _meetings(group: MovingGroup, runs: Runs) -> list[Pair]:
    """Return which motions meet each other."""
    meeting = group.workspace.meeting
    pairs = itertools.combinations(sorted(runs), 2)
    return [(a, b) for a, b in pairs if meeting(runs[a], runs[b])[0] < math.inf]


def _eject(group: MovingGroup, alone: Runs, seed: int, anytime: bool) -> None:
    """Plan a group whose members meet one after the other, with ejection; where somebody is late
    then, or all are much later than alone, a few of them again (``anytime``: while there is time).
    """
    group.budget = WorkBudget(group.deadline, FIRST * len(alone))
    group.ways = {name: [run.path] for name, run in alone.items()}
    runs = first_runs(group)
    if runs is None:
        return
    least = sum(group.motions[n].release + group.alone(n) for n in runs)
    few = AGAIN * len(runs)

    def enough(runs: Runs) -> bool:
        late = group.lateness(runs) > group.least + ON_TIME
        factor = ENOUGH if group.budget.used < few else MUCH
        soon = sum(run.arrival for run in runs.values()) <= factor * least
        return soon and not late and not anytime

    # who is late may have to be: that is not worth more
    late = group.lateness(runs) > group.least + ON_TIME
    most = few if late else max(few, AGAIN * FEW)
    group.budget = WorkBudget(group.deadline, None if anytime else most)
    group.best = improve(group, runs, list(runs), seed, enough)
    ratio = sum(run.arrival for run in group.best.values()) / max(least, SAME_TIME)
    end = "the time or work is done" if group.budget.cut else "that is good enough"
    group.ended = f"{ratio:.2f} times the arrivals alone: {end}"


def climb(group: MovingGroup, alone: Runs, conflicts: Sequence[Pair]) -> None:
    """Search until nobody is later than alone: orders; where nothing is found, move those together
    that meet, or look harder for ways past each other.
    """
    one_after_another(group)
    for attempt in (_together, _past_each_other):
        if group.best is not None or group.deadline.expired():
            return
        attempt(group, alone, conflicts)


def one_after_another(group: MovingGroup) -> None:
    """Plan one motion after the other, first by release and slack; who is late then, or finds no
    way, goes before all others in the next order (squeaky wheel optimisation; Joslin and Clements
    1999).
    """
    order, tried = tuple(group.order), set[tuple[str, ...]]()
    while len(tried) < ORDERS and order not in tried and not group.deadline.expired():
        tried.add(order)
        late, runs = _in_order(group, order)
        if len(runs) == len(order):
            group.keep(runs)
        if late is None or group.finished():
            return
        mine = group.motions[late].object
        first = [n for n in order if group.motions[n].object == mine]
        order = (*first, *(n for n in order if n not in first))


def _in_order(group: MovingGroup, order: Sequence[str]) -> tuple[str | None, dict[str, TimedPath]]:
    """Return who is latest, or has no way, if one motion is planned after the other, and the runs
    of those that are planned.
    """
    runs: dict[str, TimedPath] = {}
    late: dict[str, float] = {}
    for name in order:
        attempt = _plan(group, name, runs, group.others(name, runs))
        if attempt.run is None:
            group.stuck.add(name)
            return name, runs
        runs[name] = attempt.run
        if group.is_late(attempt.run):
            late[name] = attempt.run.arrival - group.motions[name].due
    return max(late, key=lambda name: late[name], default=None), runs


def _together(group: MovingGroup, alone: Runs, conflicts: Sequence[Pair]) -> None:
    """Move those that meet together, or else everybody."""
    counts = Counter(motion.object for motion in group.motions.values())
    parts = tied_by(conflicts)
    if any(counts[group.motions[n].object] > 1 for part in parts for n in part):
        return  # the same object's other motions would have to give way, too
    runs: Runs | None = alone
    for part in parts:
        runs = None if runs is None else _moved_together(group, alone, runs, part)
    everybody = parts == [set(group.motions)]
    if runs is None and not everybody and len(counts) == len(group.motions):
        runs = _moved_together(group, alone, alone, set(group.motions))
    if runs is not None:
        group.keep(_polished(group, runs))


def _past_each_other(group: MovingGroup, alone: Runs, conflicts: Sequence[Pair]) -> None:
    """Plan with ejection again, now that each of two that meet knows a way around where they do, be
    it as thin as the robot.
    """
    workspace, found = group.workspace, []
    for name, other in itertools.chain.from_iterable((pair, pair[::-1]) for pair in conflicts):
        motion, path = group.motions[name], alone[name].path
        _, _, cell = workspace.meeting(alone[name], alone[other])
        copies = virtual_obstacles(workspace, path, [(alone[other], cell, 0.0)])
        copies = copies[len(copies) // 2 :][:1]  # more of them might close both ways
        static = parked_all_the_time(motion, group.world)
        way = workspace.path(motion.body, motion.poses, (*static, *copies), group.deadline)
        if isinstance(way, Path):
            group.ways[name].append(way)
            found.append(way)
    if found:
        group.budget = WorkBudget(group.deadline, FIRST * len(alone))
        group.best = first_runs(group)


def tied_by(conflicts: Iterable[tuple[str, str]]) -> list[set[str]]:
    """Return the sets of motions that hang together by conflicts."""
    parts: list[set[str]] = []
    for pair in sorted(conflicts):
        joined = set(pair).union(*(part for part in parts if part & set(pair)))
        parts = [part for part in parts if not part & joined]
        parts.append(joined)
    return parts


def _moved_together(
    group: MovingGroup,
    alone: Runs,
    runs: Runs,
    part: set[str],
) -> Runs | None:
    """Return ``runs`` with those of a ``part`` moved together among the others, if found."""
    motions = [group.motions[n] for n in group.order if n in part]
    world = [*group.world, *(runs[n] for n in sorted(runs) if n not in part)]
    found = couple(group.workspace, motions, alone, world, group.deadline)
    return None if found is None else {**runs, **found}


def _polished(group: MovingGroup, runs: Runs) -> Runs:
    """Return runs in which nobody arrives later: each motion planned again among the others, the
    last to arrive first.
    """
    found = dict(runs)
    for _ in range(POLISH):
        gained = 0.0
        for name in sorted(found, key=lambda n: (-found[n].arrival, n)):
            others = group.others(name, found)
            attempt = _plan(group, name, found, others)
            old = found[name].arrival
            if attempt.run is not None and attempt.run.arrival < old - ON_TIME:
                found[name] = attempt.run
                gained += old - attempt.run.arrival
            if group.deadline.expired():
                return found
        if gained < POLISH_WORTH:
            break
    return found


def _is_bad(group: MovingGroup) -> bool:
    return group.best is None or group.lateness(group.best) > 0.0


def _shrunk(group: MovingGroup, alone: Runs, conflicts: Sequence[Pair]) -> frozenset[str]:
    """Return few motions that cannot meet their windows even without the others.

    One that is late alone; or else a pair; or else what is left when every motion that does not
    matter is dropped. Each set is checked again with the others gone (cheap rungs only).
    """
    late = [n for n in group.order if group.is_late(alone[n])]
    if late:
        return frozenset(late[:1])
    bad = group.best or {}
    suspects = {n for n in bad if group.is_late(bad[n])} or set(group.stuck)
    suspects |= {n for pair in conflicts for n in pair if suspects & set(pair)}
    names = [n for n in group.order if n in (suspects or set(group.motions))]
    for pair in itertools.combinations(names, 2):
        if _fails(group, alone, conflicts, pair):
            return frozenset(pair)
    for name in list(names):
        rest = [n for n in names if n != name]
        if len(rest) > 1 and _fails(group, alone, conflicts, rest):
            names = rest
    return frozenset(names)


def _fails(
    group: MovingGroup, alone: Runs, conflicts: Sequence[Pair], names: Sequence[str]
) -> bool:
    """Return whether these motions alone are found not to meet their windows."""
    some = [pair for pair in conflicts if set(pair) <= set(names)]
    if group.deadline.expired() or not some:
        return False
    chosen = {n: group.motions[n] for n in group.motions if n in names}
    part = MovingGroup(group.workspace, chosen, group.world, WorkBudget(group.deadline))
    part.least = part.lateness({n: alone[n] for n in chosen})
    one_after_another(part)
    return _is_bad(part) and not group.deadline.expired()


def _group_of(workspace: Workspace, query: GroupQuery, deadline: Deadline) -> MovingGroup:
    world = [rest_run(workspace, rest) for rest in query.rests]
    motions = {motion.name: motion for motion in query.motions}
    if len(motions) != len(query.motions):
        raise ValueError("two motions of a group have the same name")
    return MovingGroup(workspace, motions, world, WorkBudget(deadline))


def _hopeless(name: str, attempt: Attempt) -> GroupReport:
    report = attempt.report
    assert report is not None
    return GroupReport(
        report.outcome,
        conflict=frozenset({name}),
        blockers=report.blockers,
        reason=f"{name}: {report.reason}",
    )


def _report(group: MovingGroup, conflict: frozenset[str]) -> GroupReport:
    if group.best is None:
        return GroupReport(
            nothing(group.deadline),
            conflict=conflict,
            blockers=_resting(group),
            reason="no order of the robots was found in which all can drive",
        )
    runs = group.best
    late = {name: runs[name].arrival for name in sorted(runs) if group.is_late(runs[name])}
    return GroupReport(
        Outcome.FOUND,
        {name: runs[name].timing.trajectory for name in sorted(runs)},
        late,
        conflict,
        _resting(group) if late else frozenset(),
        f"late: {', '.join(late)}" if late else group.ended,
    )


def _resting(group: MovingGroup) -> frozenset[str]:
    """Return the resting objects without which somebody might not be late: those that were met, and
    those that best ways go around, past the former or not.
    """
    rests = {o.object: Placed(o.object, o.path.body, o.path.ends[0]) for o in group.world}
    met = {name: rests[name] for name in sorted(rests.keys() & group.passed)}
    asked = itertools.product(group.motions.values(), ({}, met))
    return frozenset(met).union(*itertools.starmap(partial(_gone_around, group), asked))


def _gone_around(
    group: MovingGroup, motion: TimedMotion, past: Mapping[str, Placed]
) -> frozenset[str]:
    """Return those ``past`` whom a way of a motion leads, and who rests all the time and has the
    best one go elsewhere: where that meets nobody any more, others that rest make no difference.
    """
    parked = {p.name: p for p in parked_all_the_time(motion, group.world)}
    around, forbidden = dict(past), group.workspace.forbidden
    while True:
        asked = motion.body, motion.poses, tuple(around.values())
        path = group.workspace.path(*asked, group.deadline)
        if not isinstance(path, Path):
            # nobody drives past these, or there was no time to find out
            return frozenset(parked if group.deadline.expired() else around)
        me = path, motion.object, motion.avoid
        met = {o.object for o in group.world if len(forbidden(*me, [o]))}
        left = met & (parked.keys() - around.keys())
        if not left:
            return frozenset(around)
        around |= {name: parked[name] for name in sorted(left)}
