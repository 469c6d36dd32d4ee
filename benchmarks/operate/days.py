"""Floors to spend days on, and three ways to plan them in the same loop: the figure ``days`` of
``scripts/figures.py``.

``rolling`` is what ``up-samp operate`` does; ``token`` gives each order, in the order of coming, to
the free robot that could be there first, and plans nothing twice: who comes later goes first only
where nobody has to wait for that (token passing: Ma et al., "Lifelong multi-agent path finding for
online pickup and delivery tasks", AAMAS 2017). ``anew`` plans all that is not begun from nothing
whenever an order comes. All days are judged by what was driven.
"""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import numpy as np

from up_samp import Fleet
from up_samp.fleet.records import can_do
from up_samp.geometry.maps import write_map
from up_samp.operate.choice import OpenWork, choose, first_there, ready, theirs
from up_samp.operate.horizon import Opened
from up_samp.operate.loop import Operation
from up_samp.operate.records import DayOrder

LATER = 1e-3
"""What an order costs beside one that is planned, where it never goes first at that one's cost."""


def _place(job: DayOrder) -> tuple[float, float, float]:
    due = math.inf if job.record.due is None else job.record.due
    return -job.record.priority, due, job.came


class FirstComeFirstServed(Operation):
    """The order that waits and is next, by priority, then by when it is due, then by coming; those
    that no plan was found for a moment ago come last.
    """

    def next_order(self) -> DayOrder | None:
        """Return it (None: none waits, or something else has to be seen to first)."""
        if self.stranded() or self.stale():
            return None
        now = self.clock.now()
        waiting = [j for j in (*self.waiting(), *self.dropped()) if ready(self, j)]
        for until in self.turns():
            if left := [j for j in waiting if self.aside.get(j.id, now) <= until]:
                return min(left, key=_place)
        return None

    def mended(self) -> OpenWork | None:
        """Return what has to be planned though no order waits."""
        return choose(self) if self.stranded() or self.stale() else None


class Token(FirstComeFirstServed):
    """It is given to who could be there first."""

    def choice(self) -> OpenWork | None:
        job = self.next_order()
        if job is None:
            return self.mended()
        soon = {r: f for r, f in self.free_at().items() if f[0] <= self.settings.soon}
        free = {r: f for r, f in soon.items() if can_do(self.site, r, job.record)}
        if not free:
            return None
        light = dataclasses.replace(job.record, weight=LATER * job.record.weight)
        opened = {first_there(self, job, free): Opened.TAIL}
        return OpenWork(opened, (dataclasses.replace(job, record=light),))


class Anew(FirstComeFirstServed):
    """With it all is planned that is not begun, of everybody. Where no plan was found for that, it
    is asked for again when another order has come, or as late as anything is looked at again.
    """

    since, came = -math.inf, 0
    """When it was asked for last (s), and how many orders there were then."""

    def choice(self) -> OpenWork | None:
        now, in_vain = self.clock.now(), self.again > self.since
        if in_vain and len(self.jobs) == self.came and now < self.since + self.settings.every:
            return None
        self.since, self.came = now, len(self.jobs)
        job = self.next_order()
        if job is None:
            return self.mended()
        everybody = dict.fromkeys(self.there(), Opened.ALL)
        return OpenWork(everybody, (job, *theirs(self, everybody)))


NAV2 = Path(os.environ.get("NAV2_MAPS", "/opt/ros/jazzy/share/nav2_bringup/maps"))
"""Where the maps of the ROS 2 package ``nav2_bringup`` lie."""

WAYS = {"rolling": Operation, "token": Token, "anew": Anew}


AGV = {
    "footprint": (0.8, 0.6), "model": "diff", "v_max": 1.5, "a_max": 0.7, "omega_max": 1.5,
    "reverse_cost": 1,
}  # fmt: skip


def warehouse(folder: Path, robots: int) -> Fleet:
    """A floor with rows of racks, docks on the left, and a home for each robot on the right."""
    cell, height = 0.1, max(18.0, 3.0 + 1.6 * robots)
    cells = np.zeros((round(height / cell), round(36 / cell)), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    rows = [4.0 + 4.0 * k for k in range(int((height - 6.0) / 4.0))]
    for y in rows:
        for x in (9.0, 19.0):
            cells[
                round(y / cell) : round((y + 1.0) / cell), round(x / cell) : round((x + 7) / cell)
            ] = True
    fleet = Fleet(write_map(folder, "warehouse", cells, cell), name="warehouse", margin=0.12)
    fleet.add_robot_type("agv", **AGV)
    for k in range(robots):
        fleet.add_place(f"home{k}", 34.0, 1.5 + 1.6 * k, np.pi)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}")
    docks = [f"dock{k}" for k in range(len(rows) + 1)]
    for k, name in enumerate(docks):
        fleet.add_place(name, 2.5, 2.5 + 4.0 * k, np.pi)
    for k, y in enumerate(rows):
        for i, x in enumerate((10.5, 13.5, 20.5, 23.5)):
            fleet.add_place(f"rack{k}_{i}", x, y - 0.8)
            delivery = {"at": docks[(k + i) % len(docks)], "service": 5}
            fleet.add_order(f"o{k}_{i}", {"at": f"rack{k}_{i}", "service": 5}, delivery)
    return fleet


def nav2_warehouse(folder: Path, robots: int) -> Fleet:
    """Nav2's warehouse, 30 m x 50 m (:data:`NAV2`): shelves in three aisles and on two sides of a
    hall, three conveyors, and a home for each robot, up to twelve, along the wall on the left.
    """
    fleet = Fleet(NAV2 / "warehouse.yaml", name="nav2_warehouse", margin=0.12)
    fleet.add_robot_type("agv", **AGV)
    for k in range(robots):
        fleet.add_place(f"home{k}", -13.5, 3.0 - 1.8 * k)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}")
    docks = {"packing": (6.8, 4.0), "truck1": (10.2, -14.9), "truck2": (10.2, -20.9)}
    for name, (x, y) in docks.items():
        fleet.add_place(name, x, y)
    shelves = [(x, y, 0.0) for x in (-4.0, 0.0, 4.1) for y in (-7.0, -10.5, -14.0, -17.5)]
    shelves += [(x, 7.1, np.pi / 2) for x in (-3.0, 1.0, 5.0)] + [(-3.0, 16.1, np.pi / 2)]
    for k, shelf in enumerate(shelves):
        fleet.add_place(f"shelf{k}", *shelf)
        delivery = {"at": [*docks][k % len(docks)], "service": 5}
        fleet.add_order(f"o{k}", {"at": f"shelf{k}", "service": 5}, delivery)
    return fleet
