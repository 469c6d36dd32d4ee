"""In which order and under which names a problem is listed changes neither whether it has a plan
nor its optimum: every sort of problem that we have, each in other listings.
"""

import functools

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status

from tests.fleet.witness import NoWitnessError, fleet_of
from tests.fuzz.problems import SECONDS, build
from tests.fuzz.small import small_case
from tests.metamorphic.answers import Answer, answer_in, answer_to, in_one_meaning
from tests.metamorphic.motions import ALIKE, OTHERS, write
from tests.metamorphic.sites import FAMILIES
from tests.scheduling.cpsat.odd_routes import odd_routes
from tests.scheduling.cpsat.random_routes import random_routes
from tests.scheduling.cpsat.sites import dispatch, small
from tests.scheduling.cpsat.styles import LOOSE, SPOILED, TIGHT
from tests.scheduling.cpsat.writer import write as write_schedule
from tests.shuffled import shuffled, shuffled_fleet
from tests.usual import usually
from up_samp.benchmarks.instances import instance
from up_samp.fleet.build import write_problem
from up_samp.fleet.files import read_record
from up_samp.fleet.records import FleetRecords
from up_samp.model import Deadline, MotionModel, ScheduleStatus
from up_samp.motion.compile import precompile
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio.plan import build_schedule
from up_samp.validation import validate_plan, validate_schedule

EFFORT = 0.3
"""Of CP-SAT for a schedule, in its deterministic time."""
LISTINGS = 2
"""In which a problem is solved, beside its own."""
STYLES = [*TIGHT, *LOOSE, *SPOILED]
MOTION_STYLES = [*ALIKE, *OTHERS]
INSTANCES = (
    "logistics-do-oc-r1-i1", "logistics-do-all-r2-i2", "jobshop-r1-j1-m1", "jobshop-r2-j1-m1",
    "navigation-r2", "kitting-r1-k1-p2-d2", "kitting-r2-k1-p3-d2", "doors-r1-d1", "doors-r2-d1",
    "warehouse-r2-o3",
)  # fmt: skip
STATUSES = {
    ScheduleStatus.OPTIMAL: Status.SOLVED_OPTIMALLY,
    ScheduleStatus.FOUND: Status.SOLVED_SATISFICING,
    ScheduleStatus.INFEASIBLE: Status.UNSOLVABLE_PROVEN,
    ScheduleStatus.OUT_OF_TIME: Status.TIMEOUT,
}
SCHEDULES = {
    "routes": random_routes,
    "odd routes": odd_routes,
    "dispatch": lambda seed: write_schedule(dispatch(seed), STYLES[seed % len(STYLES)]),
    "sites": lambda seed: write_schedule(small(seed), STYLES[seed % len(STYLES)]),
}


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile all kernels first: time limits in these tests are meant for searching."""
    precompile([MotionModel.SE2, MotionModel.REEDSSHEPP])


def schedule_answer(told, listing) -> Answer:
    """Solve a scheduling problem; its plan is judged by the original."""
    report = CpsatSession(told.problem, workers=1, effort=EFFORT).solve(Deadline.after(20))
    makespan, refused = None, ""
    if report.schedule is not None:
        plan = told.back(build_schedule(told.problem, report.schedule))
        refused = "; ".join(map(str, validate_schedule(told.original, plan).violations))
        makespan = report.schedule.makespan
    status = STATUSES.get(report.status, Status.INTERNAL_ERROR)
    return Answer(listing, status, makespan, report.bound or 0, refused, None, 0.0, report.message)


def of_schedules(sort, seed):
    """Return what listings of a schedule contradict."""
    problem = SCHEDULES[sort](seed)
    told = [shuffled(problem, (seed, k)) for k in range(LISTINGS)]
    asked = [shuffled(problem, seed, rename=False), *told]
    return in_one_meaning([schedule_answer(one, f"listing {k}") for k, one in enumerate(asked)])


def of_motions(problem, seed, *, timeout=8.0, listings=1, **params):
    """Return what listings of a problem with motions contradict."""
    unit = params.get("seconds_per_unit", 1.0)
    own = functools.partial(validate_plan, problem, seconds_per_unit=unit)
    answers = [answer_to(problem, "its own", own, timeout=timeout, **params)]
    for k in range(listings):
        told = shuffled(problem, (seed, k))
        answers.append(answer_in(told, f"listing {k}", timeout=timeout, **params))
    return in_one_meaning(answers)


def of_fleets(seed, folder, *, timeout=8.0):
    """Return what a random fleet and another listing of it contradict."""
    try:
        spec = fleet_of(seed, folder).spec
    except NoWitnessError:
        return []
    records = read_record(FleetRecords, {k: v for k, v in spec.items() if k != "walls"})
    answers = []
    for listing, some in (
        ("its own", records),
        ("listing 0", shuffled_fleet(records, seed).records),
    ):
        problem, unit = write_problem(some, folder).problem, some.seconds_per_unit
        judge = functools.partial(validate_plan, problem, seconds_per_unit=unit)
        answers.append(answer_to(problem, listing, judge, timeout=timeout, seconds_per_unit=unit))
    return in_one_meaning(answers)


def wrong(seeds, of):
    """Return seed -> contradictions, where there are any."""
    found = {seed: of(seed) for seed in seeds}
    return {seed: lines for seed, lines in found.items() if lines}


@pytest.mark.parametrize("sort", usually(*(s for s in SCHEDULES if s != "dispatch"), of=SCHEDULES))
def test_listings_of_schedules_agree(sort):
    assert wrong(range(1 + (sort != "odd routes")), functools.partial(of_schedules, sort)) == {}


@pytest.mark.parametrize("name", INSTANCES[2:3])
def test_listings_of_an_instance_agree(name):
    assert of_motions(instance(name).build(), name, timeout=20.0) == []


@pytest.mark.long
@pytest.mark.parametrize("block", range(5))
@pytest.mark.parametrize("sort", SCHEDULES)
def test_listings_of_many_schedules_agree(sort, block):
    """2,680 listings; with those of the tests below 3,060."""
    seeds = range(1000 + 67 * block, 1067 + 67 * block)
    assert wrong(seeds, functools.partial(of_schedules, sort)) == {}


@pytest.mark.long
@pytest.mark.parametrize("name", INSTANCES)
def test_listings_of_instances_agree(name):
    assert of_motions(instance(name).build(), name, timeout=20.0, listings=2) == []


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_listings_of_sites_agree(family, tmp_path):
    def of(seed):
        style = MOTION_STYLES[seed % len(MOTION_STYLES)]
        return of_motions(write(FAMILIES[family](seed), style, tmp_path), seed)

    assert wrong(range(100, 112), of) == {}


@pytest.mark.long
@pytest.mark.parametrize("block", range(4))
def test_listings_of_random_problems_agree(block, tmp_path):
    def of(seed):
        problem = build(small_case(seed), tmp_path)
        return of_motions(problem, seed, timeout=6.0, seconds_per_unit=SECONDS)

    assert wrong(range(5000 + 50 * block, 5050 + 50 * block), of) == {}


@pytest.mark.long
@pytest.mark.parametrize("block", range(4))
def test_listings_of_fleets_agree(block, tmp_path):
    seeds = range(600 + 25 * block, 625 + 25 * block)
    assert wrong(seeds, functools.partial(of_fleets, folder=tmp_path)) == {}
