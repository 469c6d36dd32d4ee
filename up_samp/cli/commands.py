"""The commands that plan, judge, draw, check, export, serve and compile, with their arguments."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import unified_planning as up
from unified_planning.engines import Engine
from unified_planning.model import ProblemKind
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.cli.options import DEFAULT, OUT, PLAN, PROBLEM, Command, encoding, option
from up_samp.cli.problems import find_problem, fleet_of, problem_of_plan, settle
from up_samp.cli.solving import describe, judge, solve_and_show, solver_options, table
from up_samp.execution import Surprise, dependency_faults, remaining_at
from up_samp.execution.files import check_motions, refuse
from up_samp.export import FORMATS, export_plan
from up_samp.io import contradictions, plan_from_dict, read_plan
from up_samp.io.plan_dict import AREA
from up_samp.io.restore import poses_beyond
from up_samp.model import ProblemError
from up_samp.model.errors import short
from up_samp.system.files import check_folder
from up_samp.system.imports import extra


def _serve(args: argparse.Namespace) -> int:
    with extra("the service", "server", "fastapi uvicorn"):
        import uvicorn

        from up_samp.server.app import create_app
        from up_samp.server.jobs import JobLimits, JobQueue
    limits = JobLimits(
        running=args.jobs,
        waiting=args.queue,
        seconds=args.timeout,
        memory=round(args.memory * 2**30),
    )
    with JobQueue(limits) as jobs:
        print(f"up-samp serves at http://{args.host}:{args.port}/", flush=True)
        uvicorn.run(
            create_app(jobs, {args.host, *args.allow_host}),
            host=args.host,
            port=args.port,
            log_level="warning",
            limit_concurrency=limits.connections,
        )
    return 0


# ------------------ ``up-samp export``: a plan file in other people's formats


def _export(args: argparse.Namespace) -> int:
    plan = read_plan(args.plan)
    if args.problem is not None:
        refuse(dependency_faults(problem_of_plan(args.problem, args.encoding, plan), plan), plan)
        fleet = fleet_of(args.problem, {"seconds_per_unit": plan["seconds_per_unit"]})
        plan |= {} if fleet is None else {"words": fleet.words()}
    files = export_plan(plan, args.to, args.out)
    print("\n".join(str(f) for f in files))
    return 0


# ------------------ The commands for problem files: ``new`` and ``check``


def _new(args: argparse.Namespace) -> int:
    from up_samp.fleet.files import write_starter

    files = write_starter(args.folder)
    print("\n".join(str(f) for f in files))
    print(f"next: up-samp check {files[0]}")
    return 0


def _check(args: argparse.Namespace) -> int:
    """Return 0 where nothing is wrong, 1 where something is."""
    from up_samp.fleet import read_problem_file
    from up_samp.fleet.checks import Level, check_fleet
    from up_samp.fleet.picture import draw_fleet
    from up_samp.fleet.spelled_out import counted, in_numbers
    from up_samp.plotting.style import save_figure

    records, folder = read_problem_file(args.problem), args.problem.parent
    findings = check_fleet(records, folder)
    for finding in findings:
        print(finding)
    picture = args.out or args.problem.with_suffix(".check.png")
    save_figure(draw_fleet(records, folder, findings), picture)
    errors = sum(f.level is Level.ERROR for f in findings)
    warnings = sum(f.level is Level.WARNING for f in findings)
    wrong = f"{counted(errors, 'error')}, {counted(warnings, 'warning')}"
    print(f"{in_numbers(records)}: {wrong}; see {picture}")
    return 1 if errors else 0


def _import(args: argparse.Namespace) -> int:
    from up_samp.fleet.importers import Options, import_file

    file = args.out / "problem.yaml"
    if file.exists():
        raise ProblemError(f"'{file}' is there already; name another folder")
    options = Options(args.cell, args.map, args.robots, args.jobs)
    found = import_file(args.source, args.out, args.kind, options)
    for note in found.notes:
        print(note)
    print(f"written: {found.problem}\nnext: up-samp check {found.problem}")
    return 0


# ------------------ The commands that plan


def _demo(args: argparse.Namespace) -> int:
    from up_samp.benchmarks import logistics

    problem = logistics(
        robots=args.robots,
        items=args.items,
        door=args.door,
        sides=args.sides,
        encoding=args.encoding,
    )
    settle(None, args)
    return solve_and_show(problem, args)


def _solve(args: argparse.Namespace) -> int:
    if args.plan is not None:
        return _go_on(args)
    for name, given in (("--at", args.at), ("--broken", args.broken), ("--cancel", args.cancel)):
        if given is not None:
            raise ProblemError(f"{name} speaks of a plan: name it with --from PLAN.json")
    fleet = fleet_of(args.problem, {})
    settings = settle(fleet, args)
    if fleet is None:
        return solve_and_show(find_problem(args.problem, args.encoding, settings), args)
    fleet = fleet.with_settings(**settings)
    code = solve_and_show(fleet.problem, args, tell=fleet.tell)
    for finding in fleet.check() if code else ():
        print(f"  {finding}")
    return code


def _go_on(args: argparse.Namespace) -> int:
    """Plan what is left of a plan, and say where everybody stands then."""
    if args.at is None:
        raise ProblemError("--from needs a time: --at S, in seconds since the plan's start")
    if not 0 <= args.at < math.inf:
        raise ProblemError(f"--at {args.at:g}: give seconds since the plan's start, 0 or more")
    if args.seconds_per_unit is not None or args.margin is not None:
        raise ProblemError("the rest of a plan keeps the plan's unit of time and its margin")
    plan = read_plan(args.plan)
    check_motions(plan)
    problem = problem_of_plan(args.problem, args.encoding, plan)
    surprise = Surprise(cancelled=tuple(args.cancel or ()))
    left = remaining_at(problem, plan, args.at, surprise, args.broken or ())
    args.seconds_per_unit, args.margin = float(plan["seconds_per_unit"]), plan.get("margin")
    settle(fleet_of(args.problem, {}), args)
    since = left.since * args.seconds_per_unit
    print(f"what is left of {args.plan}: 0 is {since:g} s of its clock", file=sys.stderr)
    things = {n: p for n, p in left.poses.items() if left.problem.object(n).type.name != AREA}
    for name, pose in things.items():
        print(f"  {name} at ({', '.join(f'{v:.2f}' for v in pose)})", file=sys.stderr)
    for note in left.notes:
        print(f"  {note}", file=sys.stderr)
    return solve_and_show(left.problem, args, left.hint)


def _validate(args: argparse.Namespace) -> int:
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


def _draw(args: argparse.Namespace) -> int:
    from up_samp.plotting import write_outputs  # matplotlib is slow

    check_folder(args.out, "--out")
    files = write_outputs(read_plan(args.plan), args.out, plan_file=False)
    print("\n".join(str(f) for f in files))
    return 0


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
    kinds = ProblemKind(("SCHEDULING",)), ProblemKind(("SAMP",))
    if not any(map(engine.supports, kinds)):
        return ""
    also = "also " if engine.is_oneshot_planner() else ""
    checks = {
        f"plan, {also}better and better": engine.is_anytime_planner(),
        "plan": engine.is_oneshot_planner() and not engine.is_anytime_planner(),
        "validate": engine.is_plan_validator(),
    }
    return "; ".join(text for text, does in checks.items() if does)


def _warmup(args: argparse.Namespace) -> int:
    from up_samp.geometry import kernel_cache
    from up_samp.model import MotionModel
    from up_samp.motion.compile import missing, parts_for, precompile

    def report(ready: int, of: int) -> None:
        print(f"{ready} of {of} parts compiled", file=sys.stderr, flush=True)

    wanted = parts_for(MotionModel)
    if missing(wanted) and not kernel_cache.can_write():
        return 1
    seconds = precompile(MotionModel, report=report)
    left = missing(wanted)
    print(f"kernels are in {kernel_cache.folder()} ({seconds:.0f} s)")
    return 1 if left else 0


_LEFT = "going on from a plan of the problem"
COMMANDS: dict[str, Command] = {
    "demo": (_demo, (
        option("--robots", "(default: 2)", "N", int, 2),
        option("--items", "(default: 4)", "N", int, 4),
        option("--door", default="closed", choices=("closed", "open")),
        option("--sides", default="corridor", choices=("all", "corridor")),
        encoding(),
        *solver_options(Path("demo-out")),
    )),
    "new": (_new, (option("folder", None, "DIR", Path),)),
    "check": (_check, (
        option("problem", None, "PROBLEM.yaml", Path),
        option("--out", "the picture (default: beside the problem file)", "FILE.png", Path),
    )),
    "import": (_import, (
        option("source", None, "FILE", Path),
        option("--out", None, "DIR", Path, required=True),
        option("--kind", "what it is, where its name does not tell"),
        option("--cell --metres-per-unit", "a cell, or a unit of a drawing, in m", "M", float, 1.0),
        option("--map", "for LIF", "MAP.yaml", Path),
        option("--robots", "take so many at most", "N", int, 2),
        option("--jobs", "take so many at most", "N", int, 4),
    )),
    "solve": (_solve, (
        *PROBLEM,
        *solver_options(),
        option("--from", "plan what is left of it anew; its clock begins when robots under way "
               "have stopped", "PLAN.json", Path, group=_LEFT, dest="plan"),
        option("--at", "seconds since its start, carried out without delays so far", "S", float,
               group=_LEFT),
        option("--broken", "it is out of order where it is then", "ROBOT", group=_LEFT,
               action="append"),
        option("--cancel", "not begun by then", "ACTIVITY", group=_LEFT, action="append"),
    )),
    "validate": (_validate, (*PROBLEM, PLAN)),
    "draw": (_draw, (PLAN, OUT)),
    "export": (_export, (
        PLAN,
        option("--to", choices=tuple(FORMATS), required=True),
        OUT,
        option("--problem", "the plan's problem, as for 'up-samp solve': the plan's graph is "
               "checked against it, and orders have its words for places and actions", "PROBLEM"),
        encoding(),
    )),
    "serve": (_serve, (
        option("--host", DEFAULT, default="127.0.0.1"),
        option("--port", "(default: 8008)", "N", int, 8008),
        option("--jobs", "jobs at the same time", "N", int, 1),
        option("--queue", "jobs that may wait", "N", int, 8),
        option("--timeout", "longest search, in seconds", "S", float, 600.0),
        option("--memory", "address space of a job", "GIB", float, 6.0),
        option("--allow-host", "answer requests to this name, too (else: localhost, and what "
               "--host names)", "NAME", default=[], action="append"),
    )),
    "engines": (_engines, ()),
    "warmup": (_warmup, ()),
}  # fmt: skip
