"""Groups of bodies that drive in the plane, that fly, or both.

Drivers and flyers are planned one kind after the other: first the drivers while flyers rest at
their starts and ends, then the flyers among the drivers' motions; where that fails or is late, the
other way round. The result is checked pair by pair. Finding nothing proves nothing.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import replace

from up_samp.model import (
    Deadline,
    FixedMotion,
    GroupQuery,
    GroupReport,
    Outcome,
    Rest,
    TimedMotion,
    Trajectory,
    UnsupportedError,
)
from up_samp.motion.fleet.below import among_shadows
from up_samp.motion.fleet.coordination import coordinate_drivers
from up_samp.motion.fleet.flyer_contacts import Flight, first_contact
from up_samp.motion.fleet.flyers import coordinate_flights
from up_samp.motion.fleet.margins import wished
from up_samp.motion.fleet.workspace import PathPlanner


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

    ``method``: "ladder" (:mod:`up_samp.motion.fleet.coordination`), or "st-rrt*" as in the paper:
    one robot after the other by ST-RRT* among those before it, without other priorities.
    Deterministic for a ``seed`` as long as the ``deadline`` does not cut it short.
    """
    flyers = [m for m in query.motions if m.body.flies]
    if not flyers:
        return coordinate_drivers(service, among_shadows(query), deadline, seed=seed, method=method)
    if method != "ladder":
        raise UnsupportedError(f"the method '{method}' is for planar bodies; one here is SE3")
    if len(flyers) == len(query.motions):
        return coordinate_flights(service, query, deadline)
    return _both(service, query, deadline, seed)


def _both(service: PathPlanner, query: GroupQuery, deadline: Deadline, seed: int) -> GroupReport:
    """Plan one kind after the other, in the order that is less late."""
    began = time.monotonic()
    best: GroupReport | None = None
    for flyers_first in (False, True):
        report = _in_order(service, query, deadline, seed, flyers_first)
        if best is None or _badness(report, query) < _badness(best, query):
            best = report
        if deadline.expired() or (report.outcome is Outcome.FOUND and not report.late):
            break
    assert best is not None
    return replace(best, seconds=time.monotonic() - began)


def _badness(report: GroupReport, query: GroupQuery) -> tuple[bool, float]:
    due = {m.name: m.due for m in query.motions}
    late = sum(end - due[name] for name, end in report.late.items())
    return report.outcome is not Outcome.FOUND, late


def _in_order(
    service: PathPlanner,
    query: GroupQuery,
    deadline: Deadline,
    seed: int,
    flyers_first: bool,
) -> GroupReport:
    """Plan the one kind while the other rests at its starts and ends, then the other among it."""
    kinds = [[m for m in query.motions if m.body.flies is flies] for flies in (True, False)]
    if not flyers_first:
        kinds.reverse()
    first, second = kinds
    waiting = tuple(rest for motion in second for rest in _at_its_ends(motion))
    begun = coordinate(
        service,
        replace(query, motions=tuple(first), rests=(*query.rests, *waiting)),
        deadline,
        seed=seed,
    )
    if begun.outcome is not Outcome.FOUND:
        names = frozenset({*begun.conflict, *(m.name for m in second)})
        return replace(begun, conflict=names)
    decided = tuple(_decided(m, begun.trajectories[m.name]) for m in first)
    done = coordinate(
        service,
        replace(query, motions=tuple(second), fixed=(*query.fixed, *decided)),
        deadline,
        seed=seed,
    )
    whole = _joined(begun, done, frozenset(m.name for m in first))
    if whole.outcome is Outcome.FOUND and _touch(service, query, whole):
        return replace(
            whole,
            outcome=Outcome.NOT_FOUND,
            trajectories={},
            late={},
            conflict=frozenset(m.name for m in query.motions),
            reason="a flyer and a body that drives would meet",
        )
    return whole


def _at_its_ends(motion: TimedMotion) -> list[Rest]:
    """Return where a motion that is not planned yet rests: until it may leave, and once due."""
    first, last = motion.poses[0], motion.poses[-1]
    rests = []
    if motion.present_from < motion.release:
        rests.append(Rest(motion.object, motion.body, first, motion.present_from, motion.release))
    if motion.due < motion.present_until:
        rests.append(Rest(motion.object, motion.body, last, motion.due, motion.present_until))
    return rests


def _decided(motion: TimedMotion, trajectory: Trajectory) -> FixedMotion:
    return FixedMotion(
        motion.name,
        motion.object,
        motion.body,
        trajectory,
        motion.present_from,
        max(motion.present_until, trajectory.end),
    )


def _joined(begun: GroupReport, done: GroupReport, first: frozenset[str]) -> GroupReport:
    """Return the reports on both kinds as one."""
    complete = begun.complete and done.complete
    if done.outcome is not Outcome.FOUND:
        return replace(done, conflict=done.conflict | first, complete=complete)
    late = {**begun.late, **done.late}
    conflict = (begun.conflict | done.conflict | first) if late else frozenset()
    return GroupReport(
        Outcome.FOUND,
        {**begun.trajectories, **done.trajectories},
        late,
        conflict,
        begun.blockers | done.blockers,
        begun.reason or done.reason,
        complete=complete,
    )


def _touch(service: PathPlanner, query: GroupQuery, report: GroupReport) -> bool:
    """Return whether a flyer and a driver come too close, whichever of them heeds the other."""
    margin = wished(getattr(service, "scene", None))
    lives = [_life(m, report.trajectories[m.name]) for m in query.motions]
    pairs = itertools.combinations(lives, 2)
    return any(
        first_contact(a, b, margin) < float("inf") for a, b in pairs if a.body.flies != b.body.flies
    )


def _life(motion: TimedMotion, trajectory: Trajectory) -> Flight:
    return Flight(
        motion.name,
        motion.object,
        motion.body,
        trajectory,
        motion.present_from,
        max(motion.present_until, trajectory.end),
        (trajectory.start, trajectory.end),
        motion.avoid,
    )
