"""Solve a random problem, judge what comes back, and try to refute every proof."""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from unittest import mock

import psutil
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.fuzz.cases import Case, Style, limited
from tests.fuzz.problems import SECONDS, build
from tests.oracles.clocks import Watch
from up_samp.cli import commands, main
from up_samp.io import result_to_dict, write_plan
from up_samp.model import SampError
from up_samp.validation import validate_plan

get_environment().credits_stream = None
PROVEN = (Status.SOLVED_OPTIMALLY, Status.UNSOLVABLE_PROVEN)
DOUBTED = {"doubted": 10**6}
"""Whatever rests on what was recognised is doubted, however large the problem."""
SLACK = 2.0
"""Seconds that a run may take beyond its limit, waiting for a processor not counted."""


@dataclass(frozen=True)
class Attacker:
    """Who is asked for a plan that a proof rules out: an engine with parameters, a ``style`` that
    says the same otherwise (None: the case's own), and seconds (None: as many as the proof had).
    """

    engine: str
    params: Mapping[str, object]
    style: Style | None = None
    timeout: float | None = None

    def told(self) -> str:
        """Its name in tables."""
        said = ", ".join(f"{k}={v}" for k, v in self.params.items())
        return f"{self.engine}({said})" + ", another style" * (self.style is not None)


@dataclass
class Findings:
    """What came of one problem. ``wrong`` has a line for each thing that must not be."""

    seed: int
    engine: str
    status: str = ""
    kind: str = ""
    makespan: int | None = None
    seconds: float = 0.0
    overrun: float = 0.0
    attacks: int = 0
    wrong: list[str] = field(default_factory=list)
    faster: list[str] = field(default_factory=list)
    """Relative proofs that motions of another seed, or not of the paper's planner, beat."""
    counts: Counter = field(default_factory=Counter)
    preset: str = "default"
    accepted: int = 0
    """Plans that the validator and ``up-samp validate`` accept."""
    refused: str = ""
    """What the package says that it cannot do, or that is wrong with the problem."""


def attack(
    case: Case, folder: Path, *, engine="cpsat", timeout=10.0, attackers=None, preset="default"
) -> Findings:
    """Solve ``case`` and attack the answer with each of the ``attackers``."""
    found = Findings(case.seed, engine, preset=preset)
    before = _state()
    result = _solve(case, folder, engine, timeout, found, optimal=True, preset=preset)
    if result is not None:
        found.status = result.status.name
        found.kind = (result.metrics or {}).get("bound_kind", "").partition(" ")[0]
        _judge(case, folder, result, found)
        harder, told = _claim(case, result, found)
        attackers = ATTACKERS if attackers is None else attackers
        if told:
            several = result.status in PROVEN
            _refute(harder, told, folder, found, timeout, attackers if several else attackers[:1])
    if found.overrun > SLACK:
        found.wrong.append(f"late by {found.overrun:.1f} s")
    _leftovers(before, found)
    return found


ATTACKERS = (
    Attacker("cpsat", {"query_seconds": 4.0}),
    Attacker("cpsat", {"without": ("bounds_first", "certificates")}),
    Attacker("aries", {}),
    Attacker("cpsat", {"seed": 7, "query_seconds": 4.0}),
)
"""Other engines, knowledge and seeds, each asked for any plan at all that the proof rules out.

A relative proof speaks of the motions that the planner finds with its seed. Where another seed
finds faster ones the claim stands, but the planner could do better: ``faster`` counts these.
"""


def _solve(case, folder, engine, timeout, found, *, optimal, **params):
    problem = build(case, folder)
    settings = {"seconds_per_unit": SECONDS, "query_seconds": 1.0, "tuning": DOUBTED} | params
    guarantee = OptimalityGuarantee.SOLVED_OPTIMALLY
    proves = engine in ("cpsat", "aries-opt")
    watch = Watch()
    try:
        with OneshotPlanner(
            name=f"samp-refine[{engine}]",
            params=settings if proves and optimal else settings | {"first_plan": True},
            **({"optimality_guarantee": guarantee} if proves and optimal else {}),
        ) as planner:
            result = planner.solve(problem, timeout=timeout)
    except SampError as error:
        found.refused = f"{type(error).__name__}: {error}"
        return None
    except Exception as error:
        found.wrong.append(f"{engine}: exception {type(error).__name__}: {error}")
        return None
    found.seconds += watch.seconds
    found.overrun = max(found.overrun, watch.own - timeout)
    return result


