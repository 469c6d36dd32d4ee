"""What a modeller is told: what was recognised, and why something was not."""

from unified_planning.model import TimePointInterval, Timing
from unified_planning.shortcuts import Equals, OneshotPlanner

from tests.scheduling.cpsat.sites import shop, store
from tests.scheduling.cpsat.styles import Style
from tests.scheduling.cpsat.writer import write
from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession


def explained(problem):
    report = CpsatSession(problem, workers=1).solve(Deadline.after(300))
    return report.recognised, report.left_over


def test_routes_and_resources_are_named():
    recognised, left = explained(write(shop(2, 1, 2), Style(alone="busy")))
    assert "route at0: 30 moves, 4 stops, 2 needed open on the way" in recognised
    assert "resources and flags that are for one: 2" in recognised
    assert "exactly one of 2 activities: 2 times" in recognised
    assert left == ()


def test_a_fluent_with_parameters_is_told_as_written():
    recognised, _ = explained(write(store(1, 1), Style(fluents="parameter")))
    assert recognised[0] == "route at(r0): 8 moves, 2 stops, 1 needed open on the way, a way home"


def test_a_robot_that_may_do_two_things_at_once_is_no_route():
    problem = write(shop(1, 1, 2), Style())
    problem._base._constraints[:] = [
        (c, s) for c, s in problem._base._constraints if not (c.is_or() and c.arg(0).is_le())
    ]
    _, left = explained(problem)
    assert left == ("at0 is no route: nothing keeps all that changes it one at a time",)


def test_what_only_loosens_a_route_is_told():
    problem = write(shop(1, 1, 2), Style())
    crane = problem.add_activity("crane", 3, optional=True)
    crane.add_effect(crane.end, problem.fluent("at0")(), problem.object("p0"))
    recognised, left = explained(problem)
    assert recognised[0].startswith("route at0: 20 moves, 4 stops")
    assert left == ("beside route at0: crane is not kept apart from all else that changes it",)


def test_what_is_beside_the_routes_is_told():
    problem = write(shop(1, 1, 1), Style())
    beside = problem.add_activity("beside", 3)
    at = Equals(problem.fluent("at0")(), problem.object("p0"))
    beside.add_condition(TimePointInterval(Timing(0, beside.start)), at)
    _, left = explained(problem)
    assert left == ("1 activities are on no route (beside and others)",)


def test_the_engine_tells_it_in_its_metrics():
    problem = write(store(1, 1), Style(alone="uses"))
    with OneshotPlanner(name="cpsat", params={"workers": 1}) as planner:
        result = planner.solve(problem)
    assert "route at0" in result.metrics["recognised"]
    assert result.metrics["left_over"] == ""
    assert any("recognised: route at0" in m.message for m in result.log_messages)
