"""Set a search up for a UP problem and run it: the entry from the engines."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Plan
from unified_planning.shortcuts import MinimizeMakespan

from up_samp.geometry import OccupancyGrid, lay_out
from up_samp.model import (
    Configuration,
    Deadline,
    Placed,
    ProblemError,
    avoids,
)
from up_samp.model.snapshot import Snapshot
from up_samp.motion import MotionService
from up_samp.search.budget import Budget, Restarts
from up_samp.search.check import Checker
from up_samp.search.conclusion import SearchResult
from up_samp.search.events import Observer, ProgressObserver, State, Telling, TraceObserver
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import earlier_jobs, find_jobs
from up_samp.search.fleet.solve import LargeProblem, solve_large
from up_samp.search.fleet_bound.bound import state_bounds
from up_samp.search.knowledge import READING, Bounds, History, Incumbent, Knowledge, Stages
from up_samp.search.loop import solve
from up_samp.search.params import Parameters
from up_samp.search.presets import components_of
from up_samp.search.proof import Prover
from up_samp.search.resolve import start_of
from up_samp.search.search import Problem, Search, Statement, Wrapped
from up_samp.search.world import Motions
from up_samp.tuning import tuning_of
from up_samp.upio import read_problem
from up_samp.upio.objective import only_makespan


def check_start_poses(snapshot: Snapshot, service: MotionService) -> None:
    """Raise :class:`ProblemError` where a robot starts in a wall or in another object."""
    for name in sorted(snapshot.by_object):
        body = snapshot.objects[name].body
        pose = snapshot.configurations[snapshot.initial[name]]
        in_wall, _ = service.pose_blockers(body, pose, ())
        if in_wall:
            raise ProblemError(
                f"object '{name}' starts at '{snapshot.initial[name]}' {_show(pose)}, which is in "
                f"a wall or outside the map '{snapshot.map_file}'"
            )
        others = tuple(
            Placed(o, snapshot.objects[o].body, snapshot.configurations[place])
            for o, place in snapshot.initial.items()
            if o != name and avoids(snapshot.heeded[name], o)
        )
        _, hit = service.pose_blockers(body, pose, others)
        if hit:
            raise ProblemError(
                f"object '{name}' overlaps '{min(hit)}' at the start; move one of them "
                f"('{name}' starts at '{snapshot.initial[name]}' {_show(pose)})"
            )


def _show(pose: Configuration) -> str:
    return "(" + ", ".join(f"{v:g}" for v in pose) + ")"


_TOUR_ROUNDS = 10
"""A task, of annealing over the tours of an assignment."""
NEEDED = ("lower bounds on motions", "proofs of unreachability")
"""What is stated before a plan of a thinned problem is sought."""


def open_search(
    problem: SchedulingMotionProblem,
    wrapped: Wrapped,
    params: Parameters,
    deadline: Deadline,
    *,
    start: Plan | None = None,
    service: MotionService | None = None,
) -> Search:
    """Read the problem, check its geometry, relax it and open a scheduler on the relaxation.

    ``start`` is a plan to begin from, it need not be one of this problem; ``service``: who plans
    its motions, if that is not to be a new one.

    Raises :class:`ProblemError` where the problem is wrong, before any search.
    """
    stages = Stages()
    with stages.of(READING):
        snapshot, grid = lay_out(read_problem(problem, params.seconds_per_unit))
        service = service or open_service(snapshot, grid, params)
        check_start_poses(snapshot, service)
        search = assemble(Problem(problem, snapshot, wrapped, params), service, deadline)
        if start is not None:
            search.start, search.driven = start_of(problem, start), search.problem.known(start)
        whole = params.components is not None or not only_makespan(problem)
        if "incumbents" not in params.without and not whole:
            _look_for_jobs(search)
    search.history.stages = stages
    if "incumbents" not in params.without and start is None and snapshot.tasks:
        search.easier = easier_of(search.problem)
    return search


def _look_for_jobs(search: Search) -> None:
    """Find the jobs that robots may be assigned: of a large problem, for plans in parts; of others,
    for a bound before the search, if robots drive in the midst of a job, and no plan is given to
    begin from. (Of single tasks the scheduler knows more.)
    """
    problem, snapshot = search.problem.source, search.problem.snapshot
    jobs = find_jobs(problem, snapshot)
    if jobs is None:
        return
    large = sum(a.optional for a in problem.activities) >= search.tuning.large
    driving = any(mode.legs for mode in itertools.chain(*jobs.options))
    # of a job shop's tasks most wait for what others do: who assigns knows too little of that
    if large and (driving or 2 * len(earlier_jobs(problem, jobs)) <= len(jobs.options)):
        inner = partial(open_thin, search.problem, search.motions.service)
        in_parts = LargeProblem(problem, snapshot, jobs, inner, search.tuning, search.facts.choices)
        search.in_parts = partial(solve_large, in_parts)
    elif driving and search.start is None:

        def bound(search: Search) -> tuple[()]:
            state_bounds(search, problem, jobs, relative=False)
            return ()

        told = (*search.components.statements, Statement("bound from all jobs", bound))
        search.components = replace(search.components, statements=told)


def easier_of(
    problem: Problem,
) -> Callable[[Search], Generator[Incumbent, None, Any]] | None:
    """Return what yields plans of the problem with nothing but the makespan, if something else
    counts: by the makespan a scheduler is led to plans sooner.
    """
    source = problem.source
    if only_makespan(source) or any(m.is_minimize_action_costs() for m in source.quality_metrics):
        return None  # UP cannot copy problems of action costs
    soon = source.clone()
    soon.clear_quality_metrics()
    soon.add_quality_metric(MinimizeMakespan())
    mine = replace(problem.unheard, stop=None, runtime=math.inf)

    def plans(search: Search) -> Generator[Incumbent, None, Any]:
        deadline = search.budget.part("plans by an easier objective")
        # its plans are judged as plans of the whole problem
        service, unjudged = search.motions.service, problem.unjudged
        other = open_search(soon, unjudged, mine, deadline, service=service)
        return run(other, optimal=True, patience=Parameters.patience)

    return plans


def open_thin(
    whole: Problem, service: MotionService, problem: SchedulingMotionProblem, deadline: Deadline
) -> Search:
    """Return a search on a problem with few alternatives, for some plan soon: little is stated
    before, motions are decided one after the other, and nobody is told. The plan is not judged.
    """
    hasty = replace(whole.tuning, tour_rounds=_TOUR_ROUNDS, labels=0)
    mine = replace(whole.unheard, tuning=hasty)
    usual = components_of(mine, native=True)
    stated = tuple(s for s in usual.statements if s.name in NEEDED)
    components = replace(usual, statements=stated, shapers=(), builders=())
    snapshot, _ = lay_out(read_problem(problem, mine.seconds_per_unit))
    mine = replace(mine, components=components)
    return assemble(Problem(problem, snapshot, whole.unjudged, mine), service, deadline)


def assemble(problem: Problem, service: MotionService, deadline: Deadline) -> Search:
    """Return a search of the components that the parameters ask for."""
    params = problem.params
    deadline = replace(deadline, at=deadline.within(params.runtime - deadline.used()).at)
    relaxation = problem.relax()
    components = components_of(params, native=problem.native)
    facts = Facts(relaxation.snapshot, relaxation.choices)
    history, bounds = History(), Bounds.by(problem.measure)
    knowledge = Knowledge(relaxation, history)
    budget = Budget(deadline, params.query_seconds, history=history)
    motions = Motions(facts, service, budget)
    tell = Telling(observers_of(params), partial(state_of, history, bounds, deadline))
    return Search(
        problem=problem,
        facts=facts,
        knowledge=knowledge,
        budget=budget,
        bounds=bounds,
        motions=motions,
        checker=Checker(
            motions,
            knowledge,
            components.cuts,
            components.layers,
            tell,
            thorough=bool(components.repairs),
            seed=params.seed,
        ),
        prover=Prover(problem.relax, budget, params.seed, problem.tuning),
        scheduler=problem.schedule(relaxation, 0),
        components=components,
        restarts=Restarts(params.max_restarts),
        tell=tell,
    )


def observers_of(params: Parameters) -> tuple[Observer, ...]:
    """Return who is told what happens: those given, and the writers of progress and trace."""
    found = list(params.observers)
    if params.progress is not None:
        found.append(ProgressObserver(params.progress))
    if params.trace is not None:
        found.append(TraceObserver(params.trace))
    return tuple(found)


def state_of(history: History, bounds: Bounds, deadline: Deadline) -> State:
    """Return where a search is."""
    return State(
        rounds=len(history.rounds),
        restarts=history.restarts,
        lower_bound=bounds.told_lower(),
        upper_bound=bounds.upper,
        measure=bounds.measure,
        elapsed=deadline.elapsed(),
        last_plan_at=history.last_plan_at,
        last_plan_round=history.last_plan_round,
    )


def open_service(
    snapshot: Snapshot, grid: OccupancyGrid | None, params: Parameters
) -> MotionService:
    """Return the motion service for a problem's map."""
    if grid is None and snapshot.tasks:
        raise ProblemError(f"problem '{snapshot.name}' has motions but no occupancy map")
    return MotionService(
        grid,
        planner=params.path_planner,
        margin=params.margin,
        seed=params.seed,
        cache=params.cache,
        tuning=tuning_of(params.tuning),
        proofs="certificates" not in params.without,
    )


def run(
    search: Search, *, optimal: bool, patience: float = math.inf
) -> Generator[Incumbent, None, SearchResult]:
    """Run the search, and leave out of its best plan what is needless; the scheduler is closed
    whatever happens. ``patience``: see :class:`Parameters`.
    """
    bounds = search.bounds
    search.budget.patience = patience
    try:
        if search.in_parts is None:
            result = yield from solve(search, optimal=optimal)
        else:
            result = yield from search.in_parts(search, optimal)
        # a large problem has too many motions for what is done about each of them in the end
        search.budget.end()
        for finish in search.components.finishers if search.in_parts is None else ():
            found = finish(search, bounds.incumbent) if bounds.incumbent is not None else None
            if found is not None and not search.judged(found.plan):
                bounds.incumbent = found
        return result
    finally:
        search.scheduler.close()
