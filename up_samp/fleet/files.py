"""Problem files (``problem.yaml``, ``problem.json``), orders in tables beside them, and a
problem to begin with.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from importlib import resources
from pathlib import Path as File
from typing import Any

import numpy as np
import yaml
from pydantic import TypeAdapter, ValidationError

from up_samp.fleet import records
from up_samp.fleet.faults import Fault, FleetError, Path, find_faults, show_path, told
from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.records import FleetRecords
from up_samp.geometry import load_map
from up_samp.geometry.maps import write_map
from up_samp.io.plan_dict import FORMAT
from up_samp.model import ProblemError

_UNIONS = ("tuple[", "constrained", "function-", "Stop", "Place", "Attached", "str")
"""How pydantic names the members of a union in an error's place: of no use to readers."""


NOT_YET = {
    "charge": "chargers are part of a place: charger: {per_second: 1.0}",
    "chargers": "chargers are part of a place: charger: {per_second: 1.0}",
    "speed": "give v_max, in m/s",
    "radius": "give the footprint as corners, or turning_radius",
}
"""Keys that one may expect, and what to say of them."""


RECORDS = tuple(kind for kind in vars(records).values() if is_dataclass(kind))


def read_record(kind: type, data: Any, path: Path = ()) -> Any:
    """Return ``data`` as a record of ``kind``.

    :raises FleetError: with a fault for each value that is wrong, below ``path``.
    """
    try:
        return _adapter(kind).validate_python(data)
    except ValidationError as error:
        raise FleetError(_faults(error, data, path)) from error


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of problem files, made from the records."""
    schema = TypeAdapter(FleetRecords).json_schema(mode="validation")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "up-samp-problem",
        **{k: v for k, v in schema.items() if k != "title"},
    }


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _faults(error: ValidationError, data: Any, path: Path) -> list[Fault]:
    found: dict[Path, Fault] = {}
    for item in error.errors(include_url=False):
        inner = _inside(data, item["loc"])
        where = (*path, *inner)
        text = _in_words(item)
        found.setdefault(where, Fault(where, text))
    # of what has several forms each tells: the one that goes deeper was meant
    outer = {where[:depth] for where in found for depth in range(len(where))}
    return [fault for where, fault in found.items() if where not in outer]


def _in_words(item: Any) -> str:
    """Return what is wrong in the words of problem files, not in those of Python."""
    kind, given, limits = item["type"], item["input"], item.get("ctx", {})
    match kind:
        case "extra_forbidden" | "unexpected_keyword_argument":
            key = str(item["loc"][-1])
            return NOT_YET.get(key, no_such_key(key))
        case "value_error":
            return str(limits["error"])
        case "string_pattern_mismatch":
            what = "a name has letters, digits, '_', '-' and '.', and begins with a letter"
            near = re.sub(r"[^A-Za-z0-9_.-]", "_", str(given))
            return f"{what}: '{near}'?" if re.match("[A-Za-z_]", near) else what
        case _ if kind in _LIMITS:
            text, bound = _LIMITS[kind]
            told = len(given) if text.startswith("needs") else _shown(given)
            return f"{text.format(limits[bound])}, not {told}"
        case _ if kind in _WANTED and isinstance(given, bool):
            word = "yes, on or true" if given else "no, off or false"
            hint = "; quote a name that reads so" if kind == "string_type" else ""
            return f"should be {_WANTED[kind]}, and is {word}{hint}"
        case _ if kind in _WANTED:
            return f"should be {_WANTED[kind]}, not {_shown(given)}"
    return (
        str(item["msg"])
        .replace("Input should be", "should be")
        .replace("Field required", "is missing")
    )


_WANTED = {
    **dict.fromkeys(("tuple_type", "list_type", "iterable_type"), "a list"),
    **dict.fromkeys(
        ("mapping_type", "dict_type", "dataclass_type", "dataclass_exact_type", "model_type"),
        "a table of keys and values",
    ),
    **dict.fromkeys(("float_type", "float_parsing", "finite_number"), "a number"),
    **dict.fromkeys(
        ("int_type", "int_parsing", "int_from_float", "int_parsing_size"), "a whole number"
    ),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "a name (beginning with a letter), or text",
}
"""What a value should be, by the kind of pydantic's error."""

