"""Lower bounds from jobs against optima that are found without them."""

import itertools
import random
from dataclasses import replace

import pytest
from unified_planning.model import TimePointInterval, Timing
from unified_planning.model.motion import MovableObject
from unified_planning.model.operators import OperatorKind
from unified_planning.shortcuts import (
    LE,
    AnytimePlanner,
    Equals,
    GlobalEndTiming,
    MinimizeMakespan,
    OneshotPlanner,
    Or,
    get_environment,
)

from tests.search.limits import WRITINGS, releases
from up_samp import Fleet
from up_samp.benchmarks.builders.warehouse import (
    WAREHOUSE_ENCODINGS,
    TransportOrder,
    store,
    warehouse,
)
from up_samp.benchmarks.builders.warehouse import _Work as Warehouse
from up_samp.benchmarks.places import drawn_map
from up_samp.geometry import lay_out
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.budget import Budget
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import Jobs, find_jobs
from up_samp.search.fleet_bound.bound import JobsBound
from up_samp.search.knowledge import Bounds, History, Knowledge
from up_samp.search.params import Parameters
from up_samp.search.session import open_service
from up_samp.search.statements import lower_bounds
from up_samp.search.world import Motions
from up_samp.upio import read_problem, write_refinement
from up_samp.upio.write_relaxation import relax
from up_samp.validation import validate_plan


def random_warehouse(seed):
    rng = random.Random(seed)
    encoding = rng.choice(WAREHOUSE_ENCODINGS)
    return warehouse(rng.choice([2, 2, 3]), rng.choice([2, 3, 4]), seed=seed, encoding=encoding)


def bounds_of(problem, change=lambda jobs: jobs):
    """Return the absolute bound, and the relative ones as they come."""
    snapshot, grid = lay_out(read_problem(problem))
    relaxation = relax(problem, snapshot)
    facts = Facts(relaxation.snapshot, relaxation.choices)
    service = open_service(snapshot, grid, Parameters())
    bound = JobsBound(problem, facts, service, change(find_jobs(problem, snapshot)))
    absolute = bound.absolute(Deadline.after(60.0))
    return absolute, list(bound.relative(Deadline.after(60.0)))


def check(seed):
    """Return the bound as a share of a plan's makespan, None where there is no plan: with some of
    its activities released when they begin in it.
    """
    get_environment().credits_stream = None
    problem, rng = random_warehouse(seed), random.Random(f"released {seed}")
    with OneshotPlanner(
        name="samp-refine[cpsat]", params={"seed": seed, "first_plan": True}
    ) as planner:
        result = planner.solve(problem, timeout=60)
    if result.plan is None:
        return None
    for activity in rng.sample(result.plan.activities, 2):
        mine, start = problem.get_activity(activity.name), result.plan.get(activity.start)
        release = rng.choice(releases(mine.start, int(start.constant_value())))
        rng.choice(WRITINGS)(problem, mine, release)
    (absolute, relative), makespan = bounds_of(problem), int(result.metrics["makespan"])
    # what drives last can only be more than their bounds, and the plan's drives are no faster
    assert absolute <= relative[0] <= relative[-1] <= makespan, seed
    return relative[-1] / makespan


def test_no_plan_is_shorter_than_the_bound():
    shares = [s for s in map(check, (1, 4)) if s is not None]
    assert len(shares) == 2
    assert max(shares) > 0.7


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_no_plan_of_many_is_shorter_than_the_bound(block):
    shares = [s for s in map(check, range(100 + 10 * block, 110 + 10 * block)) if s is not None]
    assert len(shares) >= 5


def test_what_is_of_use_to_two_jobs_counts_once():
    problem = warehouse(2, 2, encoding="compact")

    def twice(jobs):
        """The same work again, by other names."""
        again = tuple(
            tuple(replace(o, leader=f"other_{o.leader}") for o in options)
            for options in jobs.options
        )
        return Jobs((*jobs.options, *again), jobs.needs)

    assert bounds_of(problem)[0] == bounds_of(problem, change=twice)[0] > 0


def test_a_search_for_better_plans_tells_both_bounds():
    get_environment().credits_stream = None
    problem = warehouse(3, 8, encoding="compact")  # with fewer orders both are the same
    tuning = {"large": 1, "exchanges": 0}
    with AnytimePlanner(name="samp-refine[cpsat]", params={"tuning": tuning}) as planner:
        told = next(iter(planner.get_solutions(problem, timeout=60))).metrics
    absolute, lower = int(told["absolute_bound"]), int(told["lower_bound"])
    assert told["bound_kind"].startswith("relative")
    assert 0 < absolute < lower <= int(told["makespan"])
    assert absolute == bounds_of(problem)[0]


