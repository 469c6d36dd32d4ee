"""Machines that are set up for kinds of jobs and work in batches, and buffers of limited room.

All of it is said with what engines know already: orders of two with a gap between them, starts at
one instant, and levels.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from unified_planning.model import Fluent, FNode
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import LE, Equals, IntType, Or, Plus

from up_samp.fleet.faults import Fault, FleetError, missing
from up_samp.fleet.loads import place_of
from up_samp.fleet.records import Order, Resource
from up_samp.fleet.site import Site
from up_samp.fleet.statements import Kind, present
from up_samp.fleet.work import Work


def add_setups(site: Site, work: Work) -> None:
    """State what resources ask for between those that use them.

    :raises FleetError: where one is of no kind, or those of a batch last unequally long.
    """
    for name, resource in site.records.resources.items():
        if resource != Resource(resource.capacity):
            _check_users(site, name, work.users.get(name, ()))
            _set_up(site, resource, work.users.get(name, ()))


def _kind(site: Site, a: Activity) -> str:
    """Return the kind of the job that an activity belongs to."""
    return site.records.job_of[site.meanings[a.name].what].kind


def _check_users(site: Site, name: str, users: Sequence[Activity]) -> None:
    resource = site.records.resources[name]
    lengths: dict[str, int] = {}
    for a in users:
        kind, job = _kind(site, a), site.meanings[a.name].what
        if resource.setup and kind not in resource.kinds:
            text = f"'{job}' uses it: {missing('kind', kind, resource.kinds)}"
            raise FleetError([Fault(("resources", name), text)])
        lasts = int(a.duration.lower.constant_value())
        if resource.batches and lengths.setdefault(kind, lasts) != lasts:
            text = f"'{job}' lasts longer or shorter than others of its kind, and a batch begins "
            raise FleetError([Fault(("resources", name), text + "and ends together")])


def _set_up(site: Site, resource: Resource, users: Sequence[Activity]) -> None:
    """No set-up is longer than by way of a third kind: who keeps the gaps between neighbours keeps
    those between all.
    """
    for a in users:
        first = resource.setup_between(resource.kind, _kind(site, a))
        if first:
            a.add_release_date(site.up(first))
    for a, b in itertools.combinations(users, 2):
        one, other = site.meanings[a.name], site.meanings[b.name]
        if (one.what, one.kind) == (other.what, other.kind):
            continue  # one of them happens
        kind, then = _kind(site, a), _kind(site, b)
        gap = _units(site, resource.setup_between(kind, then))
        back = _units(site, resource.setup_between(then, kind))
        ways = [LE(Plus(a.end, gap), b.start), LE(Plus(b.end, back), a.start)]
        if resource.batches and kind == then:
            ways.append(Equals(a.start, b.start))
        site.problem.add_constraint(Or(ways), present(a, b))


def _units(site: Site, seconds: float) -> int:
    """Return seconds as whole units, rounded up; none of nothing."""
    return site.up(seconds) if seconds else 0


def add_buffers(site: Site, work: Work) -> None:
    """State how many loads fit into places: a delivery takes room as it begins, a pickup gives some
    back as it ends; so do tasks of machines with what is brought to them and fetched.

    :raises FleetError: where it is not known beforehand what goes there.
    """
    records, rooms = site.records, dict[str, FNode]()
    for name, place in records.places.items():
        if place.room is not None:
            level = Fluent(f"{name}_room", IntType(0, place.room))
            site.problem.add_fluent(level, default_initial_value=place.room - place.holds)
            rooms[name] = level()
    for visit, a in work.activities.items():
        for room in _levels(rooms, visit.what, visit.places):
            if visit.kind is Kind.DELIVERY:
                a.add_decrease_effect(a.start, room, 1)
            elif visit.kind is Kind.PICKUP:
                a.add_increase_effect(a.end, room, 1)
    for task, modes in work.machines.items():
        brought = records.bringers.get(task, ())
        fetched = [order for order in records.orders if order.pickup.task == task]
        for mode, told in records.task_of[task].modes.items():
            for room in _levels(rooms, task, told.input)[: len(brought)]:
                modes[mode].add_increase_effect(modes[mode].start, room, _count(brought))
            for room in _levels(rooms, task, told.output or told.input)[: len(fetched)]:
                modes[mode].add_decrease_effect(modes[mode].end, room, _count(fetched))


def _levels(rooms: Mapping[str, FNode], what: str, places: Sequence[str]) -> list[FNode]:
    """Return the level of the place at which something is, if that has one."""
    found = [rooms[place] for place in map(place_of, places) if place in rooms]
    if len(places) > len(found) > 0:
        text = f"'{what}' is at one of {', '.join(places)}: a place with room for so many is "
        raise FleetError([Fault(("places",), text + "named alone")])
    return found[:1]


def _count(orders: Sequence[Order]) -> int:
    """Return how many loads are brought to a machine, or fetched."""
    if any(order.optional for order in orders):
        text = f"'{orders[0].id}' goes to a machine at a place with room for so many: no order "
        raise FleetError([Fault(("places",), text + "of that machine cannot be optional")])
    return len(orders)
