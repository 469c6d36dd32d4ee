"""What commands are given, as rows of tables: how an option is called, its help, what it takes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

from up_samp.benchmarks.instances import ENCODINGS

Option = tuple[tuple[str, ...], str, dict[str, Any]]
"""Its names, the group that it is in, and how argparse reads it."""
Command = tuple[Callable[[argparse.Namespace], int], tuple[Option, ...]]
"""What a command does, and what it is given."""

ONE_OF = "one of"
"""The group of options of which one at most is given."""
DEFAULT = "(default: %(default)s)"


def option(
    names: str,
    text: str | None = None,
    metavar: str | None = None,
    kind: Callable[[str], Any] | None = None,
    default: Any = None,
    *,
    group: str = "",
    **how: Any,
) -> Option:
    """Return an option (by ``--NAME``), or what is given by its place: ``text`` is its help, and
    ``kind`` makes a value of what is written.
    """
    told = {"help": text, "metavar": metavar, "type": kind, "default": default}
    return tuple(names.split()), group, how | {k: v for k, v in told.items() if v is not None}


def add_command(
    parser: argparse.ArgumentParser, command: Command | Mapping[str, tuple[str, Command]]
) -> None:
    """Add what a command is given, or commands of its own: what each does, in a line."""
    if isinstance(command, Mapping):
        inner = parser.add_subparsers(required=True)
        for name, (text, one) in command.items():
            add_command(inner.add_parser(name, help=text), one)
        return
    run, options = command
    only: dict[str, Callable[[], Any]] = {
        "": lambda: parser,
        ONE_OF: parser.add_mutually_exclusive_group,
    }
    place = cache(lambda group: only.get(group, partial(parser.add_argument_group, group))())
    for names, group, how in options:
        place(group).add_argument(*names, **how)
    parser.set_defaults(run=run)


# ------------------ What several commands are given


def encoding(text: str | None = None) -> Option:
    """Return the option that says how a benchmark instance is written."""
    return option("--encoding", text, default="fluents", choices=ENCODINGS)


PLAN = option("plan", None, "PLAN.json", Path)
OUT = option("--out", None, "DIR", Path, Path("."))
PROBLEM = (
    option(
        "problem",
        "a problem file (problem.yaml), a Python script that defines 'problem' or "
        "'get_problem()', or the name of a benchmark instance such as logistics-dc-all-r2-i4 "
        "('up-samp bench list' names them)",
        "PROBLEM",
    ),
    encoding("of a benchmark instance"),
)
