"""The process of one job: reads a request from standard input, tells what happens line by line.

``python -m up_samp.server.worker [desk] BYTES``: ``BYTES`` limits its address space; with ``desk``
it answers short questions until nobody asks any more.
"""

from __future__ import annotations

import gc
import json
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from up_samp.fleet.fields import FILE_LIMITS
from up_samp.server.requests import (
    MAP_NAME,
    PlanRequest,
    ProblemUpload,
    RequestError,
    ValidateRequest,
    check_request,
    read_request,
    records_of,
)
from up_samp.system.child import limit_memory, peak_memory


class Teller:
    """Writes events to the server, one JSON object a line."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream
        # where the server keeps files is nobody's business
        self._here = re.compile(re.escape(json.dumps(str(Path.cwd()))[1:-1]) + r"[/\\]*")
        self._bounds: tuple[int | None, int | None] | None = None
        self._last = float("-inf")

    def tell(self, **event: Any) -> None:
        """Write one event."""
        self.stream.write(self._here.sub("", json.dumps(event, allow_nan=False)) + "\n")
        self.stream.flush()

    def tell_plan(self, plan: dict[str, Any]) -> None:
        """Write a plan: its event, and itself on the next line."""
        about = {key: plan[key] for key in ("makespan", "seconds_per_unit")}
        self.tell(event="plan", **about)
        self.tell(**plan)

    def progress(self, event: Any) -> None:
        """Tell a step of the search (:class:`up_samp.search.knowledge.ProgressEvent`)."""
        bounds = (event.lower_bound, event.upper_bound)
        now = time.monotonic()
        if bounds == self._bounds and now - self._last < 0.2:  # s, unless a bound moves
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


def read_problem(request: ProblemUpload) -> tuple[Any, dict[str, float]]:
    """Return a request's UP problem and settings; its map is written into the current folder."""
    from up_samp.fleet.build import write_problem

    records = records_of(request)
    request.map.write(Path(), MAP_NAME)
    return write_problem(records, Path.cwd()).problem, records.settings


def solve(request: PlanRequest, timeout: float, teller: Teller) -> None:
    """Solve the request's problem and tell each better plan, and the end."""
    from unified_planning.shortcuts import AnytimePlanner, get_environment

    import up_samp  # noqa: F401  (registers the engines)

    get_environment().credits_stream = None
    problem, settings = read_problem(request)
    teller.tell(event="progress", phase="read", message=f"{len(problem.activities)} activities")
    params = {
        "seed": request.seed,
        **settings,
        "progress": teller.progress,
        "first_plan": request.first_plan,
    }
    name = f"samp-refine[{request.engine}]"
    with AnytimePlanner(name=name, params=params) as planner:
        for result in planner.get_solutions(problem, timeout=timeout):
            enough = request.first_plan and result.plan is not None
            tell_result(problem, result, teller, last=enough)
            if enough:
                break


def tell_result(problem: Any, result: Any, teller: Teller, *, last: bool) -> None:
    """Tell a plan, if there is one, and the end, if it is the engine's last or enough."""
    from up_samp.execution import shown_with_dependencies
    from up_samp.io import result_to_dict
    from up_samp.upio.plan import figures_told, words_told

    said, metrics = words_told(result), figures_told(result)
    if result.plan is not None:
        plan, why = shown_with_dependencies(problem, result_to_dict(problem, result))
        said += [why] if why else []
        plan["map"] = {"yaml": None}  # the server's own files are nobody's business
        teller.tell_plan(plan)
    between = result.status.name == "INTERMEDIATE"
    teller.tell(
        event="progress" if between and not last else "end",
        status="SOLVED_SATISFICING" if between else result.status.name,
        message="; ".join(said),
        lower_bound=int(metrics["lower_bound"]) if "lower_bound" in metrics else None,
        bound_kind=metrics.get("bound_kind"),
    )


