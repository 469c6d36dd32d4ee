"""Grids: Moving AI's ``.map`` and ``.scen``, and the League of Robot Runners' files.

Formats: https://movingai.com/benchmarks/formats.html and the League's ``Input_Output_Format.md``.
A cell becomes a square of ``Options.cell`` m; robots are a little smaller and drive in any
direction, freely, not from cell to cell.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.files import text_of
from up_samp.fleet.importers.common import Imported, Options, finish, json_of, wrong
from up_samp.geometry.maps import write_map
from up_samp.model import UnsupportedError
from up_samp.model.errors import short

Cells = npt.NDArray[np.bool_]
FREE, BLOCKED = ".GSE", "@OTW"
"""The League marks ends of tasks on free floor: S and E."""


def read_movingai_map(source: Path) -> Cells:
    """Return which cells of a ``.map`` are blocked, shape (rows, cols), the first row on top."""
    lines = text_of(source).splitlines()
    head = {key: value for key, _, value in (line.partition(" ") for line in lines[:3])}
    start = next((i for i, line in enumerate(lines) if line.strip() == "map"), None)
    if start is None or not {"height", "width"} <= head.keys():
        raise wrong(source, 1, "no Moving AI map: it begins with type, height, width and map")
    height, width = int(head["height"]), int(head["width"])
    rows = [line.rstrip("\r") for line in lines[start + 1 : start + 1 + height]]
    for i, row in enumerate(rows):
        odd = sorted(set(row) - set(FREE + BLOCKED))
        if len(row) != width or odd:
            text = (
                f"it has {len(row)} cells, not {width}" if not odd else f"unknown cell {odd[0]!r}"
            )
            raise wrong(source, start + 2 + i, text)
    if len(rows) != height:
        raise wrong(source, None, f"{len(rows)} rows, not {height}")
    return np.array([[cell in BLOCKED for cell in row] for row in rows], dtype=np.bool_)


def import_movingai(source: Path, folder: Path, options: Options) -> Imported:
    """Import a ``.map`` (a map alone), or a ``.scen``: its first agents drive to their goals."""
    if source.suffix == ".map":
        return finish(folder, _grid(source, folder, options), _notes(options))
    lines = text_of(source).splitlines()
    entries = [(n, line.split()) for n, line in enumerate(lines, 1) if n > 1 and line.strip()]
    if not lines or not lines[0].startswith("version") or not entries:
        raise wrong(source, 1, "no Moving AI scenario: it begins with 'version 1'")
    first = entries[0][1][1:2]
    for number, entry in entries:
        if len(entry) != 9:
            text = "a line has a bucket, a map, its size, start, goal and length"
            raise wrong(source, number, text)
        if entry[1:2] != first:
            raise wrong(source, number, f"it is on {short(entry[1])}, others on {short(first[0])}")
    map_file = _beside(source, first[0])
    data = _grid(map_file, folder, options)
    height = read_movingai_map(map_file).shape[0]
    for i, (_, entry) in enumerate(entries[: options.robots]):
        x, y, goal_x, goal_y = (int(v) for v in entry[4:8])
        data["places"][f"start{i}"] = _pose(y, x, height, options.cell)
        data["places"][f"goal{i}"] = _pose(goal_y, goal_x, height, options.cell)
        data["robots"][f"r{i}"] = {"type": "agent", "start": f"start{i}", "end": f"goal{i}"}
    return finish(folder, data, _notes(options))


def import_league(source: Path, folder: Path, options: Options) -> Imported:
    """Import a problem of the League of Robot Runners (its JSON file): the first agents and tasks.

    A task of two locations is an order from one to the other, one of a single location a task.
    """
    problem = json_of(source)
    names = {key: problem[key] for key in ("mapFile", "agentFile", "taskFile")}
    files = {key: _beside(source, name) for key, name in names.items()}
    data = _grid(files["mapFile"], folder, options)
    shape = read_movingai_map(files["mapFile"]).shape
    places: dict[int, str] = {}

    def place(cell: int) -> str:
        if cell not in places:
            if not 0 <= cell < shape[0] * shape[1]:
                raise wrong(source, None, f"location {cell} is outside the map")
            places[cell] = f"cell{cell}"
            row, col = divmod(cell, shape[1])
            data["places"][places[cell]] = _pose(row, col, shape[0], options.cell)
        return places[cell]

    for i, row in enumerate(_rows(files["agentFile"])[: options.robots]):
        data["robots"][f"r{i}"] = {"type": "agent", "start": place(row[0])}
    data |= {"orders": [], "tasks": []}
    for i, row in enumerate(_rows(files["taskFile"])[: options.jobs]):
        match row:
            case [cell]:
                data["tasks"].append({"id": f"t{i}", "at": place(cell), "duration": 1})
            case [cell, goal]:
                order = {"id": f"t{i}", "pickup": place(cell), "delivery": place(goal)}
                data["orders"].append(order)
            case _:
                raise UnsupportedError(f"{source}: task {i} has {len(row)} locations; at most two")
    return finish(folder, data, _notes(options))


def _rows(source: Path) -> list[list[int]]:
    """Return the numbers of each line after the count; lines with # are comments."""
    lines = [x for x in text_of(source).splitlines() if x.strip() and not x.startswith("#")]
    try:
        return [[int(v) for v in line.split(",")] for line in lines[1:]]
    except ValueError as error:
        raise wrong(source, None, str(error)) from error


def _beside(source: Path, name: object) -> Path:
    """Return a file that another one names; flat folders are taken, too."""
    if isinstance(name, str) and "\0" not in name and len(name) < 256:
        for path in (source.parent / name, source.parent / Path(name).name):
            if path.is_file():
                return path
    raise wrong(source, None, f"it names {short(name)}, and no such file is beside it")


def _grid(source: Path, folder: Path, options: Options) -> dict[str, Any]:
    """Write the map and return the data of a problem file without robots and jobs."""
    blocked = read_movingai_map(source)
    cells = max(1, round(options.cell / 0.25))
    if blocked.size * cells**2 > FILE_LIMITS.cells:
        raise wrong(source, None, f"{blocked.size} cells of {options.cell:g} m are too many")
    fine = np.kron(blocked[::-1], np.ones((cells, cells), dtype=np.bool_))
    write_map(folder, "map", fine, options.cell / cells)
    size = round(0.8 * options.cell, 6)
    agent = {"footprint": [size, size], "model": "omni", "v_max": 1.0, "a_max": 1.0}
    return {"map": "map.yaml", "robot_types": {"agent": agent}, "robots": {}, "places": {}}


def _pose(row: int, col: int, height: int, cell: float) -> list[float]:
    """Return the middle of a cell; the first row is on top, y points up."""
    return [round((col + 0.5) * cell, 6), round((height - 1 - row + 0.5) * cell, 6), 0.0]


def _notes(options: Options) -> list[str]:
    return [
        f"a cell is {options.cell:g} m; robots are squares of {0.8 * options.cell:g} m",
        f"at most {options.robots} robots and {options.jobs} tasks were taken",
    ]