def test_what_is_relative_is_no_absolute_bound():
    bounds = Bounds()
    bounds.raise_lower(5, relative=False)
    bounds.raise_lower(4, relative=True)
    assert (bounds.lower, bounds.relative, bounds.absolute) == (5, False, 5)
    bounds.raise_lower(7, relative=True)
    bounds.raise_lower(6, relative=False)
    assert (bounds.lower, bounds.relative, bounds.absolute) == (7, True, 6)


# ------------------------------------------------- schedules of small worlds, without their motions
def crowded(seed):
    """Return a small world whose orders share slots and stations, so that they can be interleaved,
    with some of what says so in other ways, or not at all.
    """
    rng = random.Random(seed)
    robots = rng.choice([2, 2, 3])
    work = Warehouse(f"crowded{seed}", store(robots), compact=rng.random() < 0.7)
    for k in range(rng.choice([2, 3, 4])):
        service = rng.choice([1, 3]), rng.choice([1, 3])
        order = TransportOrder(rng.randrange(2), rng.randrange(2), service, None, optional=False)
        loads = work.order(k, order)
        work.problem.add_constraint(work.problem.environment.expression_manager.Or(
            [a.present for a in loads]
        ))  # fmt: skip
    if rng.random() < 0.3:
        loosened(work.problem, rng)
    return work.problem


def with_few_stations(seed):
    """Return a small world with fewer stations than robots: who stays there in the end counts. Some
    orders are left to choice.
    """
    rng = random.Random(seed)
    robots = rng.choice([2, 3])
    work = Warehouse(f"stations{seed}", store(robots), compact=rng.random() < 0.8)
    manager = work.problem.environment.expression_manager
    stations, pending = rng.choice([1, 1, 2]), []
    for k in range(rng.choice([2, 3])):
        service = rng.choice([1, 3]), rng.choice([1, 3])
        order = TransportOrder(
            rng.randrange(4), rng.randrange(stations), service, None, optional=False
        )
        pending = [*pending, *work.order(k, order)]
        if rng.random() < 0.7:
            work.problem.add_constraint(manager.Or([a.present for a in pending]))
            pending = []
    if pending:
        work.problem.add_constraint(manager.Or([a.present for a in pending]))
    if rng.random() < 0.3:
        loosened(work.problem, rng)
    return work.problem


def small_fleet(seed):
    """Return a small fleet's problem file whose orders share places; with some of what says that a
    robot carries one thing at a time left out now and then.
    """
    rng = random.Random(seed)
    robots = rng.choice([2, 3])
    plan = store(robots)
    fleet = Fleet(str(drawn_map(f"warehouse-{robots}", plan.size, plan.walls)))
    fleet.add_robot_type("car", (1.2, 0.8), model="car", turning_radius=1.0)
    fleet.add_robot_type("diff", (1.2, 0.8), model="diff", v_max=rng.choice([0.5, 1.0]))
    for i, pose in enumerate((*plan.slots[:3], *plan.stations[:2])):
        fleet.add_place(f"p{i}", *pose)
    for r, pose in enumerate(plan.docks):
        fleet.add_place(f"dock{r}", *pose)
        home = {"end": f"dock{r}"} if rng.random() < 0.5 else {}
        fleet.add_robot(f"r{r}", rng.choice(["car", "diff"]), start=f"dock{r}", **home)
    for k in range(rng.choice([2, 3])):
        stops = rng.sample(range(5), 2)
        asked = [{"at": f"p{at}", "service": rng.choice([1, 4])} for at in stops]
        fleet.add_order(f"o{k}", *asked)
    problem = fleet.problem
    picks = [a for a in problem.activities if a.name.startswith("pick")]
    if rng.random() < 0.4:
        for pick in rng.sample(picks, rng.randint(1, len(picks))):
            for conditions in pick.conditions.values():
                conditions[:] = [c for c in conditions if not c.is_fluent_exp()]
    return problem


def loosened(problem, rng):
    """Let activities follow at once, or robots do several things at a time."""
    manager = problem.environment.expression_manager
    if rng.random() < 0.6:
        constraints = problem._base._constraints
        for n, (constraint, scope) in enumerate(constraints):
            if constraint.node_type is OperatorKind.LT and rng.random() < 0.8:
                constraints[n] = (manager.LE(*constraint.args), scope)
        return
    for activity in problem.activities:
        if rng.random() < 0.5:
            for effects in activity.effects.values():
                effects[:] = [e for e in effects if e.is_assignment()]