def judge(request: ValidateRequest, teller: Teller) -> None:
    """Judge the request's plan and tell the verdict."""
    from up_samp.io import plan_from_dict
    from up_samp.io.files import check_plan
    from up_samp.model import ProblemError
    from up_samp.validation import validate_plan

    problem, settings = read_problem(request)
    unit = settings["seconds_per_unit"]
    plan = {**request.plan, "map": {"yaml": str(Path.cwd() / MAP_NAME)}}
    check_plan(plan, "the plan")
    if plan["seconds_per_unit"] != unit:
        raise ProblemError(f"the plan's unit is {plan['seconds_per_unit']} s, the problem's {unit}")
    verdict = validate_plan(problem, plan_from_dict(problem, plan), seconds_per_unit=unit)
    found = [str(v) for v in verdict.violations]
    teller.tell(event="end", status="JUDGED", valid=verdict.valid, violations=found, message="")


def do_job(teller: Teller) -> int:
    """Do one job; an error is the job's ending, told in one line."""
    try:
        head = json.loads(sys.stdin.buffer.readline())
        request = read_request(head["kind"], sys.stdin.buffer.read())
        if isinstance(request, PlanRequest):
            solve(request, head["timeout"], teller)
        elif isinstance(request, ValidateRequest):
            judge(request, teller)
    except Exception as error:
        from up_samp.model import SampError

        known = isinstance(error, SampError | ValueError | RequestError)
        what = str(error) if known else f"internal error, {type(error).__name__}: {error}"
        teller.tell(event="end", status="ERROR", message=" ".join(what.split())[:2000])
        return 1
    return 0


def look(kind: str, body: bytes) -> tuple[dict[str, Any], bytes]:
    """Say what is wrong with a request, and how long its search may take."""
    try:
        request = check_request(kind, body)
    except RequestError as error:
        return {"faults": error.faults[: FILE_LIMITS.shown]}, b""
    return {"faults": [], "timeout": getattr(request, "timeout", None)}, b""


def draw(body: bytes, plan: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the page that plays a plan, on the map of its request."""
    from up_samp.plotting.animation import animation_html

    read_request("plan", body).map.write(Path(), MAP_NAME)
    shown = {**json.loads(plan), "map": {"yaml": str(Path.cwd() / MAP_NAME)}}
    return {}, animation_html(shown).encode()


DESK: dict[str, Callable[..., tuple[dict[str, Any], bytes]]] = {
    "plan": lambda body: look("plan", body),
    "validate": lambda body: look("validate", body),
    "draw": draw,
}
"""What is answered at the desk (:class:`up_samp.server.jobs.Desk`)."""


def answer_all(teller: Teller) -> int:
    """Answer questions until nobody asks any more, or this process has grown large."""
    source = sys.stdin.buffer
    gc.disable()  # what is read holds no circles, and to look for some is nine tenths of the time
    while line := source.readline():
        head = json.loads(line)
        parts = [source.read(size) for size in head["sizes"]]
        try:
            said, body = DESK[head["kind"]](*parts)
        except MemoryError:
            return 1
        except Exception as error:
            text = f"internal error, {type(error).__name__}: {error}"[:500]
            said, body = {"faults": [{"loc": ["body"], "msg": text, "type": "internal"}]}, b""
        last = (peak_memory() or 0.0) > _LARGE
        teller.tell(**said, size=len(body), last=last)
        teller.stream.buffer.write(body)
        teller.stream.buffer.flush()
        if last:
            return 0
    return 0


_LARGE = 512.0
"""MiB: a process at the desk that has held so much says that its answer is its last, and ends."""


def main() -> int:
    """Do one job, or serve at the desk."""
    *desk, most = sys.argv[1:]
    limit_memory(int(most))
    # whatever libraries print must not get between the lines of the protocol
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    teller = Teller(channel)
    return answer_all(teller) if desk else do_job(teller)


if __name__ == "__main__":
    sys.exit(main())
