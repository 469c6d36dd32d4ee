"""A parameter says which object moves: any robot fetches, the plan says which."""

from __future__ import annotations

import copy
import json

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model import Fluent
from unified_planning.model.motion import ActivityWaypoints
from unified_planning.plans import SequentialPlan
from unified_planning.shortcuts import (
    BoolType,
    Equals,
    GlobalEndTiming,
    Iff,
    IntType,
    Not,
    Object,
    OneshotPlanner,
    UserType,
)

from tests.upio.hall import Hall, write_hall
from tests.usual import usually
from up_samp.execution import dependencies_of
from up_samp.io import contradictions, plan_from_dict, plan_to_dict
from up_samp.model import ProblemError, UnsupportedError
from up_samp.upio.movers import settle_movers
from up_samp.validation import validate_plan

ERRANDS = {"near": (6.0, 3.0), "far": (8.0, 7.0), "mid": (5.0, 5.0)}


class Site:
    """Two robots in the left room of a hall, places to visit, and a fluent: where each robot is."""

    def __init__(self, folder, errands=tuple(ERRANDS)):
        self.hall = Hall(folder, robots=2, map_file=write_hall(folder, wall_gap=None))
        self.problem = self.hall.problem
        self.at = Fluent("at", self.hall.place, robot=self.hall.robot)
        self.problem.add_fluent(self.at)
        for k, robot in enumerate(self.hall.robots):
            self.problem.set_initial_value(self.at(robot), self.hall.poses[f"left{k}"])
        for name in errands:
            self.hall.pose(name, *ERRANDS[name], 0.0)

    def visit(self, name, place, robot=None, *, optional=False, **obstacles):
        """An activity that brings ``robot``, or the one that its parameter says, to a place."""
        activity = self.problem.add_motion_activity(name, 1, optional)
        activity.set_duration_bounds(1, 100)
        who = activity.add_parameter("who", self.hall.robot) if robot is None else robot
        goal = self.hall.poses[place]
        activity.add_motion_constraint(ActivityWaypoints(who, self.at(who), [goal], **obstacles))
        activity.add_motion_effect(who, goal)
        activity.add_effect(activity.end - 1, self.at(who), goal)
        return activity


def by_whoever(folder, **obstacles):
    site = Site(folder)
    for name in ERRANDS:
        site.visit(f"see_{name}", name, **obstacles)
    return site


def by_each(folder):
    """The same with an optional activity for each robot."""
    site = Site(folder)
    for name in ERRANDS:
        made = [
            site.visit(f"see_{name}_{r.name}", name, r, optional=True) for r in site.hall.robots
        ]
        manager = site.problem.environment.expression_manager
        one, other = (manager.auto_promote(a.present)[0] for a in made)
        site.problem.add_constraint(manager.Iff(one, manager.Not(other)))
    return site


ENGINES = ("samp-refine[cpsat]", "samp-refine[aries]")


def solve(problem, engine="samp-refine[cpsat]"):
    with OneshotPlanner(name=engine) as planner:
        return planner.solve(problem, timeout=60)


def chosen(plan):
    return {a.name: str(plan.get(a.get_parameter("who"))) for a in plan.activities}


def makespan(plan):
    return max(int(plan.get(a.end).constant_value()) for a in plan.activities)


def test_it_is_the_same_problem_as_one_activity_for_each(tmp_path):
    whoever = solve(by_whoever(tmp_path).problem)
    each = solve(by_each(tmp_path).problem)
    assert whoever.status is each.status is Status.SOLVED_OPTIMALLY
    assert makespan(whoever.plan) == makespan(each.plan)
    assert whoever.metrics["lower_bound"] == each.metrics["lower_bound"]


def test_whoever_goes_may_have_a_truth_value_beside(tmp_path):
    """Its copies for each robot have one, too: the same one."""
    site = Site(tmp_path, ("near",))
    visit = site.visit("see", "near")
    bright = visit.add_parameter("bright", BoolType())
    site.problem.add_constraint(
        Iff(bright, Equals(visit.get_parameter("who"), site.hall.robots[1]))
    )
    site.problem.add_constraint(bright)
    plan = solve(site.problem).plan
    assert chosen(plan) == {"see": "r1"}
    assert plan.get(bright).is_true()
    assert validate_plan(site.problem, plan).valid


@pytest.mark.parametrize("engine", usually("samp-refine[cpsat]", of=ENGINES))
def test_constraints_on_the_parameter_hold(tmp_path, engine):
    site = Site(tmp_path, ("near", "far"))
    visits = [site.visit(f"see_{name}", name) for name in ("near", "far")]
    who = [v.get_parameter("who") for v in visits]
    site.problem.add_constraint(Not(Equals(*who)))
    site.problem.add_constraint(Equals(who[0], site.hall.robots[1]))
    plan = solve(site.problem, engine).plan
    assert chosen(plan) == {"see_near": "r1", "see_far": "r0"}
    assert set(plan.trajectories) == {"see_near", "see_far"}
    assert validate_plan(site.problem, plan).valid


