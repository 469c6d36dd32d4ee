"""What records say in short, spelled out: jobs that recur, robots that start at poses of their own,
loads that several robots carry.

Behind this there are places and jobs only, and nothing else has to know of the short forms.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from up_samp.fleet.fields import FILE_LIMITS, Windows
from up_samp.fleet.loads import FURTHER, loads_of, seat_of
from up_samp.fleet.records import FleetJob, FleetRecords, Order, Place, Stop, Task
from up_samp.model.frames import Frame


def spelled_out(records: FleetRecords) -> FleetRecords:
    """Return the records with nothing said in short: what problems, checks and pictures are of."""
    return with_carriers(without_repeats(with_places(records)))


def in_numbers(records: FleetRecords) -> str:
    """Return in words how many robots, orders and tasks there are; what recurs counts each time."""
    found = without_repeats(records)
    counts = {"robot": found.robots, "order": found.orders, "task": found.tasks}
    return ", ".join(counted(len(some), kind) for kind, some in counts.items())


def counted(number: int, what: str) -> str:
    """Return ``1 order``, or ``2 orders``."""
    return f"{number} {what}{'s' * (number != 1)}"


def with_places(records: FleetRecords) -> FleetRecords:
    """Return the records in which each robot starts at a place: a pose that was given instead is
    the place ``ROBOT.start``, on the ground. Where lifts stop there are places, too.
    """
    robots, places = dict(records.robots), dict(records.places)
    for name, lift in records.lifts.items():
        for floor, cabin in lift.stops.items():
            places |= {stop_of(name, floor, n): Place(pose, floor) for n, pose in enumerate(cabin)}
    for name, robot in records.robots.items():
        pose: Any = robot.start
        if not isinstance(pose, str):
            start = f"{name}.start"
            while start in places:
                start += "_"
            places[start] = Place(pose)
            robots[name] = dataclasses.replace(robot, start=start)
    return dataclasses.replace(records, robots=robots, places=places)


def stop_of(lift: str, floor: str, spot: int = 0) -> str:
    """Return the place at which robots take a lift on a floor: one for each ``spot`` in it."""
    return f"{lift}.{floor}" + (f".{spot + 1}" if spot else "")


def with_carriers(records: FleetRecords) -> FleetRecords:
    """Return the records in which each further carrier of a load does an order of its own,
    ``ORDER+2``, together with the first one, from and to places of its own.
    """
    places, orders = dict(records.places), list[Order]()
    carriers = {order.id: load.carriers for order, load in loads_of(records)}
    for order in records.orders:
        orders.append(order)
        for number, pose in enumerate(carriers.get(order.id, ()), 2):
            ends = []
            for stop in (order.pickup, order.delivery):
                seats = {seat_of(at, order.id, number): places[at] for at in stop.at}
                for seat, place in seats.items():
                    places[seat] = Place(Frame(*place.pose).of(pose), place.floor)
                ends.append(dataclasses.replace(stop, at=tuple(seats), resources=()))
            pickup, delivery = ends
            other = dataclasses.replace(
                order, id=f"{order.id}{FURTHER}{number}", pickup=pickup, delivery=delivery,
                attached=None, together=(order.id,), after=(), due=None,
            )  # fmt: skip
            orders.append(other)
    return dataclasses.replace(records, places=places, orders=tuple(orders))


def without_repeats(records: FleetRecords) -> FleetRecords:
    """Return the records in which each job is done once: those that recur are as many jobs."""
    times = {j.id: how_often(j) for j in records.jobs if j.repeat is not None}
    if not times:
        return records
    orders = tuple(copy for order in records.orders for copy in _copies(order, times))
    tasks = tuple(copy for task in records.tasks for copy in _copies(task, times))
    return dataclasses.replace(records, orders=orders, tasks=tasks)


def numbered(job: str, number: int) -> str:
    """Return the id of the job that a recurring one is the ``number``-th time, from 1 on."""
    return job if number == 1 else f"{job}_{number}"


def how_often(job: FleetJob) -> int:
    """Return how many jobs a job stands for; of too many one more than there may be."""
    again = job.repeat
    if again is None:
        return 1
    if again.until is None:
        return again.times or 1
    later = (again.until - job.release) / again.every
    return 1 + int(min(max(0.0, later + FILE_LIMITS.least), FILE_LIMITS.repeats))


def ids_of(job: Order | Task) -> list[str]:
    """Return the ids of the jobs that a job stands for: its own, where it does not recur."""
    return [numbered(job.id, n) for n in range(1, 1 + how_often(job))]


def _copies(job: Order | Task, times: Mapping[str, int]) -> list[Any]:
    """Return the jobs that a job stands for, each after the same number of what recurs as often;
    ``times``: how often jobs recur, by id.
    """
    if job.repeat is None:
        return [job]
    most, every = how_often(job), job.repeat.every

    def named(name: str, number: int) -> str:
        return numbered(name, number) if times.get(name) == most else name

    return [_copy(job, number, every, named) for number in range(1, most + 1)]


def _copy(
    job: Order | Task, number: int, every: float, named: Callable[[str, int], str]
) -> Order | Task:
    later = every * (number - 1)
    changes: dict[str, Any] = {
        "id": numbered(job.id, number),
        "repeat": None,
        "release": job.release + later,
        "due": None if job.due is None else job.due + later,
        "after": tuple(named(name, number) for name in job.after),
    }
    if isinstance(job, Task):
        return dataclasses.replace(job, **changes, window=_later(job.window, later))
    for side in ("pickup", "delivery"):
        stop: Stop = getattr(job, side)
        task = None if stop.task is None else named(stop.task, number)
        window = _later(stop.window, later)
        changes[side] = dataclasses.replace(stop, task=task, window=window)
    changes["together"] = tuple(named(name, number) for name in job.together)
    if isinstance(job.attached, str):
        changes["attached"] = named(job.attached, number)
    return dataclasses.replace(job, **changes)


def _later(windows: Windows, seconds: float) -> Windows:
    return tuple((opens + seconds, closes + seconds) for opens, closes in windows)