_LIMITS = {
    "greater_than": ("should be more than {:g}", "gt"),
    "greater_than_equal": ("should be {:g} or more", "ge"),
    "less_than": ("should be less than {:g}", "lt"),
    "less_than_equal": ("should be {:g} at most", "le"),
    "string_too_long": ("should be text of {} letters at most", "max_length"),
    "too_short": ("needs {} or more", "min_length"),
    "too_long": ("needs {} at most", "max_length"),
}


def _shown(value: Any) -> str:
    """Return a value as a file would have it, cut short."""
    text = f"{value}"
    match value:
        case None:
            return "nothing"
        case Mapping():
            return "a table"
        case list() | tuple():
            return f"a list of {len(value)}"
        case str():
            text = f"'{value}'"
    return text if len(text) <= 40 else f"{text[:37]}..."


NOT_HERE = {"crew": "only tasks have one; write an order for each robot, `together` with the first"}
"""What is said of keys that are asked for elsewhere, and are not there yet."""


def no_such_key(name: str) -> str:
    """Say that there is no such key, and which one may have been meant."""
    known = {field.name for kind in RECORDS for field in fields(kind)}
    if name in known:
        return NOT_HERE.get(name, "there is no such key here; it belongs to something else")
    near = get_close_matches(name, sorted(known), 1, 0.7)
    return f"there is no such key; did you mean '{near[0]}'?" if near else "there is no such key"


def _inside(data: Any, loc: tuple[str | int, ...]) -> Path:
    """Return the part of pydantic's place that leads through ``data``."""
    path: list[str | int] = []
    for i, part in enumerate(loc):
        last = i == len(loc) - 1
        if isinstance(data, Mapping) and isinstance(part, str):
            if part in data:
                data = data[part]
            elif not last or part.startswith(_UNIONS) or "[" in part:
                continue  # a member of a union, or a shorthand that stands for its first key
        elif isinstance(data, list | tuple) and isinstance(part, int) and part < len(data):
            data = data[part]
        else:
            continue
        path.append(part)
    return tuple(path)


# ------------------ Problem files: ``problem.yaml`` and ``problem.json``


LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Reads ten times as fast where libyaml is there."""


def read_problem_file(file: str | File) -> FleetRecords:
    """Read a problem file and check all names in it.

    :raises FleetError: that names the file, and line and place of each fault.
    """
    path = File(file)
    if path.suffix == ".py":
        what = "is a Python script, and a problem file (*.yaml, *.json) is needed: in a script, "
        raise FleetError((), f"'{path}' {what}Fleet.check() looks at a fleet, and save() writes it")
    text = text_of(path, "; 'up-samp new DIR' writes one to begin with")
    return read_problem_text(path, text, folder=path.parent)


def read_problem_text(
    path: File, text: str, map_file: str | None = None, folder: File | None = None
) -> FleetRecords:
    """Read the text of a problem file, which is called ``path`` in messages, and check all names in
    it. ``map_file``: the map of a problem that must not name one itself; ``folder``: where its map
    has to be readable (None: that is not looked at).

    :raises FleetError: like :func:`read_problem_file`.
    """
    root = compose(path, text)
    if not isinstance(root, yaml.MappingNode):
        what = "" if text.strip() else "is empty; "
        raise FleetError(
            (), f"{path}: {what}a problem file has keys such as map, robots and orders"
        )
    data = plain(path, root)
    if data.get("format") == FORMAT:
        what = "is a plan, and a problem file is needed: what its plan was made of"
        raise FleetError((), f"{path}: {what} ('solve PROBLEM --from PLAN' goes on from a plan)")
    table: tuple[File, list[int]] | None = None
    if isinstance(data.get("orders"), str):
        if folder is None:
            text = "list the orders here: there is no folder to read a table from"
            raise _error(path, root, [Fault(("orders",), text)])
        file = folder / data["orders"]
        listed = read_orders(file)
        data["orders"], table = [*listed.values()], (file, [*listed])
    try:
        records = checked_records(data, map_file)
    except FleetError as error:
        raise _error(path, root, error.faults, table) from error
    faults = [] if folder is None else list(_map_faults(records, folder))
    if faults:
        raise _error(path, root, faults)
    return records


def _map_faults(records: FleetRecords, folder: File) -> Iterator[Fault]:
    """A map that cannot be read is told where it is named."""
    maps: dict[Path, str] = {("map",): records.map}
    maps |= {("floors", name, "map"): floor.map for name, floor in records.floors.items()}
    for path, file in maps.items():
        try:
            load_map(folder / file)
        except ProblemError as error:
            yield Fault(path, str(error))


def checked_records(data: dict[str, Any], map_file: str | None = None) -> FleetRecords:
    """Return the plain data of a problem file as records (``map_file``: see above).

    :raises FleetError: with a fault for all that is wrong.
    """
    if map_file is not None:
        if "map" in data:
            text = "the problem must not name a map: it comes beside it"
            raise FleetError([Fault(("map",), text)])
        if data.get("floors"):
            text = "one map comes beside the problem: solve it where the files of its floors are"
            raise FleetError([Fault(("floors",), text)])
        data = {**data, "map": map_file}
    records: FleetRecords = read_record(FleetRecords, data)
    faults = find_faults(records)
    if faults:
        raise FleetError(faults)
    return records


def write_problem_file(file: str | File, records: FleetRecords) -> File:
    """Write ``records`` as JSON or YAML (by the file's ending), without what is as by default."""
    path = File(file)
    data = {"format": records.format, "version": records.version, **_slim(records)}
    if path.suffix == ".json":
        text = json.dumps(data, indent=1) + "\n"
    else:
        text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)
    path.write_text(text, encoding="utf-8")
    return path


