"""Whole tours, one robot after the other: stays between visits of others, orders begun anew."""

import math
import random
from dataclasses import replace

import pytest
from unified_planning.shortcuts import get_environment

from tests.motion.fleet.spacetime_oracle import room
from tests.search.fleet.guesses import assigned
from up_samp.benchmarks.builders.warehouse import WAREHOUSE_ENCODINGS, warehouse
from up_samp.geometry import lay_out
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Rest, TimedMotion
from up_samp.motion import MotionService
from up_samp.motion.fleet.reservations import ReservationTable
from up_samp.search import session
from up_samp.search.fleet import improve
from up_samp.search.fleet.assignment import decided_by, state_order
from up_samp.search.fleet.improve import plan_tours, undecided_tours
from up_samp.search.fleet.jobs import find_jobs
from up_samp.search.fleet.solve import homes_of
from up_samp.search.loop import get_schedule, state_what_is_known
from up_samp.search.params import Parameters
from up_samp.search.search import Problem, Wrapped
from up_samp.upio import read_itinerary, read_problem
from up_samp.upio.restrict import thinned
from up_samp.validation import validate_plan

BOX = ((-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4))


def driver(name, start, goal, release):
    body = Body(BOX, Kinematics(MotionModel.SE2, 1.0, 1.0, 1.0, 1.0))
    return TimedMotion(name, name[0], body, (start, goal), release, math.inf)


def decide(floor, motion, **changed):
    run = floor.plan(replace(motion, **changed), Deadline.never()).run
    floor.add(run)
    return run


@pytest.fixture
def floor():
    """A hall in which "a" crosses the middle at 60 s and "b" stays there from 150 to 200 s."""
    places = {"a": (3.0, 8.0, 0.0), "b": (10.0, 3.0, 0.0), "c": (3.0, 13.0, 0.0)}
    body = driver("a", places["a"], places["a"], 0.0).body
    service = MotionService(room(20, 17, [(0, 0, 20, 17)]))
    found = ReservationTable(service, [Rest(n, body, p) for n, p in places.items()])
    decide(found, driver("a1", places["a"], (17.0, 8.0, 0.0), 60.0))
    decide(found, driver("b1", places["b"], (10.0, 8.0, 0.0), 150.0))
    decide(found, driver("b2", (10.0, 8.0, 0.0), places["b"], 200.0))
    found.kept_alive = service
    return found


def test_stays_lie_between_the_visits_of_others(floor):
    coming = driver("c1", (3.0, 13.0, 0.0), (10.0, 8.0, 0.0), 0.0)
    (first, until), (again, last), (free, always) = floor.stays(coming)
    assert first == 0.0
    assert 60.0 < until < again < 80.0
    assert 150.0 < last < 160.0
    assert 200.0 < free < 210.0
    assert always == math.inf
    assert floor.plan(coming, Deadline.never()).run.arrival > free, "it stays for good"
    run = decide(floor, coming, present_until=until)
    assert run.arrival < until
    # from there it has to be gone in time
    away = driver("c2", (10.0, 8.0, 0.0), (3.0, 13.0, 0.0), run.arrival)
    assert floor.plan(away, Deadline.never()).run.timing.trajectory.start < until
    assert floor.plan(replace(away, release=until + 1.0), Deadline.never()).run is None


def test_what_was_decided_last_can_be_withdrawn(floor):
    coming = driver("c1", (3.0, 13.0, 0.0), (10.0, 8.0, 0.0), 0.0)
    before = floor.stays(coming)
    decide(floor, coming, present_until=before[0][1])
    assert "c1" in floor.trajectories()
    floor.withdraw("c")
    assert "c1" not in floor.trajectories()
    assert floor.stays(coming) == before


