"""Solve a world with all learning on, and look for anything that the coarse model contradicts."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.soundness.coarse import Coarse, makespan_of
from tests.soundness.worlds import SECONDS, build
from up_samp.model import CandidateSchedule, Deadline
from up_samp.model.refinement import Clause, Elsewhere, Refinement, Strength
from up_samp.upio import build_plan, relax, write_refinement
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_plan, validate_schedule

get_environment().credits_stream = None
HORIZON = 7
"""Units up to which an unsolvable world is searched."""


@dataclass
class Findings:
    """What came of one world. ``wrong`` has a line for each discrepancy."""

    seed: int
    status: str = ""
    makespan: int | None = None
    best: int | None = None
    """Makespan of the best plan that the coarse search knows and the search missed."""
    wrong: list[str] = field(default_factory=list)
    kinds: dict[str, int] = field(default_factory=dict)
    plans: int = 0
    """Plans of the coarse search that the refinements were held against."""
    unfinished: str = ""
    """Why the coarse search is not complete, if it is not."""
    motion: list[str] = field(default_factory=list)
    """Trajectories of the motion layer that the validator rejects."""
    relative: list[str] = field(default_factory=list)
    """Relative refinements that some plan of the coarse search breaks."""
    costly: list[str] = field(default_factory=list)
    """Relative refinements that a better plan than the search's breaks."""
    seconds: tuple[float, float] = (0.0, 0.0)


def judge(world, map_file, *, samples: int = 25, seconds: float = 20.0, **params) -> Findings:
    """Solve ``world`` and hold the answer against the coarse search."""
    began = time.monotonic()
    problem = build(world, map_file)
    result = solve(problem, **params)
    found = Findings(world.seed, result.status.name)
    found.kinds = result.history.by_kind()
    solved = time.monotonic()
    coarse = Coarse(world, build(world, map_file))
    plans: list = []
    if result.plan is None:
        _judge_refusal(coarse, result, found, plans, seconds)
    else:
        _judge_plan(problem, coarse, result, found, plans, seconds)
    horizon = (found.makespan or HORIZON - 1) + 1
    plans += coarse.sample(horizon, samples, seconds)
    found.plans = len(plans)
    _judge_cuts(coarse, result.history.refinements, found, plans)
    found.seconds = (solved - began, time.monotonic() - solved)
    return found


def solve(problem, *, timeout=20.0, **params):
    settings = {"seconds_per_unit": SECONDS, "query_seconds": 1.0} | params
    with OneshotPlanner(
        name="samp-refine[cpsat]",
        params=settings,
        optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY,
    ) as planner:
        return planner.solve(problem, timeout=timeout)


def _judge_refusal(coarse, result, found, plans, seconds) -> None:
    if result.status is Status.INTERNAL_ERROR:
        found.wrong.append(f"internal error: {[m.message for m in result.log_messages]}")
    better = _better(coarse, HORIZON + 1, found, seconds)
    if better is None:
        return
    plans.append(better)
    found.best = makespan_of(better[0])
    if result.status is Status.UNSOLVABLE_PROVEN:
        found.wrong.append(f"called unsolvable, but there is {better[0]}")


def _judge_plan(problem, coarse, result, found, plans, seconds) -> None:
    verdict = validate_plan(problem, result.plan, seconds_per_unit=SECONDS)
    if not verdict.valid:
        found.wrong.append(f"invalid plan: {verdict.violations[0]}")
    found.makespan = int(result.metrics["makespan"])
    better = _better(coarse, found.makespan, found, seconds)
    if better is None:
        return
    plans.append(better)
    found.best = makespan_of(better[0])
    if result.status is Status.SOLVED_OPTIMALLY:
        kind = result.metrics["bound_kind"]
        found.wrong.append(f"{found.makespan} called optimal ({kind}), but there is {better[0]}")


def _better(coarse, makespan, found, seconds):
    """Return a better plan that the independent validator accepts too."""
    try:
        better = coarse.better_than(makespan, Deadline.after(seconds))
    except TimeoutError as error:
        found.unfinished = str(error)
        return None
    if better is not None:
        plan = build_plan(coarse.problem, coarse.snapshot, CandidateSchedule(better[0]), better[1])
        verdict = validate_plan(coarse.problem, plan, seconds_per_unit=SECONDS)
        if not verdict.valid:
            found.motion.append(f"{better[0]}: {verdict.violations[0]}")
            return None
    return better


def _judge_cuts(coarse, refinements: list[Refinement], found: Findings, plans: list) -> None:
    """No plan breaks what is proven, neither as it is meant nor as it is written for UP."""
    proven = [r for r in refinements if r.strength is Strength.PROVEN]
    relative = [r for r in refinements if r.strength is Strength.RELATIVE]
    bare = relax(coarse.problem, coarse.snapshot)
    written = [(r, _written(coarse, r)) for r in proven]
    for times, _ in plans:
        schedule, places = CandidateSchedule(times), coarse.places(times)
        said = validate_schedule(bare.problem, build_schedule(bare.problem, schedule))
        if not said.valid:
            found.wrong.append(f"the relaxation forbids {times}: {said.violations[0]}")
            continue
        for refinement, relaxation in written:
            if not refinement.statement.holds(schedule, places):
                found.wrong.append(f"broken by {times}: {refinement}")
            elif not _admits(relaxation, schedule, refinement, places):
                found.wrong.append(f"as written, broken by {times}: {refinement}")
        for refinement in relative:
            if not refinement.statement.holds(schedule, places):
                found.relative.append(f"{times} breaks {refinement}")
                if found.makespan is None or makespan_of(times) < found.makespan:
                    found.costly.append(f"{times} breaks {refinement}")


def _written(coarse, refinement):
    relaxation = relax(coarse.problem, coarse.snapshot)
    write_refinement(relaxation, refinement)
    return relaxation


def _admits(relaxation, schedule, refinement, places) -> bool:
    """Return whether the UP problem with a refinement has the schedule, auxiliaries chosen well."""
    times = dict(schedule.times)
    if isinstance(refinement.statement, Clause):
        for literal in refinement.statement.literals:
            if isinstance(literal, Elsewhere):
                twin = relaxation.literals[literal].presence().container
                if literal.holds(schedule, places):
                    times[twin] = schedule.times[literal.activity]
    trials = [times, dict(schedule.times)]
    problem = relaxation.problem
    return any(
        validate_schedule(problem, build_schedule(problem, CandidateSchedule(t))).valid
        for t in trials
    )
