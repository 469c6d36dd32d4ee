"""Job shops on a floor: JSPLIB's standard form, and flexible ones (``.fjs``), with transport.

Machines stand along two walls of a hall; each job's part is carried from the store to its machines,
in order, and to the exit. A machine works by itself, on one part at a time. Where an operation may
be done on several machines, the planner chooses: the machines are modes of its task.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.files import text_of
from up_samp.fleet.importers.common import Imported, Options, finish, number_of, wrong
from up_samp.geometry.maps import write_map
from up_samp.model import ProblemError

Ways = list[tuple[int, int]]
"""(machine, duration) of each machine that an operation may be done on."""
Route = list[Ways]
APART, DEEP, CELL = 4.0, 12.0, 0.1
"""Distance between machines along a wall, depth of the hall, edge of a cell: m."""


def _numbers(source: Path) -> list[tuple[int, list[int]]]:
    """Return each line's number and its integers (of the first: two), without comments (#) and
    empty lines.
    """
    rows: list[tuple[int, list[int]]] = []
    for number, line in enumerate(text_of(source).splitlines(), 1):
        text = line.split("#")[0].strip()
        if text:
            try:
                words = text.split() if rows else text.split()[:2]  # then how flexible it is
                rows.append((number, [*map(_whole, words)]))
            except ValueError as error:
                raise wrong(source, number, f"numbers are needed: {error}") from error
    if not rows or len(rows[0][1]) < 2:
        raise wrong(source, 1, "it begins with the numbers of jobs and machines")
    return rows


def _whole(text: str) -> int:
    """Return an integer; fractions are none."""
    number = number_of(text)
    if number != int(number):
        raise ValueError(f"'{text}' is no whole number")
    return int(number)


def import_jsplib(source: Path, folder: Path, options: Options) -> Imported:
    """Import a job shop: a line with its size, then a line of (machine, duration) pairs a job."""
    rows = _numbers(source)
    jobs, machines = rows[0][1][:2]
    routes: list[Route] = []
    for number, row in rows[1:]:
        if len(row) != 2 * machines:
            raise wrong(source, number, f"{2 * machines} numbers are needed, there are {len(row)}")
        routes.append([[way] for way in zip(row[::2], row[1::2], strict=True)])
    _check(source, routes, jobs, machines)
    return _shop(source, folder, options, routes, machines, [])


def import_fjs(source: Path, folder: Path, options: Options) -> Imported:
    """Import a flexible job shop: an operation is done on one of several machines."""
    rows = _numbers(source)
    jobs, machines = rows[0][1][:2]
    routes: list[Route] = []
    for number, row in rows[1:]:
        values = iter(row)
        route: Route = []
        try:
            for _ in range(next(values)):
                ways = [(next(values) - 1, next(values)) for _ in range(next(values))]
                route.append(sorted(dict(sorted(ways, reverse=True)).items()))
        except (StopIteration, ValueError) as error:
            raise wrong(source, number, "the line ends too early") from error
        if left := [*values]:
            raise wrong(source, number, f"numbers are left over: {left[0]} is the first")
        routes.append(route)
    _check(source, routes, jobs, machines)
    flexible = sum(len(ways) > 1 for route in routes[: options.jobs] for ways in route)
    note = f"{flexible} operations may be done on one of several machines: modes of their tasks"
    return _shop(source, folder, options, routes, machines, [note])


def _check(source: Path, routes: list[Route], jobs: int, machines: int) -> None:
    if len(routes) != jobs:
        raise wrong(source, None, f"{jobs} jobs are announced, there are {len(routes)}")
    odd = [m for route in routes for ways in route for m, _ in ways if not 0 <= m < machines]
    if any(not ways for route in routes for ways in route):
        raise wrong(source, None, "an operation has no machine")
    if odd:
        raise wrong(source, None, f"there is no machine {odd[0]}; there are {machines}")


def _shop(
    source: Path, folder: Path, options: Options, routes: list[Route], machines: int,
    notes: list[str],
) -> Imported:  # fmt: skip
    """Write the hall and one order a step, one task an operation."""
    width = _hall(folder, machines)
    places: dict[str, Any] = {
        "store": [2.0, DEEP / 2, 0.0],
        "exit": [width - 2.0, DEEP / 2, 0.0],
    }
    for m in range(machines):
        x = 5.0 + APART * (m // 2)
        lower = m % 2 == 0
        places[f"at_m{m}"] = [x, 2.0, -math.pi / 2] if lower else [x, DEEP - 2.0, math.pi / 2]
    for i in range(options.robots):
        places[f"home{i}"] = [5.0 + APART * i, DEEP / 2, 0.0]
    orders: list[dict[str, Any]] = []
    tasks: list[dict[str, Any]] = []
    for j, route in enumerate(routes[: options.jobs]):
        here: Any = "store"
        before = None
        for k, ways in enumerate([*route, []]):
            name, carry = f"j{j}_op{k}", f"j{j}_carry{k}"
            there = _place(name, ways)
            order: dict[str, Any] = {"id": carry, "pickup": here, "delivery": there}
            if before is not None:
                order["after"] = [before]
            orders.append(order)
            if ways:
                tasks.append({"id": name, "after": [carry], **_work(ways)})
            here, before = there, name
    kind = {"footprint": [1.2, 0.8], "turning_radius": 0.8, "v_max": 2.0, "a_max": 1.0}
    data = {
        "name": "shop",
        "map": "hall.yaml",
        "robot_types": {"agv": kind},
        "robots": {f"r{i}": {"type": "agv", "start": f"home{i}"} for i in range(options.robots)},
        "places": places,
        "resources": {f"m{m}": {} for m in range(machines)},
        "orders": orders,
        "tasks": tasks,
    }
    taken = min(len(routes), options.jobs)
    notes = [f"{taken} of {len(routes)} jobs of {source.name}; the hall is made up", *notes]
    return finish(folder, data, notes)


def _place(task: str, ways: Ways) -> Any:
    """Return where a part is brought for an operation; the exit where none is left."""
    if not ways:
        return "exit"
    return f"at_m{ways[0][0]}" if len(ways) == 1 else {"task": task}


def _work(ways: Ways) -> dict[str, Any]:
    """Return what a task is on its machine, or on each of several."""
    if len(ways) == 1:
        return {"duration": ways[0][1], "resources": [f"m{ways[0][0]}"]}
    modes = {
        f"m{m}": {"duration": duration, "resources": [f"m{m}"], "input": [f"at_m{m}"]}
        for m, duration in ways
    }
    return {"modes": modes}


def _hall(folder: Path, machines: int) -> float:
    """Write the hall's map; return its width, m."""
    width = 10.0 + APART * max(2, math.ceil(machines / 2))
    if width * DEEP > FILE_LIMITS.cells * CELL**2:
        raise ProblemError(f"{machines} machines are too many for one hall")
    occupied = np.zeros((round(DEEP / CELL), round(width / CELL)), dtype=np.bool_)
    occupied[:2], occupied[-2:], occupied[:, :2], occupied[:, -2:] = True, True, True, True
    write_map(folder, "hall", occupied, CELL)
    return width
