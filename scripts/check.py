"""Run the checks: lint, format, types, layers, tests. Stops at the first that fails.

    python scripts/check.py                      all of it, as CI does
    python scripts/check.py lint                 what reads the code only
    python scripts/check.py fast                 that, and the rooms whose tests solve nothing whole
    python scripts/check.py room motion/fleet    the tests of one room

What follows goes to pytest (``python scripts/check.py --long``).
"""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

FAST = (
    "export",
    "fleet/importers",
    "motion/curves",
    "plotting",
    "refinement",
    "scheduling/compilers",
    "scheduling/partial_order",
    "upio",
    "validation",
)
"""Rooms whose tests take seconds: they read, write, time and judge, and solve nothing whole."""


def tool(name: str) -> str:
    """Return a command that was installed beside this Python."""
    return str(Path(sys.executable).parent / name)


def pytest(*arguments: str) -> list[str]:
    """Return the command that runs tests, by two processes: what a module shares is made once."""
    return [sys.executable, "-m", "pytest", "-n", "2", "--dist", "worksteal", "-q", *arguments]


STYLE = (
    [tool("ruff"), "check", "."],
    [tool("ruff"), "format", "--check", "."],
    [tool("lint-imports")],
)
TYPES = [tool("mypy")]
WAITING = ("tests/operate/test_mqtt.py", "tests/operate/test_page.py", "tests/server/test_page.py")
"""Tests that mostly wait, for robots in real time and for browsers: others run meanwhile."""


def room(name: str) -> str:
    """Return the folder with the tests of a room of ``up_samp/``; exits where there is none."""
    folder = Path("tests", name.removeprefix("up_samp/").removeprefix("tests/"))
    if not any((ROOT / folder).rglob("test_*.py")):
        sys.exit(f"no room has its tests in {folder}")
    return str(folder)


def commands(arguments: list[str]) -> list[list[str]]:
    """Return what is to be run, in this order."""
    what, *rest = arguments or [""]
    if what == "lint":
        return [*STYLE, TYPES]
    if what == "fast":
        return [*STYLE, pytest(*map(room, FAST), *rest)]
    if what == "room":
        return [pytest(*map(room, rest[:1] or [""]), *rest[1:])]
    others = [f"--ignore={file}" for file in WAITING if are_all(arguments)]
    return [*STYLE, pytest("--durations=40", *others, *arguments)]


def are_all(arguments: list[str]) -> bool:
    """Return whether arguments for pytest ask for no tests by name."""
    return not {*arguments} - {"--long"}


def beside(arguments: list[str]) -> list[list[str]]:
    """Return what is run beside all of it, by one more process, in this order."""
    tests = [sys.executable, "-m", "pytest", "-q", *WAITING, *arguments]
    return [TYPES, tests] if are_all(arguments) else [TYPES]


def run(command: list[str]) -> int:
    """Run a command; return its exit code."""
    print("$", Path(command[0]).name, *command[1:], flush=True)
    return subprocess.run(command, cwd=ROOT, check=False).returncode


def main() -> int:
    """Run the checks; return the first exit code that is not 0."""
    arguments = sys.argv[1:]
    if arguments[:1] in (["lint"], ["fast"], ["room"]):
        return next((code for code in map(run, commands(arguments)) if code), 0)
    # tests wait for processes, brokers and pages now and then: types are judged meanwhile
    with ThreadPoolExecutor(1) as pool:
        told = [pool.submit(quietly, command) for command in beside(arguments)]
        code = next((code for code in map(run, commands(arguments)) if code), 0)
        for command, done in zip(beside(arguments), told, strict=True):
            if code and done.cancel():
                continue  # it has not begun
            print("$", Path(command[0]).name, *command[1:], done.result().stdout, flush=True)
            code = code or done.result().returncode
    return code


def quietly(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a command; return what it says with its exit code."""
    return subprocess.run(
        command, cwd=ROOT, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


if __name__ == "__main__":
    sys.exit(main())
