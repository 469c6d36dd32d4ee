"""Write the records of a fleet problem as an ordinary UP problem, in the form that is solved best.

- Each robot has a fluent for its place. Moves need it at their start and set it at their end; what
  is done at places needs it over ``(start, end]``, so that it may begin as a move ends.
- What one robot does takes the robot, a resource of one unit: linear in size, where pairs are not.
- Records say nothing in short here (:mod:`up_samp.fleet.spelled_out`).
- What can be done by several robots is one optional activity each, exactly one of them present.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import GlobalEndTiming
from unified_planning.shortcuts import MinimizeMakespan, Minus, Or

from up_samp.fleet.drives import Drives
from up_samp.fleet.jobs import JobRules, add_buffers, add_loads, add_setups
from up_samp.fleet.meanings import Kind, Written, one_at_a_time
from up_samp.fleet.records import FleetRecords
from up_samp.fleet.site import Site
from up_samp.fleet.spelled_out import spelled_out
from up_samp.fleet.work import Work
from up_samp.model.graphs import grouped
from up_samp.model.objective import Cost, MinimizeCosts
from up_samp.upio.expressions import effects_of, present


def write_problem(records: FleetRecords, folder: Path) -> Written:
    """Return the UP problem of ``records`` and what its activities stand for; their map is relative
    to ``folder``.

    :raises FleetError: where more robots start in a zone than it takes.
    :raises UnsupportedError: where something cannot be said to the engines.
    """
    records = spelled_out(records)
    site = Site(records, folder)
    work = Work(site)
    drives = Drives(site, work)
    for robot in records.robots:
        drives.add(robot)
        add_loads(site, work, robot)
    add_setups(site, work)
    add_buffers(site, work)
    JobRules(site, work).add()
    work.limit_shifts()
    for robot, activities in work.busy.items():
        one_at_a_time(site.problem, robot, activities)
    if records.weighed:
        add_objective(site, work)
    elif records.objective == "makespan":
        site.problem.add_quality_metric(MinimizeMakespan())
    return Written(site.problem, site.meanings)


# ------------------ What a plan costs, where the objective weighs several terms
# A new term is a row of TERMS. Terms count in seconds (but for what is counted in robots or
# energy), whatever the schedule's unit.


Amount = tuple[float | Fraction, Any, Activity | None]
"""(seconds or pieces that 1 stands for, expression in units, whose presence it needs)."""


def add_objective(site: Site, work: Work) -> None:
    """State the weighted sums of terms that are to be minimised one after the other, in a site's
    problem whose activities are all there. What is left out costs in the first.
    """
    manager, costs = site.problem.environment.expression_manager, list[Cost]()
    for (rank, weights), term in itertools.product(enumerate(site.records.weighed), TERMS):
        told = (vars(weights) | {"left_out": float(not rank)})[term]
        for each, node, activity in TERMS[term](site, work) if told else ():
            if not each:
                continue
            (node,) = manager.auto_promote(node)
            weight = Fraction(str(told)) * Fraction(str(each))
            name = None if activity is None or not activity.optional else activity.name
            share = site.meanings[activity.name].robot if term == "busiest" and activity else ""
            costs.append(Cost(term, weight, node, name, term == "tardiness", share, rank))
    site.problem.add_quality_metric(MinimizeCosts(costs, site.problem.environment))


def tell_lateness(records: FleetRecords, written: Written, plan: Mapping[str, Any]) -> list[str]:
    """Return in words which jobs of a plan end after they are due, whether that costs or not."""
    due = {job.id: job.due for job in spelled_out(records).jobs if job.due is not None}
    lines: dict[str, None] = {}  # of a crew's task once
    for meaning, activity in written.happening(plan["activities"]):
        end = float(activity["end"]) * float(plan["seconds_per_unit"])
        late = end - due.get(meaning.what, end)
        if meaning.kind in (Kind.DELIVERY, Kind.TASK) and late > 0:
            lines[f"{meaning.what} ends {late:g} s after it is due"] = None
    return [*lines]


# ------------------ One function for each term


def _makespan(site: Site, work: Work) -> Iterator[Amount]:
    manager = site.problem.environment.expression_manager
    yield site.records.seconds_per_unit, manager.TimingExp(GlobalEndTiming()), None


def _tardiness(site: Site, work: Work) -> Iterator[Amount]:
    """How much later than due jobs end, each by its own weight."""
    unit = site.records.seconds_per_unit
    for job in site.records.jobs:
        if job.due is not None:
            for a in work.ends(job.id):
                yield unit * job.weight, Minus(a.end, site.down(job.due)), a


def _completion(site: Site, work: Work) -> Iterator[Amount]:
    """When jobs end, each by its own weight."""
    for job in site.records.jobs:
        for a in work.ends(job.id):
            yield site.records.seconds_per_unit * job.weight, a.end, a


def _driving(site: Site, work: Work) -> Iterator[Amount]:
    """How long robots drive, all together."""
    for a in _drives(site):
        yield site.records.seconds_per_unit, Minus(a.end, a.start), a


def _distance(site: Site, work: Work) -> Iterator[Amount]:
    """How far robots drive, all together, by the ways that they take with nobody in them (cm)."""
    for a in _drives(site):
        yield 0.01, round(100 * site.metres[a.name]), a


def _energy(site: Site, work: Work) -> Iterator[Amount]:
    """What drives take from batteries, in the user's units."""
    for a in _drives(site):
        robot = site.meanings[a.name].robot
        battery = site.records.kind_of(robot).battery
        for _, effect in effects_of(a):
            if battery is not None and effect.fluent == site.batteries[robot]:
                yield battery.capacity / battery.grains, effect.value, a