def test_optional_ones_stay_away(tmp_path):
    site = Site(tmp_path, ("near", "far"))
    site.visit("see_near", "near")
    site.visit("see_far", "far", optional=True)
    result = solve(site.problem)
    assert list(chosen(result.plan)) == ["see_near"]
    assert result.status is Status.SOLVED_OPTIMALLY


def test_plan_files_name_who_moved(tmp_path):
    problem = by_whoever(tmp_path).problem
    plan = solve(problem).plan
    written = json.loads(json.dumps(plan_to_dict(problem, plan)))
    assert {m["activity"]: m["object"] for m in written["motions"]} == chosen(plan)
    assert contradictions(problem, written) == []
    again = plan_from_dict(problem, written)
    assert validate_plan(problem, again).valid
    assert dependencies_of(problem, written).graph.tasks
    broken = copy.deepcopy(written)
    given = broken["activities"][0]["parameters"]
    given["who"] = {"r0": "r1", "r1": "r0"}[given["who"]]
    assert any(
        "the motion of" in c and "is not in the plan" in c for c in contradictions(problem, broken)
    )
    given["who"] = "near"
    with pytest.raises(ProblemError, match="'who' of activity 'see_"):
        contradictions(problem, broken)


def test_the_validator_sees_that_another_robot_is_named(tmp_path):
    problem = by_whoever(tmp_path).problem
    plan = solve(problem).plan
    first = plan.activities[0].get_parameter("who")
    manager = problem.environment.expression_manager
    other = {"r0": "r1", "r1": "r0"}[str(plan.assignment[first])]
    plan.assignment[first] = manager.ObjectExp(problem.object(other))
    assert not validate_plan(problem, plan).valid


@pytest.mark.parametrize("engine", usually("samp-refine[cpsat]", of=ENGINES))
def test_robot_origin_and_target_may_all_be_parameters(tmp_path, engine):
    """As planning problems say it: go(robot, origin, target), with places that have poses."""
    site = Site(tmp_path, ("near", "far"))
    problem, hall = site.problem, site.hall
    place = UserType("place")
    places = {name: Object(f"at_{name}", place) for name in ("left0", "left1", "near", "far")}
    problem.add_objects(places.values())
    pose = problem.add_fluent(Fluent("pose", hall.place, p=place))
    where = problem.add_fluent(Fluent("where", place, robot=hall.robot))
    for name, obj in places.items():
        problem.set_initial_value(pose(obj), hall.poses[name])
    for k, robot in enumerate(hall.robots):
        problem.set_initial_value(where(robot), places[f"left{k}"])
    for k in range(2):
        go = problem.add_motion_activity(f"go{k}", 1)
        go.set_duration_bounds(1, 100)
        who, origin, target = (
            go.add_parameter(n, t) for n, t in (("r", hall.robot), ("f", place), ("t", place))
        )
        go.add_motion_constraint(ActivityWaypoints(who, pose(origin), [pose(target)]))
        go.add_motion_effect(who, pose(target))
        go.add_condition(go.start, Equals(where(who), origin))
        go.add_effect(go.end, where(who), target)
    for k, name in enumerate(("far", "near")):
        problem.add_condition(GlobalEndTiming(), Equals(where(hall.robots[k]), places[name]))
    plan = solve(problem, engine).plan
    moved = {
        str(plan.get(a.get_parameter("r"))): str(plan.get(a.get_parameter("t")))
        for a in plan.activities
    }
    assert moved == {"r0": "at_far", "r1": "at_near"}
    assert validate_plan(problem, plan).valid


@pytest.mark.parametrize("kind", ["static_obstacles", "dynamic_obstacles_at_start"])
def test_a_fluent_of_one_parameter_tells_of_each_obstacle(tmp_path, kind):
    site = Site(tmp_path, ("near", "far"))
    told = {r: site.at for r in site.hall.robots}
    site.visit("see_near", "near", site.hall.robots[0], **{kind: told})
    site.visit("see_far", "far", **{kind: told})
    plan = solve(site.problem).plan
    assert validate_plan(site.problem, plan).valid
    (_, sooner), (later, _) = sorted(
        tuple(int(plan.get(t).constant_value()) for t in (a.start, a.end)) for a in plan.activities
    )
    assert sooner <= later or kind != "static_obstacles"


def test_what_is_not_taken_is_named(tmp_path):
    site = Site(tmp_path, ("near",))
    odd = site.problem.add_fluent(
        Fluent("odd", site.hall.place, robot=site.hall.robot, n=IntType(0, 1)),
        default_initial_value=site.hall.poses["near"],
    )
    told = {site.hall.robots[1]: odd}
    site.visit("see", "near", site.hall.robots[0], dynamic_obstacles_at_start=told)
    with pytest.raises(ProblemError, match="'see': the fluent 'odd' of its obstacle 'r1' has 2"):
        solve(site.problem)
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        problem = by_whoever(tmp_path).problem
        with pytest.raises(UnsupportedError, match="a plan to begin from"):
            planner.solve(problem, timeout=5, warm_start_plan=SequentialPlan([]))


def test_nothing_is_settled_where_all_are_named(tmp_path):
    assert settle_movers(by_each(tmp_path).problem) is None
