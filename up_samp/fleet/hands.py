"""What fits on a robot at a time: one order, or so many loads of each kind."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from unified_planning.model import Fluent, Timing
from unified_planning.shortcuts import FALSE, TRUE, BoolType, IntType

from up_samp.fleet.records import Order
from up_samp.fleet.site import Site
from up_samp.fleet.statements import at_start
from up_samp.fleet.visits import Role, fits
from up_samp.fleet.work import Work


def add_loads(site: Site, work: Work, robot: str) -> None:
    """State what fits on a robot at a time."""
    kind = site.kind_of(robot)
    mine = {v.what for v in work.visits[robot] if v.role is Role.PICKUP}
    orders = [o for o in site.records.orders if o.id in mine]
    if len(orders) > 1 and not any(
        fits(pair, kind.capacity) for pair in itertools.combinations(orders, 2)
    ):
        _one_order(site, work, robot, orders)
        return
    for load in sorted({k for o in orders for k in o.load}):
        if sum(o.load.get(load, 0) for o in orders) > kind.capacity.get(load, 0):
            _level(site, work, robot, load, orders)


def _one_order(site: Site, work: Work, robot: str, orders: Sequence[Order]) -> None:
    """One order at a time: the robot's hands are free or not. A delivery frees them a unit before
    its end, which is seen from its end on: the next pickup may begin then.
    """
    fluent = Fluent(f"{robot}_free", BoolType())
    site.problem.add_fluent(fluent, default_initial_value=TRUE())
    for order in orders:
        picks, delivers = work.sides(robot, order.id)
        for pick in picks:
            pick.add_condition(at_start(pick), fluent())
            pick.add_effect(pick.end, fluent(), FALSE())
        for deliver in delivers:
            deliver.add_effect(Timing(-1, deliver.end), fluent(), TRUE())


def _level(site: Site, work: Work, robot: str, load: str, orders: Sequence[Order]) -> None:
    """Room for loads of a kind: taken as a pickup begins, given back as a delivery ends."""
    capacity = site.kind_of(robot).capacity[load]
    fluent = Fluent(f"{robot}_room_{load}", IntType(0, capacity))
    site.problem.add_fluent(fluent, default_initial_value=capacity)
    for order in orders:
        amount = order.load.get(load, 0)
        picks, delivers = work.sides(robot, order.id)
        for pick in picks if amount else ():
            pick.add_decrease_effect(pick.start, fluent(), amount)
        for deliver in delivers if amount else ():
            deliver.add_increase_effect(deliver.end, fluent(), amount)
