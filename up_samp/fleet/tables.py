"""Orders in a CSV file beside a problem file, as warehouse systems write them.

The first line names the columns: keys of an order (``id``, ``pickup``, ``due``), those of a stop or
a load behind a point (``pickup.service``, ``load.item``). A row is an order; an empty cell says
nothing; several names or numbers in a cell stand with spaces between them.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from up_samp.fleet.faults import FleetError
from up_samp.fleet.limits import FILE_LIMITS

SEPARATORS = ",;\t"
WORDS = {"yes": True, "true": True, "no": False, "false": False}
STOPS = ("pickup", "delivery")


def read_orders(file: Path) -> dict[int, dict[str, Any]]:
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


def check_size(file: Path, missing: str = "") -> Path:
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


def text_of(file: Path, missing: str = "") -> str:
    """Return a file's text.

    :raises FleetError: like :func:`check_size`, and where it cannot be read.
    """
    try:
        return check_size(file, missing).read_text(encoding="utf-8-sig")  # some begin with a mark
    except UnicodeDecodeError as error:
        raise FleetError((), f"{file}: is not UTF-8 text") from error
    except OSError as error:
        raise FleetError((), f"'{file}' cannot be read: {error.strerror}") from error


def _keys(file: Path, header: list[str]) -> list[tuple[str, ...]]:
    """Return where in an order each column belongs."""
    names = [name.strip() for name in header]
    twice = sorted({name for name in names if names.count(name) > 1})
    if "id" not in names or twice:
        what = f"the column '{twice[0]}' is there twice" if twice else "there is no column 'id'"
        raise FleetError((), f"{file}:1: {what}; the first line names the columns")
    nested = {name.partition(".")[0] for name in names if "." in name}
    found = [tuple(name.split(".")) for name in names]
    return [(*k, "at") if k[0] in STOPS and k[0] in nested and len(k) == 1 else k for k in found]


def _order(file: Path, line: int, keys: list[tuple[str, ...]], row: list[str]) -> dict[str, Any]:
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
