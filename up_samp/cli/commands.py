"""The commands that plan, judge, draw and compile; each adds its arguments and runs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import unified_planning as up
from unified_planning.engines import Engine
from unified_planning.model import ProblemKind
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.benchmarks import logistics
from up_samp.benchmarks.builder import ENCODINGS
from up_samp.cli.fleets import tell_findings
from up_samp.cli.outputs import write_outputs
from up_samp.cli.problems import (
    add_problem_arguments,
    find_problem,
    is_problem_file,
    problem_of_plan,
    settings_of,
)
from up_samp.cli.solving import add_solver_arguments, describe, judge, solve_and_show
from up_samp.cli.table import table
from up_samp.io import read_plan
from up_samp.model import ProblemError
from up_samp.model.errors import short
from up_samp.system.files import check_folder


def add_demo(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``demo``."""
    parser.add_argument("--robots", type=int, default=2, metavar="N", help="(default: 2)")
    parser.add_argument("--items", type=int, default=4, metavar="N", help="(default: 4)")
    parser.add_argument("--door", choices=("closed", "open"), default="closed")
    parser.add_argument("--sides", choices=("all", "corridor"), default="corridor")
    parser.add_argument("--encoding", choices=ENCODINGS, default="lean")
    add_solver_arguments(parser, out="demo-out", gif=True)
    parser.set_defaults(run=_demo)


def _demo(args: argparse.Namespace) -> int:
    problem = logistics(
        robots=args.robots,
        items=args.items,
        door=args.door,
        sides=args.sides,
        encoding=args.encoding,
    )
    _settle("", args)
    return solve_and_show(problem, args)


def add_solve(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``solve``."""
    add_problem_arguments(parser)
    add_solver_arguments(parser, out=None, gif=False)
    parser.set_defaults(run=_solve)


def _solve(args: argparse.Namespace) -> int:
    problem = find_problem(args.problem, args.encoding, _settle(args.problem, args))
    code = solve_and_show(problem, args)
    if code and is_problem_file(args.problem):
        tell_findings(args.problem)
    return code


def _settle(name: str, args: argparse.Namespace) -> dict[str, float]:
    """Settle with which settings a problem is solved, and return them."""
    given = {"seconds_per_unit": args.seconds_per_unit, "margin": args.margin}
    settings = settings_of(name, given)
    args.seconds_per_unit, args.margin = settings["seconds_per_unit"], settings["margin"]
    return settings


def add_validate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``validate``."""
    add_problem_arguments(parser)
    parser.add_argument("plan", type=Path, metavar="PLAN.json")
    parser.set_defaults(run=_validate)


def _validate(args: argparse.Namespace) -> int:
    from up_samp.execution import dependency_faults
    from up_samp.io import contradictions, plan_from_dict
    from up_samp.io.compare import poses_beyond

    plan = read_plan(args.plan)
    problem = problem_of_plan(args.problem, args.encoding, plan)
    if not isinstance(problem, SchedulingMotionProblem):
        raise ProblemError(f"problem '{problem.name}' has no motions: it has no plan files")
    beyond = poses_beyond(problem, plan)
    wrong = [*contradictions(problem, plan), *beyond]
    if not wrong:
        wrong = dependency_faults(problem, plan)
    if wrong:
        print(f"INVALID: the plan file contradicts the problem in {len(wrong)} points")
        print("\n".join(f"  {short(w, 300)}" for w in wrong))
    if beyond:
        return 1
    try:
        verdict = judge(problem, plan_from_dict(problem, plan), plan["seconds_per_unit"])
    except ProblemError:
        if wrong:
            return 1  # said above
        raise
    if not wrong or not verdict.valid:
        print(describe(verdict))
    return 0 if verdict.valid and not wrong else 1


def add_draw(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``draw``."""
    parser.add_argument("plan", type=Path, metavar="PLAN.json")
    parser.add_argument("--out", type=Path, default=Path("."), metavar="DIR")
    parser.add_argument(
        "--gif", action=argparse.BooleanOptionalAction, default=False, help="an animated GIF too"
    )
    parser.set_defaults(run=_draw)


def _draw(args: argparse.Namespace) -> int:
    check_folder(args.out, "--out")
    files = write_outputs(read_plan(args.plan), args.out, gif=args.gif, plan_file=False)
    print("\n".join(str(f) for f in files))
    return 0


def add_engines(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``engines``."""
    parser.set_defaults(run=_engines)


def _engines(args: argparse.Namespace) -> int:
    factory = up.environment.get_environment().factory
    rows = []
    for name in sorted(factory.engines):
        engine = factory.engine(name)
        uses = _uses(engine)
        if uses:
            wrapped = f"samp-refine[{name}]"
            rows.append([name, uses, wrapped if wrapped in factory.engines else ""])
    print(table(("engine", "does", "with motions as"), rows))
    return 0


def _uses(engine: type[Engine]) -> str:
    """Return what an engine does with schedules, or "" if it does not know them."""
    kinds = [ProblemKind(("SCHEDULING",)), ProblemKind(("SAMP",))]
    known = [k for k in kinds if engine.supports(k)]
    if not known:
        return ""
    checks: list[tuple[str, Callable[[], bool]]] = [
        ("plan", engine.is_oneshot_planner),
        ("plan, better and better", engine.is_anytime_planner),
        ("validate", engine.is_plan_validator),
    ]
    what = [text for text, check in checks if check()]
    if what[:2] == ["plan", "plan, better and better"]:
        what = ["plan, also better and better", *what[2:]]
    return "; ".join(what)


def add_warmup(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``warmup``."""
    parser.set_defaults(run=_warmup)


def _warmup(args: argparse.Namespace) -> int:
    from up_samp.geometry import kernel_cache
    from up_samp.motion.compile import PARTS_FOR, missing, parts_for, precompile

    def report(ready: int, of: int) -> None:
        print(f"{ready} of {of} parts compiled", file=sys.stderr, flush=True)

    wanted = parts_for(PARTS_FOR)
    if missing(wanted) and not kernel_cache.can_write():
        return 1
    seconds = precompile(PARTS_FOR, report=report)
    left = missing(wanted)
    print(f"kernels are in {kernel_cache.folder()} ({seconds:.0f} s)")
    return 1 if left else 0