def _judge(case: Case, folder: Path, result, found: Findings) -> None:
    if result.status is Status.INTERNAL_ERROR:
        said = "; ".join(m.message for m in result.log_messages or [])
        found.wrong.append(f"internal error: {said}")
    if (result.metrics or {}).get("refuted"):
        found.wrong.append(result.metrics["refuted"])
    if result.plan is None:
        return
    found.makespan = int(result.metrics["makespan"])
    _is_valid(case, folder, result, found)


def _is_valid(case: Case, folder: Path, result, found: Findings) -> bool:
    """Return whether the validator accepts a plan; the command has to say the same of its file."""
    problem = build(case, folder)
    verdict = validate_plan(problem, result.plan, seconds_per_unit=SECONDS)
    said = refusal_of_command(problem, result, folder)
    if not verdict.valid:
        found.wrong.append(f"invalid plan: {verdict.violations[0]}")
    elif said:
        found.wrong.append(f"up-samp validate refuses a good plan: {said}")
    else:
        found.accepted += 1
    return verdict.valid


def refusal_of_command(problem, result, folder: Path) -> str:
    """Return what ``up-samp validate`` says against a result's plan file, "" if it is accepted."""
    file = write_plan(folder / "plan.json", result_to_dict(problem, result))
    said = io.StringIO()
    with (
        mock.patch.object(commands, "problem_of_plan", return_value=problem),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        code = main(["validate", "problem.py", str(file)])
    return "" if code == 0 else said.getvalue() or f"exit code {code}"


def _claim(case: Case, result, found: Findings) -> tuple[Case, str]:
    """Return a problem without any plan if the result is right, and its claim ("": none)."""
    told = f"{result.status.name} {found.makespan}"
    bound = int((result.metrics or {}).get("lower_bound", 0))
    if result.status is Status.UNSOLVABLE_PROVEN:
        return case, told
    if result.status is Status.SOLVED_OPTIMALLY:
        return limited(case, found.makespan - 1), told
    return (limited(case, bound - 1), f"bound {bound}") if bound > 0 else (case, "")


def _refute(harder: Case, told: str, folder, found: Findings, timeout, attackers) -> None:
    """Ask others for a plan that cannot be, as is told."""
    for one in attackers:
        found.attacks += 1
        said = replace(harder, style=one.style) if one.style else harder
        limit = one.timeout or timeout
        params = dict(one.params)
        other = _solve(said, folder, one.engine, limit, found, optimal=False, **params)
        if other is None or other.plan is None:
            continue
        if _is_valid(said, folder, other, found):
            beaten = f"{told} ({found.kind}): {one} has {other.metrics['makespan']}"
            other_motions = "seed" in one.params or found.preset == "paper"
            relative = found.kind == "relative" and other_motions
            (found.faster if relative else found.wrong).append(beaten)


def _state() -> tuple[set[int], set[str]]:
    children = {p.pid for p in psutil.Process().children(recursive=True)}
    return children, set(os.listdir(tempfile.gettempdir()))


def _leftovers(before, found: Findings) -> None:
    processes, files = _state()
    gone = time.monotonic() + 60.0
    while processes - before[0] and time.monotonic() < gone:
        time.sleep(0.05)
        processes, files = _state()
    if processes - before[0]:
        found.wrong.append(f"processes left behind: {sorted(processes - before[0])}")
    left = {f for f in files - before[1] if "samp" in f or "aries" in f}
    if left:
        found.wrong.append(f"files left behind: {sorted(left)}")
