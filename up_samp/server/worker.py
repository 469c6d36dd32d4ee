"""The process of one job: reads a request from standard input, tells what happens line by line.

``python -m up_samp.server.worker BYTES``: ``BYTES`` limits its address space.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any, TextIO

from up_samp.server.requests import MAP_NAME, MapUpload

QUIET_SECONDS = 0.2
"""Progress is told so often at most, unless a bound moves."""


class Teller:
    """Writes events to the server, one JSON object a line."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._bounds: tuple[int | None, int | None] | None = None
        self._last = float("-inf")

    def tell(self, **event: Any) -> None:
        """Write one event."""
        self._stream.write(json.dumps(event, allow_nan=False) + "\n")
        self._stream.flush()

    def progress(self, event: Any) -> None:
        """Tell a step of the search (:class:`up_samp.search.history.ProgressEvent`)."""
        bounds = (event.lower_bound, event.upper_bound)
        now = time.monotonic()
        if bounds == self._bounds and now - self._last < QUIET_SECONDS:
            return
        self._bounds, self._last = bounds, now
        self.tell(
            event="progress",
            phase=event.phase,
            message=event.message,
            lower_bound=event.lower_bound,
            upper_bound=event.upper_bound,
            elapsed=round(event.elapsed, 3),
        )


def read_problem(
    problem: dict[str, Any], map_upload: dict[str, Any]
) -> tuple[Any, dict[str, float]]:
    """Return the UP problem of a request and its settings; its files are written into the current
    folder.
    """
    from up_samp.fleet.build import build_problem
    from up_samp.fleet.files import read_problem_file

    folder = Path.cwd()
    MapUpload(**map_upload).write(folder, MAP_NAME)
    file = folder / "problem.json"
    file.write_text(json.dumps({**problem, "map": MAP_NAME}), encoding="utf-8")
    records = read_problem_file(file)
    return build_problem(records, folder), records.settings


def solve(request: dict[str, Any], teller: Teller) -> None:
    """Solve the request's problem and tell each better plan, and the end."""
    from unified_planning.shortcuts import AnytimePlanner, get_environment

    import up_samp  # noqa: F401  (registers the engines)

    get_environment().credits_stream = None
    problem, settings = read_problem(request["problem"], request["map"])
    teller.tell(event="progress", phase="read", message=f"{len(problem.activities)} activities")
    params = {
        "seed": request["seed"],
        **settings,
        "progress": teller.progress,
        "optimal": not request["first_plan"],
    }
    name = f"samp-refine[{request['engine']}]"
    with AnytimePlanner(name=name, params=params) as planner:
        for result in planner.get_solutions(problem, timeout=request["timeout"]):
            enough = request["first_plan"] and result.plan is not None
            tell_result(problem, result, teller, last=enough)
            if enough:
                break


def tell_result(problem: Any, result: Any, teller: Teller, *, last: bool) -> None:
    """Tell a plan, if there is one, and the end, if it is the engine's last or enough."""
    from up_samp.execution import with_dependencies
    from up_samp.io import result_to_dict

    if result.plan is not None:
        plan = with_dependencies(problem, result_to_dict(problem, result))
        plan["map"] = {"yaml": None}  # the server's own files are nobody's business
        teller.tell(event="plan", plan=plan)
    metrics = result.metrics or {}
    between = result.status.name == "INTERMEDIATE"
    teller.tell(
        event="progress" if between and not last else "end",
        status="SOLVED_SATISFICING" if between else result.status.name,
        message="; ".join(m.message for m in result.log_messages or []),
        lower_bound=int(metrics["lower_bound"]) if "lower_bound" in metrics else None,
    )


def judge(request: dict[str, Any], teller: Teller) -> None:
    """Judge the request's plan and tell the verdict."""
    from up_samp.io import plan_from_dict
    from up_samp.io.files import check_plan
    from up_samp.model import ProblemError
    from up_samp.validation import validate_plan

    problem, settings = read_problem(request["problem"], request["map"])
    unit = settings["seconds_per_unit"]
    plan = {**request["plan"], "map": {"yaml": str(Path.cwd() / MAP_NAME)}}
    check_plan(plan, "the plan")
    if plan["seconds_per_unit"] != unit:
        raise ProblemError(f"the plan's unit is {plan['seconds_per_unit']} s, the problem's {unit}")
    verdict = validate_plan(problem, plan_from_dict(problem, plan), seconds_per_unit=unit)
    found = [str(v) for v in verdict.violations]
    teller.tell(event="end", status="JUDGED", valid=verdict.valid, violations=found, message="")


def limit_memory(size: int) -> None:
    """Limit this process's address space, where the system can."""
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    resource.setrlimit(resource.RLIMIT_AS, (size, size))


def main() -> int:
    """Do one job; an error is the job's ending, told in one line."""
    limit_memory(int(sys.argv[1]))
    # whatever libraries print must not get between the lines of the protocol
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    teller = Teller(channel)
    request = json.loads(sys.stdin.buffer.read())
    try:
        if "plan" in request:
            judge(request, teller)
        else:
            solve(request, teller)
    except Exception as error:
        from up_samp.model import SampError

        known = isinstance(error, SampError | ValueError)
        what = str(error) if known else f"internal error, {type(error).__name__}: {error}"
        teller.tell(event="end", status="ERROR", message=" ".join(what.split())[:2000])
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
