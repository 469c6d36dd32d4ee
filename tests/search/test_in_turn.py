"""Some plan always: where groups of motions find no trajectories, they are decided one after
another, and where that fails, too, they happen one after another.
"""

import random

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from tests.shuffled import shuffled
from tests.upio.hall import Hall
from tests.usual import usually
from up_samp.model import CandidateSchedule, GroupReport, Outcome, ScheduledMotion
from up_samp.motion import MotionService
from up_samp.search import presets
from up_samp.search.check import Check
from up_samp.search.resolve import of_failed_groups
from up_samp.upio import Itinerary
from up_samp.validation import validate_plan


@pytest.fixture
def clumsy(monkeypatch):
    """A motion service that never finds a way for several motions together."""
    whole = MotionService.coordinate
    asked = []

    def coordinate(self, query, deadline, **options):
        asked.append(len(query.motions))
        if len(query.motions) > 1:
            names = frozenset(m.name for m in query.motions)
            return GroupReport(Outcome.OUT_OF_TIME, conflict=names, reason="made up by the test")
        return whole(self, query, deadline, **options)

    monkeypatch.setattr(MotionService, "coordinate", coordinate)
    return asked


@pytest.fixture
def narrow(clumsy, monkeypatch):
    """The same, and motions are never decided one after another."""
    monkeypatch.setattr(presets, "in_order_at_last", lambda search, schedule, check: None)
    return clumsy


def spans_of(plan):
    """Return the activities' times, in order."""
    values = [[int(str(plan.get(t))) for t in (a.start, a.end)] for a in plan.activities]
    return sorted(values)


def crossing(folder, robots):
    hall = Hall(folder, robots=robots)
    for k in range(robots):
        hall.move(f"go{k}", k, f"left{k}", f"right{k}", bounds=(1, 100))
    return hall.problem


@pytest.mark.parametrize("engine", usually("cpsat", of=("cpsat", "aries")))
def test_the_first_candidate_becomes_a_plan(tmp_path, narrow, engine):
    problem = crossing(tmp_path, 2)
    with OneshotPlanner(name=f"samp-refine[{engine}]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status is Status.SOLVED_SATISFICING
    assert validate_plan(problem, result.plan).valid
    assert result.metrics["rounds"] == "1"
    assert 2 in narrow  # together at first
    spans = spans_of(result.plan)
    assert spans[0][1] <= spans[1][0]


def test_motions_that_are_decided_in_turn_happen_side_by_side(tmp_path, clumsy):
    problem = crossing(tmp_path, 2)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=60)
    assert validate_plan(problem, result.plan).valid
    assert result.metrics["rounds"] == "1"
    assert 2 in clumsy
    spans = spans_of(result.plan)
    assert spans[1][0] < spans[0][1]


def standing_in_the_gap(folder, seed):
    """Two or three robots, each with one drive; one of them stands in the gap. Return the problem
    and that one's drive.
    """
    rng, robots = random.Random(f"in the way {seed}"), 2 + seed % 2
    hall = Hall(folder, robots=robots)
    hall.problem.initial_configuration.clear()
    hall.pose("gap", 10.0, 5.0, 0.0)
    first = rng.randrange(robots)
    for k in range(robots):
        sides = rng.sample([("near", 3.0), ("far", 17.0)], 2)
        for side, x in sides:
            hall.pose(f"{side}{k}", x, 2.0 + 3.0 * k, 0.0)
        here, there = (f"{side}{k}" for side, _ in sides)
        here = "gap" if k == first else here
        hall.problem.set_initial_configuration(hall.robots[k], hall.poses[here])
        hall.move(f"go{k}", k, here, there, bounds=(1, 100))
    return hall.problem, f"go{first}"


@pytest.mark.parametrize("seed", usually(0, 2, of=range(30)))
def test_who_is_in_the_way_goes_first(tmp_path, narrow, seed):
    """One robot stands in the gap: only if it goes first can they drive one after another."""
    problem, first = standing_in_the_gap(tmp_path, seed)
    told = shuffled(problem, seed)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(told.problem, timeout=20)
    assert result.status is Status.SOLVED_SATISFICING, result.log_messages
    plan = told.back(result.plan)
    assert validate_plan(problem, plan).valid
    times = {a.name: int(str(plan.get(a.start))) for a in plan.activities}
    assert min(times, key=times.get) == first
    assert result.metrics["rounds"] == "1"


def test_a_search_without_a_plan_uses_its_time(tmp_path, monkeypatch):
    """Nothing ever fits: the search begins anew until the deadline, and says so."""

    def coordinate(self, query, deadline, **options):
        names = frozenset(m.name for m in query.motions)
        return GroupReport(Outcome.OUT_OF_TIME, conflict=names, reason="made up by the test")

    monkeypatch.setattr(MotionService, "coordinate", coordinate)
    monkeypatch.setattr(presets, "in_order_at_last", lambda search, schedule, check: None)
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(crossing(tmp_path, 2), timeout=1.5)
    assert result.status is Status.TIMEOUT
    assert result.plan is None
    assert int(result.metrics["restarts"]) > 1
    assert float(result.metrics["seconds_total"]) > 1.2


@pytest.mark.parametrize(
    ("failed", "wrong"), [("go#1", {"go#1"}), ("go", {"go"}), ("come#1", {"come"})]
)
def test_an_activity_named_like_a_further_motion_is_taken_for_itself(failed, wrong):
    pose = (0.0, 0.0, 0.0)

    def motion(activity, constraint, start):
        ends = ("here", "there")
        return ScheduledMotion(activity, constraint, activity, ends, (pose, pose), start, start + 1)

    motions = (motion("go", 0, 0), motion("go#1", 0, 5), motion("come", 1, 9))
    itinerary = Itinerary(CandidateSchedule({}), motions, ())
    assert of_failed_groups(itinerary, Check(failed={failed})) == wrong
