"""Quantifiers over configurations and movable objects mean what they say when written out."""

from unified_planning.shortcuts import (
    And,
    BoolType,
    ClosedTimeInterval,
    Equals,
    Exists,
    Fluent,
    Forall,
    GlobalEndTiming,
    Not,
    Or,
    Timing,
    Variable,
)

from tests.upio.hall import Hall
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.upio import read_problem, relax


def during(activity):
    return ClosedTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def some(choices, of, written_out):
    """Return that ``of`` holds for one of the objects ``choices``, by a quantifier or not."""
    variable = Variable("v", choices[0].type)
    return Or([of(c) for c in choices]) if written_out else Exists(of(variable), variable)


def every(choices, of, written_out):
    variable = Variable("v", choices[0].type)
    return And([of(c) for c in choices]) if written_out else Forall(of(variable), variable)


def watch(folder, written_out):
    """Two robots drive; somebody looks around while any of them is on the right; the floor is
    swept wherever they were, and has to be dry where anybody comes to.
    """
    hall = Hall(folder, robots=2)
    problem, robots, places = hall.problem, hall.robots, list(hall.poses.values())
    at = problem.add_fluent(Fluent("at", hall.place, who=hall.robot))
    wet = problem.add_fluent(
        Fluent("wet", BoolType(), where=hall.place), default_initial_value=False
    )
    for k, robot in enumerate(robots):
        problem.set_initial_value(at(robot), hall.poses[f"left{k}"])
        move = hall.move(f"go{k}", k, f"left{k}", f"right{k}", bounds=(5 + k, 100))
        move.add_effect(move.end - 1, at(robot), hall.poses[f"right{k}"])
        dry = every(places, lambda p: Not(wet(p)), written_out)
        move.add_condition(Timing(0, move.start), dry)
    look = problem.add_activity("look", 3)
    right = hall.poses["right1"]
    look.add_condition(during(look), some(robots, lambda r: Equals(at(r), right), written_out))
    sweep = problem.add_activity("sweep", 2)
    if written_out:
        for place in places:
            sweep.add_effect(sweep.end, wet(place), True)
    else:
        variable = Variable("v", hall.place)
        sweep.add_effect(sweep.end, wet(variable), True, forall=[variable])
    problem.add_condition(GlobalEndTiming(), every(places, wet, written_out))
    return problem


def best(problem):
    relaxation = relax(problem, read_problem(problem))
    report = CpsatSession(relaxation.problem, workers=1).solve(Deadline.after(20.0))
    assert report.status is ScheduleStatus.OPTIMAL
    return report.schedule.makespan


def test_quantifiers_over_places_and_robots(tmp_path):
    found = []
    for written_out in (False, True):
        folder = tmp_path / str(written_out)
        folder.mkdir()
        found.append(best(watch(folder, written_out)))
    assert found[0] == found[1] == 9  # go1 in [0, 6], its effect at 5, look in [6, 9]