def _robots(site: Site, work: Work) -> Iterator[Amount]:
    """How many robots leave where they start."""
    for drives in _by_robot(site).values():
        yield 1.0, Or(present(*drives)), None


def _cost(site: Site, work: Work) -> Iterator[Amount]:
    """What robots cost that leave where they start, and what their drives cost."""
    hours = Fraction(str(site.records.seconds_per_unit)) / 3600
    for robot, drives in _by_robot(site).items():
        used, far, long = (
            Fraction(str(site.records.kind_of(robot).costs.get(what, 0)))
            for what in ("used", "per_km", "per_hour")
        )
        yield used, Or(present(*drives)), None
        for a in drives:
            yield far / 100_000, round(100 * site.metres[a.name]), a
            yield long * hours, Minus(a.end, a.start), a


def _busiest(site: Site, work: Work) -> Iterator[Amount]:
    """How long each robot drives and works: breaks are none of it."""
    for a in (a for activities in work.busy.values() for a in activities):
        if site.meanings[a.name].kind is not Kind.BREAK:
            yield site.records.seconds_per_unit, Minus(a.end, a.start), a


def _left_out(site: Site, work: Work) -> Iterator[Amount]:
    """The penalties of optional jobs that are not done."""
    penalties = {job.id: job.penalty for job in site.records.jobs}
    for a in site.problem.activities:
        meaning = site.meanings[a.name]
        penalty = penalties.get(meaning.what)
        if meaning.kind is Kind.LEAVE and penalty is not None:
            yield penalty, 1, a


TERMS: Mapping[str, Callable[[Site, Work], Iterable[Amount]]] = {
    "makespan": _makespan,
    "tardiness": _tardiness,
    "completion": _completion,
    "driving": _driving,
    "distance": _distance,
    "energy": _energy,
    "robots": _robots,
    "cost": _cost,
    "busiest": _busiest,
    "left_out": _left_out,
}
"""By the names that a problem file gives them; what is left out counts by its penalties."""


def _by_robot(site: Site) -> dict[str, list[Activity]]:
    return grouped(_drives(site), lambda a: site.meanings[a.name].robot)


def _drives(site: Site) -> Iterator[Activity]:
    for a in site.problem.activities:
        if site.meanings[a.name].kind in (Kind.MOVE, Kind.CARRY):
            yield a
