"""The command line ``up-samp``: its commands (``COMMANDS``), exit codes, and errors in a line."""

from __future__ import annotations

import argparse
import gc
import importlib
import io
import os
import signal
import sys
from collections.abc import Sequence

from up_samp.system.imports import interrupt_behind, load_unified_planning, own_the_process

ERROR, INTERRUPTED, TERMINATED = 2, 128 + signal.SIGINT, 128 + signal.SIGTERM
"""Exit codes beside 0 and a command's own; of signals as shells have them."""


COMMANDS = {
    "demo": ("cli.commands", "two robots, a closed door, four items"),
    "new": ("cli.commands", "write a problem file and a map to begin with"),
    "check": (
        "cli.commands", "look at a problem file before solving: what overlaps, what is reachable",
    ),
    "import": (
        "cli.commands", "make a problem file from a Moving AI, LIF, RMF, JSPLIB, DXF ... file",
    ),
    "solve": ("cli.commands", "solve a problem of your own, or an instance"),
    "validate": ("cli.commands", "check a plan file against its problem"),
    "draw": ("cli.commands", "draw a plan file: charts, map, animation"),
    "simulate": (
        "cli.simulating",
        "execute a plan on a floor with delays: how long, who waits, who collides",
    ),
    "export": ("cli.commands", "write a plan file in another format"),
    "operate": ("cli.operating", "operate a fleet: orders in, plans and orders to robots out"),
    "day": ("cli.operating", "simulate a day of orders, delays and breakdowns on a site"),
    "why": ("cli.operating", "who was told what and why, from the store of a day"),
    "serve": ("cli.commands", "plan for others on this machine, over HTTP"),
    "engines": ("cli.commands", "list the registered engines that schedule"),
    "warmup": (
        "cli.commands", "compile the motion kernels now, so that no first solve waits for them",
    ),
    "bench": ("benchmarks.cli", "run the benchmark families and report on them"),
}  # fmt: skip
"""The module that has a command in its own ``COMMANDS``, with what it is given (it is imported when
somebody gives the command), and what the command does in a line.
"""


def make_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of all commands, with the arguments of those among the ``words``."""
    from up_samp import __version__

    parser = argparse.ArgumentParser(
        prog="up-samp",
        description="Plan when each task of a fleet happens and how each robot drives, together.",
    )
    parser.add_argument("--version", action="version", version=f"up-samp {__version__}")
    parser.add_argument(
        "--debug", action="store_true", help="show where an error comes from (a traceback)"
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (module, text) in COMMANDS.items():
        own = commands.add_parser(name, help=text)
        if name in words:
            load_unified_planning()
            from up_samp.cli.options import add_command

            add_command(own, importlib.import_module(f"up_samp.{module}").COMMANDS[name])
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; return 0: well, 1: no (valid) plan, 2: an error, 130: Ctrl-C, 143: SIGTERM."""
    own = argv is None
    try:
        if own:
            _own_the_process()
        words = sys.argv[1:] if argv is None else argv
        args = make_parser(words).parse_args(words)
        if own:
            _collect_garbage()
        return _run(args)
    except KeyboardInterrupt as stop:
        print("\nup-samp: stopped", file=sys.stderr)
        return TERMINATED if _was_terminated(stop) else INTERRUPTED
    finally:
        if own:
            _let_go_of_output()
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            gc.freeze()  # else the end is a search through all that is left: a tenth of a second


def _own_the_process() -> None:
    own_the_process()
    gc.disable()  # what is imported stays
    _open_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names in any script, on any terminal
            stream.reconfigure(errors="backslashreplace")
    signal.signal(signal.SIGTERM, _terminate)


def _let_go_of_output() -> None:
    """Write what is left of our output, if it can be: the interpreter's exit is not to complain,
    nor to change the exit code.
    """
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _collect_garbage() -> None:
    """Collect garbage from now on, but seldom: else it takes a sixth of a short command's time."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


def _open_streams() -> None:
    """Open what of standard input, output and error is closed, to nowhere: else the next files to
    be opened would take their places, and be written to by whoever prints.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(descriptor, mode, closefd=False))  # noqa: SIM115


def _run(args: argparse.Namespace) -> int:
    from unified_planning.shortcuts import get_environment

    get_environment().credits_stream = None
    try:
        code: int = args.run(args)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:
        return ERROR  # whoever read our output has seen enough
    except Exception as error:
        stop = interrupt_behind(error)
        if stop is not None:
            raise stop from None
        if args.debug:
            raise
        print(f"up-samp: {_message(error)}", file=sys.stderr)
        return ERROR


_TERMINATED = "SIGTERM"
"""What a ``KeyboardInterrupt`` holds that is none: like Ctrl-C, so that the best plan is kept and
files are whole.
"""


def _terminate(_number: int, _frame: object) -> None:
    raise KeyboardInterrupt(_TERMINATED)


def _was_terminated(stop: BaseException | None) -> bool:
    while stop is not None and stop.args != (_TERMINATED,):
        stop = stop.__cause__
    return stop is not None


def _message(error: Exception) -> str:
    """Return what went wrong, a line a fault; errors that are not the user's say so."""
    lines = (" ".join(line.split()) for line in str(error).splitlines())
    text = "\n".join(filter(None, lines)) or type(error).__name__
    from unified_planning.exceptions import UPException

    from up_samp.model.errors import SampError

    if isinstance(error, SampError | UPException | OSError):
        return text
    return f"internal error, {type(error).__name__}: {text} (--debug shows where)"