def told_apart(problem):
    """State that no two robots are at one place in the end, as no plan lets them."""
    manager = problem.environment.expression_manager
    robots = [o for o in problem.all_objects if isinstance(o, MovableObject)]
    where = [f for f in problem.fluents if f.type.is_configuration_type()]
    found = [f() for f in where if f.arity == 0]
    found += [f(robot) for f in where if f.arity == 1 for robot in robots]
    assert len(found) == len(robots)
    for one, other in itertools.combinations(found, 2):
        problem.add_condition(GlobalEndTiming(), manager.Not(manager.Equals(one, other)))


def soonest(problem):
    """Return the least makespan of all schedules whose drives last as long as their bounds say."""
    told_apart(problem)
    snapshot, grid = lay_out(read_problem(problem))
    relaxation = relax(problem, snapshot)
    facts = Facts(relaxation.snapshot, relaxation.choices)
    service = open_service(snapshot, grid, Parameters())
    deadline = Deadline.after(60.0)
    motions = Motions(facts, service, Budget(deadline, 10.0))
    for refinement in lower_bounds(motions, Knowledge(relaxation, History())):
        write_refinement(relaxation, refinement)
    session = CpsatSession(relaxation.problem, seed=0, workers=1)
    report = session.solve(deadline, optimal=True)
    proven = report.schedule is not None and report.bound == report.schedule.makespan
    return report.bound if proven else None


def check_crowded(seed, world=crowded):
    """Return the absolute bound as a share of the soonest schedule's makespan."""
    problem = world(seed)
    best = soonest(problem)
    if best is None:
        return None
    absolute, _ = bounds_of(problem)
    assert absolute <= best, seed
    return absolute / best


def test_no_schedule_of_a_crowded_world_is_shorter_than_the_bound():
    shares = [s for s in map(check_crowded, (1, 4, 5)) if s is not None]
    assert len(shares) == 3
    assert max(shares) == 1.0


@pytest.mark.usefixtures("no_second_opinions")
def test_no_schedule_of_a_small_fleet_is_shorter_than_the_bound():
    shares = [s for s in (check_crowded(n, small_fleet) for n in (1, 11, 13)) if s is not None]
    assert len(shares) == 3
    assert max(shares) == 1.0


def test_no_schedule_with_few_stations_is_shorter_than_the_bound():
    shares = [
        s
        for s in (check_crowded(n, with_few_stations) for n in (3001, 3002, 3010))
        if s is not None
    ]
    assert len(shares) == 3
    assert max(shares) == 1.0


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_no_schedule_of_many_with_few_stations_is_shorter_than_the_bound(block):
    seeds = range(3000 + 20 * block, 3020 + 20 * block)
    shares = [s for s in (check_crowded(n, with_few_stations) for n in seeds) if s is not None]
    assert len(shares) >= 12


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_no_schedule_of_many_small_fleets_is_shorter_than_the_bound(block):
    seeds = range(2000 + 20 * block, 2020 + 20 * block)
    shares = [s for s in (check_crowded(n, small_fleet) for n in seeds) if s is not None]
    assert len(shares) >= 12


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_no_schedule_of_many_crowded_worlds_is_shorter_than_the_bound(block):
    seeds = range(1000 + 20 * block, 1020 + 20 * block)
    shares = [s for s in map(check_crowded, seeds) if s is not None]
    assert len(shares) >= 12


# --------------------------------------------------------------- shares against all ways to share
def with_a_stop_on_the_way():
    """A robot comes to a station sooner with a stop than by the planner's direct drive."""
    made = Warehouse("stop", store(3), compact=True)
    problem, station = made.problem, made.stations[0]
    doing = []
    for r, robot in enumerate(made.robots):
        at = made.robot_at(robot)
        go = made._move(f"go_{r}", robot, at, station)
        do = made._serve(f"do_{r}", 2 if r == 1 else 100)
        via = made._move(f"via_{r}", robot, at, made.slots[0])
        do.add_condition(TimePointInterval(Timing(0, do.start)), Equals(at, station))
        for a in (go, do, via):
            a.uses(made.hands[r])
        problem.add_constraint(do.present, scope=[go.present])
        problem.add_constraint(go.present, scope=[do.present])
        problem.add_constraint(LE(go.end, do.start), scope=[go.present, do.present])
        doing.append(do)
    problem.add_constraint(Or([do.present for do in doing]))
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def test_a_stop_on_the_way_may_be_quicker_than_the_planners_own_way():
    get_environment().credits_stream = None
    problem = with_a_stop_on_the_way()
    with AnytimePlanner(name="samp-refine[cpsat]") as planner:
        best = None
        for result in planner.get_solutions(problem, timeout=30):
            best = result.plan or best
    assert validate_plan(problem, best).valid
    makespan = max(int(best.get(a.end).constant_value()) for a in best.activities)
    absolute, relative = bounds_of(problem)
    assert max([absolute, *relative]) <= makespan
