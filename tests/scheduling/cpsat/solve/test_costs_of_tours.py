"""Tours by what their activities cost, from a schedule that is as short as can be."""

import threading

import pytest

from tests.fleet.test_rules import MAPS
from up_samp.fleet import Fleet
from up_samp.model import Deadline
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work
from up_samp.scheduling.cpsat.routing.list_scheduling import improve
from up_samp.scheduling.cpsat.solve.attempts import Attempts, Orders
from up_samp.scheduling.cpsat.solve.strategy import STAGES, Solve
from up_samp.tuning import Tuning
from up_samp.upio.plan import build_schedule
from up_samp.upio.read import read_problem
from up_samp.upio.write_relaxation import relax
from up_samp.validation import validate_schedule

PLACES = {"h1": (2.5, 3), "h2": (2.5, 13), "a": (9, 3), "b": (9, 13), "c": (19, 12), "d": (25, 4)}


def whole_of(objective):
    """All that is known of two robots with three orders: the shortest tour is driven by both."""
    fleet = Fleet(MAPS / "two_rooms.yaml", objective=objective)
    fleet.add_robot_type("agv", (1.0, 0.7), model="omni")
    for name, (x, y) in PLACES.items():
        fleet.add_place(name, x, y)
    for number in (1, 2):
        fleet.add_robot(f"r{number}", "agv", f"h{number}", end=f"h{number}")
    for number, ends in enumerate(("ac", "ca", "bd")):
        fleet.add_order(f"o{number}", *ends)
    problem = relax(fleet.problem, read_problem(fleet.problem)).problem
    model = ScheduleModel(problem)
    orders = Orders(0, 1, True, Tuning(), threading.Event())
    whole = Attempts(model, orders, Deadline.never(), None)
    tour = improve(find_work(model, find_routes(model)), 200, 0, Deadline.never())
    assert whole.realize(tour.schedule)
    return problem, whole


def stage():
    return next(s for s in STAGES if s.name == "anneal tours by their costs")


def test_a_schedule_that_costs_less_is_found_and_is_one():
    problem, whole = whole_of({"distance": 1})
    short = whole.value
    search = Solve(whole)
    assert stage().applies(search)
    stage().run(search)
    assert search.better
    assert whole.value < 0.95 * short
    assert not validate_schedule(problem, build_schedule(problem, whole.best)).violations


@pytest.mark.parametrize("objective", ["makespan", {"distance": 1, "completion": 1}])
def test_where_something_else_counts_nothing_is_annealed(objective):
    assert not stage().applies(Solve(whole_of(objective)[1]))