def _slim(value: Any) -> Any:
    """Return dataclasses as dictionaries without their defaults, tuples as lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: _slim(getattr(value, f.name))
            for f in dataclasses.fields(value)
            if getattr(value, f.name) != _default(f)
        }
    if isinstance(value, dict):
        return {k: _slim(v) for k, v in value.items()}
    return [_slim(v) for v in value] if isinstance(value, list | tuple) else value


def _default(field: Any) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def compose(path: File, text: str) -> yaml.Node | None:
    """Return the tree of nodes with their lines (JSON is YAML, too); None where nothing is written.

    :raises FleetError: that names file and line, where it is no YAML, or an unreasonable one.
    """
    try:
        _check_tokens(path, yaml.scan(text, LOADER))
        return yaml.compose(text, LOADER)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        last = text.count("\n") + 1  # what is missing may be missed behind it
        line = f":{min(mark.line + 1, last)}" if mark is not None else ""
        what = getattr(error, "problem", None) or str(error)
        if "nesting depth" in what:  # newer scanners read ahead of the tokens that are looked at
            raise FleetError((), f"{path}{line}: {_TOO_DEEP}") from error
        raise FleetError((), f"{path}{line}: not readable as YAML or JSON: {what}") from error


def _check_tokens(path: File, tokens: Iterable[yaml.Token]) -> None:
    """Look at tokens as they come: to scan further is dear where they are nested deeply."""
    aliases = depth = 0
    for token in tokens:
        aliases += isinstance(token, yaml.AliasToken)
        depth += isinstance(token, _OPENING) - isinstance(token, _CLOSING)
        if aliases > FILE_LIMITS.aliases:
            raise FleetError((), f"{path}: more than {FILE_LIMITS.aliases} aliases")
        if depth > FILE_LIMITS.depth:
            line = token.start_mark.line + 1
            raise FleetError((), f"{path}:{line}: {_TOO_DEEP}")


_TOO_DEEP = f"nested too deeply ({FILE_LIMITS.depth} at most)"
_OPENING = (
    yaml.FlowSequenceStartToken,
    yaml.FlowMappingStartToken,
    yaml.BlockSequenceStartToken,
    yaml.BlockMappingStartToken,
)
_CLOSING = (yaml.FlowSequenceEndToken, yaml.FlowMappingEndToken, yaml.BlockEndToken)


_BASED = re.compile(r"[-+]?(0[0-9_]+|[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?)")
"""What YAML 1.1 reads as a number in base 8 or 60."""


def _scalar(path: File, where: Path, loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    """Return what a scalar stands for; numbers that mean something else to readers are refused."""
    place = f"{path}:{node.start_mark.line + 1}" + (f": {show_path(where)}" if where else "")
    number = node.tag.endswith((":int", ":float"))
    if number and len(node.value) > FILE_LIMITS.number:  # in base 16 it could be read, but not told
        raise FleetError((), f"{place}: {_shown(node.value)} is too long for a number")
    if number and _BASED.fullmatch(str(node.value)):
        base = 60 if ":" in node.value else 8
        raise FleetError(
            (),
            f"{place}: '{node.value}' is no number: YAML would read it in base {base}, as "
            f"{float(loader.construct_object(node)):g}; write a plain number (times in s)",
        )
    try:
        return loader.construct_object(node)
    except ValueError as error:  # a date that there is not
        raise FleetError((), f"{place}: {_shown(node.value)} cannot be read") from error


def plain(path: File, root: yaml.Node) -> Any:
    """Return the tree as plain data. Every alias is expanded, up to a size."""
    loader = yaml.SafeLoader("")
    budget = [FILE_LIMITS.file_bytes // 16]

    def visit(node: yaml.Node, depth: int, where: Path = ()) -> Any:
        budget[0] -= 1
        if budget[0] < 0 or depth > FILE_LIMITS.depth:
            line = node.start_mark.line + 1
            raise FleetError((), f"{path}:{line}: too large or nested too deeply (aliases?)")
        if isinstance(node, yaml.MappingNode):
            found: dict[Any, Any] = {}
            for key, value in node.value:
                # the key that YAML 1.1 takes for a truth value if it is not quoted
                name = "on" if key.value == "on" else visit(key, depth + 1)
                line = key.start_mark.line + 1
                if not isinstance(name, str):
                    what = f"the key {key.value or name} must be text: quote it"
                    raise FleetError((), f"{path}:{line}: {what}")
                if name in found:
                    raise FleetError((), f"{path}:{line}: the key '{name}' is there twice")
                found[name] = visit(value, depth + 1, (*where, name))
            return found
        if isinstance(node, yaml.SequenceNode):
            return [visit(item, depth + 1, (*where, i)) for i, item in enumerate(node.value)]
        return _scalar(path, where, loader, node)

    try:
        return visit(root, 0)
    except (yaml.YAMLError, ValueError) as error:
        if isinstance(error, FleetError):
            raise
        raise FleetError((), f"{path}: {error}") from error
    finally:
        loader.dispose()


def _error(
    path: File,
    root: yaml.Node,
    faults: Sequence[Fault],
    table: tuple[File, Sequence[int]] | None = None,
) -> FleetError:
    """Return an error that tells file and line of each fault; ``table``: a file of orders, and the
    line in which each stands.
    """

    def tell(fault: Fault) -> str:
        match fault.path:
            case ("orders", int(row), *inner) if table is not None:
                there = dataclasses.replace(fault, path=tuple(inner))
                return f"{table[0]}:{table[1][row]}: {there}"
        return f"{path}:{_line(root, fault.path)}: {fault}"

    return FleetError(faults, told(faults, tell))


def _line(root: yaml.Node, path: Path) -> int:
    """Return the line of the deepest part of ``path`` that is written in the file."""
    node, line = root, root.start_mark.line
    for part in path:
        if isinstance(node, yaml.MappingNode):
            found = next(((k, v) for k, v in node.value if k.value == str(part)), None)
            if found is None:
                break
            line, node = found[0].start_mark.line, found[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line
        else:
            break
    return int(line) + 1


# ------------------ Orders in a CSV file beside a problem file, as warehouse systems write them
# The first line names the columns: keys of an order (``id``, ``pickup``, ``due``), those of a stop
# or a load behind a point (``pickup.service``, ``load.item``). A row is an order; an empty cell
# says nothing; several names or numbers in a cell stand with spaces between them.


SEPARATORS = ",;\t"
WORDS = {"yes": True, "true": True, "no": False, "false": False}
STOPS = ("pickup", "delivery")


def read_orders(file: File) -> dict[int, dict[str, Any]]:
    """Return the orders of a CSV file as plain data, by the line in which each stands; what cells
    mean is not looked at.

    :raises FleetError: that names file and line, where it is no such table.
    """
    text = text_of(file, " with orders")
    header = text.partition("\n")[0]
    reader = csv.reader(
        io.StringIO(text, newline=""), delimiter=max(SEPARATORS, key=header.count), strict=True
    )
    orders = {}
    try:
        keys = _keys(file, next(reader, []))
        for row in reader:
            if any(cell.strip() for cell in row):
                orders[reader.line_num] = _order(file, reader.line_num, keys, row)
    except csv.Error as error:
        raise FleetError((), f"{file}:{reader.line_num}: not readable as CSV: {error}") from error
    return orders


def check_size(file: File, missing: str = "") -> File:
    """Return ``file`` if it is one that may be read whole.

    :raises FleetError: where there is none (``missing`` says more of that), or a larger one than
        any that is meant.
    """
    if file.is_dir():
        raise FleetError((), f"'{file}' is a folder; name the file in it")
    if not file.is_file():
        raise FleetError((), f"there is no file '{file}'{missing}")
    if file.stat().st_size > FILE_LIMITS.file_bytes:
        raise FleetError((), f"{file}: larger than {FILE_LIMITS.file_bytes // 1_000_000} MB")
    return file


def text_of(file: File, missing: str = "") -> str:
    """Return a file's text.

    :raises FleetError: like :func:`check_size`, and where it cannot be read.
    """
    try:
        return check_size(file, missing).read_text(encoding="utf-8-sig")  # some begin with a mark
    except UnicodeDecodeError as error:
        raise FleetError((), f"{file}: is not UTF-8 text") from error
    except OSError as error:
        raise FleetError((), f"'{file}' cannot be read: {error.strerror}") from error


def _keys(file: File, header: list[str]) -> list[tuple[str, ...]]:
    """Return where in an order each column belongs."""
    names = [name.strip() for name in header]
    twice = sorted({name for name in names if names.count(name) > 1})
    if "id" not in names or twice:
        what = f"the column '{twice[0]}' is there twice" if twice else "there is no column 'id'"
        raise FleetError((), f"{file}:1: {what}; the first line names the columns")
    nested = {name.partition(".")[0] for name in names if "." in name}
    found = [tuple(name.split(".")) for name in names]
    return [(*k, "at") if k[0] in STOPS and k[0] in nested and len(k) == 1 else k for k in found]


def _order(file: File, line: int, keys: list[tuple[str, ...]], row: list[str]) -> dict[str, Any]:
    if len(row) != len(keys):
        raise FleetError((), f"{file}:{line}: {len(row)} cells, for {len(keys)} columns")
    order: dict[str, Any] = {}
    for (*outer, last), cell in zip(keys, row, strict=True):
        if cell.strip():
            inner = order
            for key in outer:
                inner = inner.setdefault(key, {})
            inner[last] = _value(cell)
    return order


def _value(cell: str) -> Any:
    """Return what a cell says: a yes or no, a number, a name, or several of them."""
    parts = [_word(part) for part in cell.split()]
    return parts[0] if len(parts) == 1 else parts


def _word(text: str) -> Any:
    if text.lower() in WORDS:
        return WORDS[text.lower()]
    for kind in (int, float) if text[0] in "+-.0123456789" else ():
        try:
            return kind(text)
        except ValueError:
            continue
    return text


# ------------------ A problem file to begin with: ``up-samp new``


CELL = 0.1
WIDTH, HEIGHT = 30.0, 16.0
PROBLEM = resources.files("up_samp.fleet").joinpath("starter.yaml").read_text("utf-8")


def write_starter(folder: File) -> list[File]:
    """Write ``problem.yaml`` and a map of two rooms into ``folder``; return the files.

    :raises ProblemError: where one of them is there already.
    """
    files = [folder / name for name in ("problem.yaml", "warehouse.yaml", "warehouse.png")]
    there = [f for f in files if f.exists()]
    if there:
        raise ProblemError(f"'{there[0]}' is there already; name another folder")
    folder.mkdir(parents=True, exist_ok=True)
    write_map(folder, "warehouse", two_rooms(), CELL)
    files[0].write_text(PROBLEM, encoding="utf-8")
    return files


def two_rooms() -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Return the cells of two rooms, side by side, joined by a gap of 4 m; row 0 has lowest y."""
    rows, cols = round(HEIGHT / CELL), round(WIDTH / CELL)
    occupied = np.zeros((rows, cols), dtype=np.bool_)
    wall = round(0.3 / CELL)
    occupied[:wall], occupied[-wall:] = True, True
    occupied[:, :wall], occupied[:, -wall:] = True, True
    middle = cols // 2
    occupied[:, middle - 1 : middle + 2] = True
    occupied[round(6 / CELL) : round(10 / CELL), middle - 1 : middle + 2] = False
    return occupied
