"""Solve a problem, show what the search is doing, and the plan: what ``demo`` and ``solve`` have in
common.
"""

from __future__ import annotations

import argparse
import math
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from unified_planning.engines import PlanGenerationResult
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import OneshotPlanner

from up_samp.cli.options import DEFAULT, ONE_OF, Option, option
from up_samp.engines.factory import engine_named
from up_samp.io import PlanDict, result_to_dict, write_plan
from up_samp.model.errors import InterruptedSearch, in_words
from up_samp.model.objective import MinimizeCosts
from up_samp.plotting.tracks import tracks_of
from up_samp.search.params import PRESETS
from up_samp.system.files import check_folder, uninterrupted
from up_samp.upio.objective import shown
from up_samp.upio.plan import figures_told, words_told

if TYPE_CHECKING:
    from up_samp.search.knowledge import ProgressEvent
    from up_samp.validation import Verdict

LONGEST = 120.0
"""Seconds that a solve may take where no limit is given."""
DEFAULT_ENGINE = "cpsat"
"""The scheduler that the commands wrap unless told otherwise."""

# ------------------ What is shown


def table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> str:
    """Return aligned columns; the columns in ``right`` are aligned to the right."""
    widths = [max(len(str(r[i])) for r in (header, *rows)) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        parts = (
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )
        return "  ".join(parts).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([line(header), rule, *(line(r) for r in rows)])


def schedule_table(plan: dict[str, Any]) -> str:
    """Return the present activities of a plan: when, what, who moves, and for how long it drives.

    Times are in schedule units, driving in s.
    """
    driving = {
        (leg.activity, track.name): sum(b - a for a, b in leg.driving())
        for track in tracks_of(plan)
        for leg in track.legs
    }
    loads = {(ride["activity"], ride["object"]) for ride in plan.get("rides", ())}
    rows = []
    for entry in plan["activities"]:
        name = entry["name"]
        moved = [(o, s) for (a, o), s in driving.items() if a == name]
        driven = {o for o, _ in moved}
        changes = (c["object"] for c in plan["changes"] if c["activity"] == name)
        changed = [o for o in changes if o not in driven]
        parameters = ", ".join(f"{k}={v}" for k, v in entry.get("parameters", {}).items())
        rows.append(
            [
                str(entry["start"]),
                str(entry["end"]),
                str(entry["end"] - entry["start"]),
                in_words(name) + (f"({parameters})" if parameters else ""),
                in_words(", ".join([o for o, _ in moved] + changed)),
                ", ".join(f"{s:.1f} s" for o, s in moved if (name, o) not in loads),
            ]
        )
    header = ("start", "end", "length", "activity", "moves", "driving")
    return table(header, rows, right=(0, 1, 2, 5))


class Progress:
    """A progress display; call it with each event, and use it as a context to end the line. On a
    terminal, a line for each better plan stays.

    Elsewhere than on a terminal, a line is printed for the first event of each phase, when a bound
    moves, and otherwise at most every two seconds.
    """

    def __init__(self, stream: TextIO | None = None):
        self.stream = stream if stream is not None else sys.stderr
        self.live = self.stream.isatty()
        self._phases: set[str] = set()
        self._bounds = ""
        self._last_time = float("-inf")
        self._open = False

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._open:
            # the line has told what there was to tell: make room for the result
            self.stream.write("\r\x1b[2K")
            self.stream.flush()
            self._open = False

    def __call__(self, event: ProgressEvent) -> None:
        """Show an event."""
        line = _line_of(event)
        now = time.monotonic()
        if self.live:
            width = shutil.get_terminal_size().columns - 1
            kept = event.phase == "plan"  # a line for each better plan stays
            self.stream.write("\r\x1b[2K" + line[:width] + ("\n" if kept else ""))
            self.stream.flush()
            self._open = not kept
            return
        known = event.phase in self._phases and event.bounds == self._bounds
        if known and now - self._last_time < 2.0:
            return
        self._phases.add(event.phase)
        self._bounds, self._last_time = event.bounds, now
        print(line, file=self.stream, flush=True)


def _line_of(event: ProgressEvent) -> str:
    """Return an event as a line."""
    parts = [f"[{event.elapsed:6.1f} s]"]
    if event.round:
        parts.append(f"round {event.round}:")
    parts.append(event.phase)
    if event.message:
        parts.append(f"- {event.message}")
    if event.bounds:
        parts.append(f"({event.bounds})")
    return " ".join(parts)


# ------------------ Options, and the solve


def _seconds(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError("must be positive")
    return value


def solver_options(out: Path | None = None) -> tuple[Option, ...]:
    """Return the options that say how to solve, when to stop, and what to write."""
    return (
        option("--engine", "the scheduler to wrap: cpsat, aries, aries-opt, cpse ... (see 'up-samp "
               "engines'); or a whole name such as samp-refine[aries] (default: %(default)s)",
               "NAME", default=DEFAULT_ENGINE),
        option("--preset", "how to learn from failures", default="default",
               choices=sorted(PRESETS)),
        option("--optimal", "go on until the plan is proven optimal", group=ONE_OF,
               action="store_true"),
        option("--first", "stop at the first plan", group=ONE_OF, action="store_true"),
        option("--patience", "stop when so large a share of the time so far brought no better plan "
               "(default: 1; with --timeout: for ever)", "SHARE", float, group=ONE_OF),
        option("--relative", "call a plan optimal by the planner's own motions, however much "
               "shorter some may be", action="store_true"),
        option("--timeout", "seconds for the best plan that is found in them, at most: sooner "
               "where one is proven optimal or nothing is left to try, or by --patience (default: "
               "120)", "S", _seconds),
        option("--seed", None, "N", int, 0),
        option("--tuning", "numbers that decide how hard the solver tries (see the page on tuning)",
               "FILE.toml", Path),
        option("--seconds-per-unit", "length of a time unit (default: 1, or what the problem file "
               "says)", "S", _seconds),
        option("--margin", "clearance in m that motions keep from walls and from each other "
               "(default: 0.01, or what the problem file says)", "M", float),
        option("--out", "folder for plan.json and pictures" + (f" {DEFAULT}" if out else ""), "DIR",
               Path, out),
        option("--trace", "folder for every candidate schedule and what was learned from it, as "
               "text", "DIR", Path),
    )  # fmt: skip


def solve_and_show(
    problem: SchedulingProblem,
    args: argparse.Namespace,
    hint: Schedule | None = None,
    tell: Callable[[PlanDict], list[str]] = lambda _: [],
) -> int:
    """Solve, print the schedule and the validator's verdict, write files; return the exit code:
    0 with a valid plan, 1 without one. ``hint`` is a plan to begin from; ``tell`` returns what else
    there is to say of a plan.
    """
    for folder, name in ((args.out, "--out"), (args.trace, "--trace")):
        if folder is not None:
            check_folder(folder, name)
    started = time.monotonic()
    try:
        result = _solve(problem, args, hint)
    except InterruptedSearch as stop:
        _show(problem, args, stop.result, time.monotonic() - started, tell)
        raise
    return _show(problem, args, result, time.monotonic() - started, tell)


def _show(
    problem: SchedulingProblem,
    args: argparse.Namespace,
    result: PlanGenerationResult,
    seconds: float,
    tell: Callable[[PlanDict], list[str]],
) -> int:
    if result.plan is None:
        print(f"{problem.name}: no plan, {result.status.name} after {seconds:.1f} s")
        for text in words_told(result):
            print(f"  {text}")
        return 1
    with uninterrupted():  # first of all the file: whatever comes may fail
        plan = result_to_dict(problem, result)
        if args.out is not None:
            write_plan(args.out / "plan.json", plan)
    if args.out is not None:
        from up_samp.execution import shown_with_dependencies  # its kernels are slow to load

        plan, why = shown_with_dependencies(problem, plan)
        if why:
            print(why, file=sys.stderr)
    print(schedule_table(plan))
    print()
    print(_summary(plan, result, seconds))
    if any(isinstance(m, MinimizeCosts) for m in problem.quality_metrics):
        from up_samp.validation import terms_of

        costs = terms_of(problem, result.plan).items()
        print(f"it costs {', '.join(f'{shown(cost)} of {term}' for term, cost in costs)}")
    for text in (*words_told(result), *tell(plan)):
        print(text)
    verdict = judge(problem, result.plan, args.seconds_per_unit)
    print(describe(verdict))
    if args.out is not None:
        from up_samp.plotting import places_of, write_outputs  # matplotlib is slow

        files = write_outputs(plan, args.out, places=places_of(problem))
        print(f"written to {args.out}: {', '.join(f.name for f in files)}")
    return 0 if verdict.valid else 1


def _solve(
    problem: SchedulingProblem, args: argparse.Namespace, hint: Schedule | None
) -> PlanGenerationResult:
    name = args.engine if "[" in args.engine else f"samp-refine[{args.engine}]"
    engine_named(name)
    print(f"{problem.name}: {len(problem.activities)} activities, {name}", file=sys.stderr)
    with Progress() as progress:
        params: dict[str, Any] = {
            "preset": args.preset,
            "seed": args.seed,
            "seconds_per_unit": args.seconds_per_unit,
            "margin": args.margin,
            "progress": progress,
        }
        asked = {
            "optimal": args.optimal,
            "relative": args.relative,
            "first_plan": args.first,
            "trace": args.trace and str(args.trace),
            "tuning": args.tuning,
        }
        params |= {key: value for key, value in asked.items() if value}
        if args.patience is not None or args.timeout is not None:
            params["patience"] = math.inf if args.patience is None else args.patience
        with OneshotPlanner(name=name, params=params) as planner:
            begin = {} if hint is None else {"warm_start_plan": hint}
            return planner.solve(problem, timeout=args.timeout or LONGEST, **begin)


def judge(problem: SchedulingProblem, plan: Schedule, seconds_per_unit: float = 1.0) -> Verdict:
    """Return the independent validator's verdict."""
    from up_samp.validation import validate_plan, validate_schedule

    if isinstance(problem, SchedulingMotionProblem):
        return validate_plan(problem, plan, seconds_per_unit=seconds_per_unit)
    return validate_schedule(problem, plan)


def describe(verdict: Verdict) -> str:
    """Return a verdict as text: a line, and one more for each violation."""
    if verdict.valid:
        extra = "" if verdict.definition3 else "; not if effects are seen at once (Definition 3)"
        return f"valid: the independent validator found nothing wrong{extra}"
    lines = [f"INVALID: {len(verdict.violations)} violations"]
    lines += [f"  {v.kind}: {in_words(v.what)}" for v in verdict.violations]
    return "\n".join(lines)


def _summary(plan: dict[str, Any], result: PlanGenerationResult, seconds: float) -> str:
    metrics = figures_told(result)
    bound = ""
    if plan["lower_bound"]:
        kind = metrics.get("bound_kind")
        bound = f" (proven lower bound {plan['lower_bound']}{f', {kind}' if kind else ''})"
    worth = ""
    if "value" in metrics:
        least = metrics.get("value_bound", "-")
        least = "none" if least == "-" else shown(least)
        worth = f"{metrics['objective']} {shown(metrics['value'])} (proven bound {least}), "
    parts = [f"{plan['status']}: {worth}makespan {plan['makespan']}{bound}", f"{seconds:.1f} s"]
    if "rounds" in metrics:
        rounds = metrics["rounds"]
        parts.append(f"{rounds} round{'' if rounds == '1' else 's'}")
    return ", ".join(parts)
