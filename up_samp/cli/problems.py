"""Find the problem that a command names: a Python script, or an instance of a benchmark family."""

from __future__ import annotations

import argparse
import os
import runpy
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unified_planning.exceptions import UPException
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.benchmarks import instance
from up_samp.benchmarks.instances import Encoding
from up_samp.io import PlanDict
from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError, SampError

if TYPE_CHECKING:
    from up_samp.fleet import Fleet


def find_problem(
    name: str, encoding: Encoding = "fluents", settings: Mapping[str, float] | None = None
) -> SchedulingProblem:
    """Return the problem of a problem file, of a script (``*.py``) or of a benchmark instance.
    ``settings`` take the place of a problem file's own (see :func:`settle`).

    Raises :class:`ProblemError` that says what was looked for.
    """
    fleet = fleet_of(name, settings or {})
    if fleet is not None:
        return fleet.problem
    path = Path(name)
    if path.suffix == ".py":
        return load_script(path)
    if path.suffix or os.sep in name or path.is_file():
        raise ProblemError(
            f"'{name}' is no problem file: those are Python scripts (*.py), YAML and JSON files"
        )
    return instance(name).build(encoding, True)


def problem_of_plan(name: str, encoding: Encoding, plan: PlanDict) -> SchedulingProblem:
    """Return the problem that a plan is one of: a problem file's in the plan's unit of time, which
    may be another one than the file's.
    """
    return find_problem(name, encoding, {"seconds_per_unit": plan["seconds_per_unit"]})


def fleet_of(name: str, settings: Mapping[str, float]) -> Fleet | None:
    """Return the fleet of a problem file, with other ``settings``; None for other problems."""
    if not name.lower().endswith((".yaml", ".yml", ".json")):
        return None
    from up_samp.fleet import Fleet

    return Fleet.from_file(name).with_settings(**settings)


def settle(fleet: Fleet | None, args: argparse.Namespace) -> dict[str, float]:
    """Settle, and return, with which length of a schedule unit (s) and margin (m) a problem is
    solved: what is given, else what its problem file (``fleet``) asks for, else what the engines
    take.
    """
    own = {"seconds_per_unit": 1.0, "margin": PRECISION.margin} if fleet is None else fleet.settings
    settings = {k: v if vars(args)[k] is None else vars(args)[k] for k, v in own.items()}
    vars(args).update(settings)
    return settings


def load_script(path: Path) -> SchedulingProblem:
    """Run a Python script and return its ``problem``, or what its ``get_problem()`` returns.

    The script runs with a ``__name__`` that is not ``__main__`` and may import its neighbours.
    """
    if not path.is_file():
        raise ProblemError(f"there is no file '{path}'")
    sys.path.insert(0, str(path.resolve().parent))
    try:
        names = runpy.run_path(str(path), run_name="__up_samp__")
        problem = names.get("problem")
        if problem is None and callable(names.get("get_problem")):
            problem = names["get_problem"]()
    except (SampError, UPException) as error:
        raise ProblemError(f"'{path}' failed: {error}") from error
    except (KeyboardInterrupt, MemoryError):
        raise
    except SystemExit as error:
        raise ProblemError(f"'{path}' left by sys.exit({error.code!r})") from error
    except BaseException as error:  # whatever a user's script may raise
        what = traceback.format_exception_only(error)[-1].strip()
        raise ProblemError(f"'{path}' failed{_line(path, error)}: {what}") from error
    finally:
        sys.path.pop(0)
    return _checked(problem, path)


def _checked(problem: Any, path: Path) -> SchedulingProblem:
    if problem is None:
        raise ProblemError(f"'{path}' defines neither 'problem' nor 'get_problem()'")
    if not isinstance(problem, SchedulingProblem):
        raise ProblemError(
            f"the problem of '{path}' is a {type(problem).__name__}; a SchedulingMotionProblem "
            "(or SchedulingProblem) is needed"
        )
    return problem


def _line(path: Path, error: BaseException) -> str:
    """Return the line of the script at which it failed."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename) == path]
    return f" at line {lines[-1]}" if lines else ""