def test_a_way_past_all_ends_is_open_once_everybody_is_there():
    """Robot "a" comes to stand on the straight way of "c" before that can leave, and stays."""
    places = {"a": (10.0, 3.0, 0.0), "c": (3.0, 8.0, 0.0)}
    body = driver("a", places["a"], places["a"], 0.0).body
    service = MotionService(room(20, 17, [(0, 0, 20, 17)]))
    floor = ReservationTable(service, [Rest(n, body, p) for n, p in places.items()])
    through = driver("a1", places["a"], (10.0, 14.0, 0.0), 6.0)
    decide(floor, through)
    blocked = decide(floor, driver("a2", (10.0, 14.0, 0.0), (10.0, 8.0, 0.0), 20.0))
    crossing = driver("c1", places["c"], (17.0, 8.0, 0.0), 25.0)
    run = floor.past_all_ends(crossing, Deadline.never())
    assert run.path.length > 14.1, "it drives round"
    assert floor.clear([run])
    straight = driver("c1", places["c"], (17.0, 8.0, 0.0), 0.0)
    decide(floor, straight)
    assert floor.clear([floor.trajectories()["c1"]])
    assert not floor.clear([replace(blocked, object="b", since=0.0)])


def opened(problem, seed):
    """Return a search on the problem thinned to an assignment, its first candidate, what makes
    plans of it, and the assignment.
    """
    get_environment().credits_stream = None
    snapshot, grid = lay_out(read_problem(problem))
    service = session.open_service(snapshot, grid, Parameters())
    jobs = find_jobs(problem, snapshot)
    assignment = assigned(jobs, snapshot, seed=seed)
    thin = thinned(problem, decided_by(assignment, problem.activities))
    state_order(thin, assignment)
    wrapped = Wrapped("cpsat", {}, lambda problem, plan: [], lambda plan: [], True)
    whole = Problem(problem, snapshot, wrapped, Parameters())
    search = session.open_thin(whole, service, thin, Deadline.after(120))
    state_what_is_known(search)
    report = get_schedule(search, optimal=False)
    search.scheduler.close()
    itinerary = read_itinerary(search.knowledge.relaxation, report.schedule)
    return search, itinerary, whole.build, assignment


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(s, marks=pytest.mark.long) for s in range(2, 30))]
)
def test_every_fleet_that_parks_out_of_the_way_gets_a_plan(seed):
    rng = random.Random(seed)
    encoding = WAREHOUSE_ENCODINGS[seed % 2]
    problem = warehouse(rng.randint(3, 4), rng.randint(5, 7), encoding=encoding, seed=seed)
    search, itinerary, build, _ = opened(problem, seed)
    found = plan_tours(search, itinerary, Deadline.after(100))
    assert found is not None
    _, done = found
    whole = build(done.schedule, done.trajectories())
    assert validate_plan(problem, whole).violations == ()


@pytest.mark.parametrize("seed", [2])
def test_whole_tours_are_decided_where_no_round_brings_any(seed, monkeypatch):
    monkeypatch.setattr(improve, "squeaky_wheel", lambda *_: None)
    problem = warehouse(4, 6, encoding="compact", seed=seed)
    search, itinerary, build, _ = opened(problem, seed)
    _, done = plan_tours(search, itinerary, Deadline.after(100))
    whole = build(done.schedule, done.trajectories())
    assert validate_plan(problem, whole).violations == ()


def test_who_goes_first_is_done_sooner():
    problem = warehouse(4, 6, encoding="compact")
    search, itinerary, _, _ = opened(problem, 0)
    tours = undecided_tours(search, itinerary, frozenset())
    everybody = tours.ranked()
    assert tours.decide_in_turns(Deadline.after(60), everybody) is None
    done = tours.decided()
    last = max(done.ends(), key=done.ends().get)
    tours.reset()
    first = (last, *(robot for robot in everybody if robot != last))
    assert tours.decide_in_turns(Deadline.after(60), first) is None
    assert tours.decided().ends()[last] <= done.ends()[last]


def test_needless_ways_home_are_left_out_of_plans():
    problem = warehouse(3, 5, encoding="compact")
    search, itinerary, build, assignment = opened(problem, 0)
    done = plan_tours(search, itinerary, Deadline.after(100), homes=homes_of(problem, assignment))[
        1
    ]
    assert done.needless
    assert all(name.startswith("leave_") for name in done.needless)
    assert done.lean().makespan < done.schedule.makespan
    lean = build(done.lean(), done.trajectories())
    assert validate_plan(problem, lean).violations == ()
