"""Problem files: ``problem.yaml`` and ``problem.json``."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path as File
from typing import Any

import yaml

from up_samp.fleet.faults import Fault, FleetError, Path, find_faults, told
from up_samp.fleet.limits import LIMITS
from up_samp.fleet.reading import read_record
from up_samp.fleet.records import FleetRecords
from up_samp.geometry import load_map
from up_samp.model import ProblemError

LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Reads ten times as fast where libyaml is there."""

ENDINGS = (".yaml", ".yml", ".json")


def is_problem_file(name: str) -> bool:
    """Return whether ``name`` ends like a problem file."""
    return name.lower().endswith(ENDINGS)


def read_problem_file(file: str | File) -> FleetRecords:
    """Read a problem file and check all names in it.

    :raises FleetError: that names the file, and line and place of each fault.
    """
    path = File(file)
    return read_problem_text(path, _text(path), folder=path.parent)


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
        raise FleetError((), f"{path}: a problem file has keys such as map, robots and orders")
    data = _plain(path, root)
    lines = _Lines(path, root)
    try:
        records = checked_records(data, map_file)
    except FleetError as error:
        raise lines.error(error.faults) from error
    faults = [] if folder is None else list(_map_faults(records, folder))
    if faults:
        raise lines.error(faults)
    return records


def _map_faults(records: FleetRecords, folder: File) -> Iterator[Fault]:
    """A map that cannot be read is told where it is named."""
    try:
        load_map(folder / records.map)
    except ProblemError as error:
        yield Fault(("map",), str(error))


def checked_records(data: dict[str, Any], map_file: str | None = None) -> FleetRecords:
    """Return the plain data of a problem file as records (``map_file``: see above).

    :raises FleetError: with a fault for all that is wrong.
    """
    if map_file is not None:
        if "map" in data:
            text = "the problem must not name a map: it comes beside it"
            raise FleetError([Fault(("map",), text)])
        data = {**data, "map": map_file}
    records: FleetRecords = read_record(FleetRecords, data)
    faults = find_faults(records)
    if faults:
        raise FleetError(faults)
    return records


def write_problem_file(file: str | File, records: FleetRecords) -> File:
    """Write ``records`` as JSON or YAML (by the file's ending), without what is as by default."""
    path = File(file)
    data = to_plain(records)
    if path.suffix == ".json":
        text = json.dumps(data, indent=1) + "\n"
    else:
        text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)
    path.write_text(text, encoding="utf-8")
    return path


def to_plain(records: FleetRecords) -> dict[str, Any]:
    """Return records as a problem file holds them, format and version first."""
    return {"format": records.format, "version": records.version, **_slim(records)}


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


def _text(path: File) -> str:
    if not path.is_file():
        raise FleetError(
            (), f"there is no file '{path}'; 'up-samp new DIR' writes one to begin with"
        )
    if path.stat().st_size > LIMITS.file_bytes:
        raise FleetError((), f"{path}: larger than {LIMITS.file_bytes // 1_000_000} MB")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise FleetError((), f"{path}: is not UTF-8 text") from error


def compose(path: File, text: str) -> yaml.Node | None:
    """Return the tree of nodes with their lines (JSON is YAML, too); None where nothing is written.

    :raises FleetError: that names file and line, where it is no YAML, or an unreasonable one.
    """
    try:
        _check_tokens(path, yaml.scan(text, LOADER))
        return yaml.compose(text, LOADER)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        what = getattr(error, "problem", None) or str(error)
        raise FleetError((), f"{path}{line}: not readable as YAML or JSON: {what}") from error


def _check_tokens(path: File, tokens: Iterable[yaml.Token]) -> None:
    """Look at tokens as they come: to scan further is dear where they are nested deeply."""
    aliases = depth = 0
    for token in tokens:
        aliases += isinstance(token, yaml.AliasToken)
        depth += isinstance(token, _OPENING) - isinstance(token, _CLOSING)
        if aliases > LIMITS.aliases:
            raise FleetError((), f"{path}: more than {LIMITS.aliases} aliases")
        if depth > LIMITS.depth:
            line = token.start_mark.line + 1
            raise FleetError((), f"{path}:{line}: nested too deeply ({LIMITS.depth} at most)")


_OPENING = (
    yaml.FlowSequenceStartToken,
    yaml.FlowMappingStartToken,
    yaml.BlockSequenceStartToken,
    yaml.BlockMappingStartToken,
)
_CLOSING = (yaml.FlowSequenceEndToken, yaml.FlowMappingEndToken, yaml.BlockEndToken)


_BASED = re.compile(r"[-+]?(0[0-9_]+|[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?)")
"""What YAML 1.1 reads as a number in base 8 or 60."""


def _scalar(path: File, loader: yaml.SafeLoader, node: yaml.Node) -> Any:
    """Return what a scalar stands for; numbers that mean something else to readers are refused."""
    if node.tag.endswith((":int", ":float")) and _BASED.fullmatch(str(node.value)):
        base = 60 if ":" in node.value else 8
        value = loader.construct_object(node)
        raise FleetError(
            (),
            f"{path}:{node.start_mark.line + 1}: '{node.value}' is no number: YAML would read it "
            f"in base {base}, as {value:g}; write a plain number (times in s)",
        )
    return loader.construct_object(node)


def _plain(path: File, root: yaml.Node) -> Any:
    """Return the tree as plain data. Every alias is expanded, up to a size."""
    loader = yaml.SafeLoader("")
    budget = [LIMITS.file_bytes // 16]

    def visit(node: yaml.Node, depth: int) -> Any:
        budget[0] -= 1
        if budget[0] < 0 or depth > LIMITS.depth:
            line = node.start_mark.line + 1
            raise FleetError((), f"{path}:{line}: too large or nested too deeply (aliases?)")
        if isinstance(node, yaml.MappingNode):
            found: dict[Any, Any] = {}
            for key, value in node.value:
                name = visit(key, depth + 1)
                line = key.start_mark.line + 1
                if not isinstance(name, str):
                    what = f"the key {key.value or name} must be text: quote it"
                    raise FleetError((), f"{path}:{line}: {what}")
                if name in found:
                    raise FleetError((), f"{path}:{line}: the key '{name}' is there twice")
                found[name] = visit(value, depth + 1)
            return found
        if isinstance(node, yaml.SequenceNode):
            return [visit(item, depth + 1) for item in node.value]
        return _scalar(path, loader, node)

    try:
        return visit(root, 0)
    except (yaml.YAMLError, ValueError) as error:
        if isinstance(error, FleetError):
            raise
        raise FleetError((), f"{path}: {error}") from error
    finally:
        loader.dispose()


class _Lines:
    """Where in the file a path leads."""

    def __init__(self, path: File, root: yaml.Node) -> None:
        self.path = path
        self.root = root

    def error(self, faults: tuple[Fault, ...] | list[Fault]) -> FleetError:
        """Return an error that tells file and line of each fault."""
        return FleetError(faults, told(faults, lambda f: f"{self.path}:{self.line(f.path)}: {f}"))

    def line(self, path: Path) -> int:
        """Return the line of the deepest part of ``path`` that is written in the file."""
        node, line = self.root, self.root.start_mark.line
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
