"""Tours and the collapsed problem: bounds stay true, quick schedules hold."""

import itertools
import random
from pathlib import Path

import pytest
from unified_planning.model import ClosedTimeInterval, OpenTimeInterval, TimePointInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LT,
    Equals,
    IntType,
    MinimizeMakespan,
    Not,
    Or,
    UserType,
)

from tests.scheduling.cpsat.encode.test_alternatives import exactly_one
from tests.scheduling.cpsat.random_routes import whole
from up_samp.benchmarks import job_shop
from up_samp.benchmarks.instances import instance
from up_samp.fleet import Fleet
from up_samp.model import Deadline, ScheduleStatus
from up_samp.refinement import rules
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.normal import Watcher
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_unit_places, find_work
from up_samp.scheduling.cpsat.routing.list_scheduling import improve
from up_samp.scheduling.cpsat.solve import strategy as search
from up_samp.upio import read_problem, relax
from up_samp.upio.plan import build_schedule
from up_samp.upio.write_refinements import write_refinement
from up_samp.validation import validate_schedule

MAPS = Path(__file__).parents[4] / "examples" / "maps"


class RandomShop:
    """One or two robots between two or three places, a door that holds still during moves, places
    for one, tasks with alternatives: small enough to be solved without any routes.
    """

    def __init__(self, seed):
        self.rng = rng = random.Random(seed)
        self.problem = SchedulingProblem(f"shop{seed}")
        spot, leaf = UserType("spot"), UserType("leaf")
        self.spots = [self.problem.add_object(f"s{i}", spot) for i in range(rng.randint(2, 3))]
        shut, opened = (self.problem.add_object(n, leaf) for n in ("shut", "open"))
        self.door = self.problem.add_fluent("door", leaf, default_initial_value=shut)
        self.shut, self.opened = shut, opened
        self.inner = rng.choice([None, self.spots[-1]])
        self.robots = range(rng.randint(1, 2))
        self.moves, self.busy = [], {r: [] for r in self.robots}
        lengths = {p: rng.randint(1, 4) for p in itertools.permutations(self.spots, 2)}
        self.at = [
            self.problem.add_fluent(f"at{r}", spot, default_initial_value=self.spots[0])
            for r in self.robots
        ]
        for r in self.robots:
            for (a, b), length in lengths.items():
                self._move(r, a, b, length)
        self._tasks()
        if rng.random() < 0.5:
            self._place_for_one(self.spots[1])
        for r in self.robots:  # wherever it is then
            if rng.random() < 0.4:
                self.busy[r].append(self.problem.add_activity(f"rest{r}", rng.randint(1, 4)))
        for activities in self.busy.values():
            for a, b in itertools.combinations(activities, 2):
                scope = [x.present for x in (a, b) if x.optional]
                self.problem.add_constraint(Or(LT(a.end, b.start), LT(b.end, a.start)), scope)
        self.problem.add_quality_metric(MinimizeMakespan())

    def _move(self, r, a, b, length):
        m = self.problem.add_activity(f"m{r}_{a.name}_{b.name}", length, optional=True)
        m.add_condition(whole(m), Equals(self.at[r](), a))
        m.add_effect(m.end, self.at[r](), b)
        inside = OpenTimeInterval(Timing(0, m.start), Timing(0, m.end))
        m.add_condition(inside, Equals(self.door(), self.door()))
        if b is self.inner:
            late = ClosedTimeInterval(Timing(-min(1, length - 1), m.end), Timing(0, m.end))
            m.add_condition(late, Not(Equals(self.door(), self.shut)))
        self.moves.append((m, a, b))
        self.busy[r].append(m)

    def _stand(self, name, r, place, length):
        a = self.problem.add_activity(name, length, optional=True)
        a.add_condition(whole(a), Equals(self.at[r](), place))
        self.busy[r].append(a)
        return a

    def _tasks(self):
        rng, ways = self.rng, []
        for t in range(rng.randint(2, 4)):
            place, length = rng.choice(self.spots), rng.randint(1, 3)
            ways.append([self._stand(f"t{t}_{r}", r, place, length) for r in self.robots])
            exactly_one(self.problem, ways[-1])
        for some, others in itertools.combinations(ways, 2):
            if rng.random() < 0.4:
                for a, b in itertools.product(some, others):
                    self.problem.add_constraint(LT(a.end, b.start), [a.present, b.present])
        button = rng.choice([s for s in self.spots if s is not self.inner])
        for r in self.robots:
            o = self._stand(f"open{r}", r, button, 1)
            o.add_condition(TimePointInterval(Timing(0, o.start)), Equals(self.door(), self.shut))
            o.add_effect(o.end, self.door(), self.opened)

    def _place_for_one(self, place):
        free = self.problem.add_fluent("free", IntType(0, 1), default_initial_value=1)
        for m, a, b in self.moves:
            if b is place:
                m.add_decrease_effect(m.end, free, 1)
            if a is place:
                m.add_increase_effect(m.start, free, 1)


def outcome(problem):
    report = CpsatSession(problem, workers=1).solve(Deadline.after(30))
    if report.schedule is not None:
        plan = build_schedule(problem, report.schedule)
        assert not validate_schedule(problem, plan).violations
    return report.status, report.schedule and report.schedule.makespan


def check_seeds(seeds, monkeypatch):
    collapsed = 0
    for seed in seeds:
        problem = RandomShop(seed).problem
        found = outcome(problem)
        assert found[0] in (ScheduleStatus.OPTIMAL, ScheduleStatus.INFEASIBLE), seed
        with monkeypatch.context() as patch:
            patch.setattr(search, "find_routes", lambda _: [])
            assert outcome(problem) == found, seed
        model = ScheduleModel(problem)
        collapsed += bool(find_routes(model))
    assert collapsed > len(seeds) // 2


@pytest.mark.parametrize("block", range(3))
def test_collapsing_changes_no_optimum(block, monkeypatch):
    check_seeds(range(block * 8, block * 8 + 8), monkeypatch)


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_collapsing_changes_no_optimum_of_many(block, monkeypatch):
    check_seeds(range(1000 + block * 60, 1060 + block * 60), monkeypatch)


def test_places_for_one_and_stillness_are_recognised():
    for seed in range(40):
        shop = RandomShop(seed)
        model = ScheduleModel(shop.problem)
        routes = find_routes(model)
        if routes and "free" in {f.name for f in shop.problem.fluents}:
            units = find_unit_places(model, routes)
            assert [len(u.places) for u in units] == [len(routes)]
            assert all(("door",) in route.still for route in routes)
            return
    raise AssertionError("no random shop has a place for one")


def test_stated_places_are_unary_places_of_routes():
    samp = instance("logistics-dc-oc-r2-i2").build("fluents")
    relaxation = relax(samp, read_problem(samp))
    routes = [f"move_robot{r}_" for r in range(2)]
    moves = [n for n in relaxation.activities if n.startswith(tuple(routes))]
    coming = [n for n in moves if n.endswith("to_door0_button")]
    leaving = [n for n in moves if "door0_button_to" in n]
    place = rules.unary_place("button", coming, leaving, taken=False)
    write_refinement(relaxation, place)
    model = ScheduleModel(relaxation.problem)
    units = find_unit_places(model, find_routes(model))
    assert [len(unit.places) for unit in units] == [2]


@pytest.mark.parametrize(
    "size", [(1, 2, 2), (2, 3, 2), pytest.param((3, 3, 4), marks=pytest.mark.long)]
)
def test_tours_of_job_shops_are_schedules(size):
    samp = job_shop(*size)
    problem = relax(samp, read_problem(samp)).problem
    model = ScheduleModel(problem)
    work = find_work(model, find_routes(model))
    tour = improve(work, 50, 0, Deadline.never())
    assert not validate_schedule(problem, build_schedule(problem, tour.schedule)).violations
    again = improve(work, 50, 0, Deadline.never())
    assert again.schedule == tour.schedule


def check_tour_without(model, absent):
    problem = model.problem
    tour = improve(find_work(model, find_routes(model)), 0, 0, Deadline.never())
    assert absent not in tour.schedule.times
    assert not validate_schedule(problem, build_schedule(problem, tour.schedule)).violations


@pytest.mark.parametrize("kind", ["move_", "r0_"])
def test_tours_do_without_what_never_happens(kind):
    """Motion proofs state in advance, or between two solves, that something cannot be done."""
    problem = relax(samp := job_shop(2, 3, 2), read_problem(samp)).problem
    model = ScheduleModel(problem)
    watcher = Watcher(problem)
    watcher.look()
    tour = improve(find_work(model, find_routes(model)), 0, 0, Deadline.never())
    absent = min((times, n) for n, times in tour.schedule.times.items() if n.startswith(kind))[1]
    problem.add_constraint(Not(problem.get_activity(absent).present))
    model.grow(watcher.look())
    check_tour_without(model, absent)
    check_tour_without(ScheduleModel(problem), absent)


def deliveries(seed, charger):
    """Two robots that carry one or two things each, some with a battery that does not last."""
    rng = random.Random(seed)
    battery = {"capacity": 100, "per_metre": 1.0, "reserve": 2, "level": rng.choice([35, 60])}
    fleet = Fleet(MAPS / "two_rooms.yaml")
    fleet.add_robot_type(
        "agv", (1.2, 0.8), model="diff", v_max=2.0, a_max=1.0, omega_max=2.0,
        capacity={"totes": rng.choice([1, 2])}, **({"battery": battery} if seed % 3 else {}),
    )  # fmt: skip
    fleet.add_place("plug", 2, 12.5, charger=charger)
    places = {"a": (7, 3), "b": (12, 12), "c": (25, 4), "h0": (2, 3), "h1": (4, 6)}
    for name in rng.sample(list(places), len(places)):
        fleet.add_place(name, *places[name])
    for k in rng.sample((0, 1), 2):
        breaks = [{"duration": 20, "window": (0, 300)}] if seed % 2 and not k else []
        fleet.add_robot(f"r{k}", "agv", f"h{k}", end=f"h{k}", breaks=breaks)
    for k in range(3):
        fleet.add_order(f"o{k}", *rng.sample("abc", 2), load={"totes": 1})
    return fleet


PLUG, SWAP = {"per_second": 2.0, "step": 10}, {"swap": 25}


@pytest.mark.parametrize(
    ("seed", "charger"), [(0, PLUG), (1, PLUG), (2, PLUG), (3, PLUG), (1, SWAP), (2, SWAP)]
)
def test_tours_of_fleets_bring_what_they_fetched_and_charge_in_time(seed, charger):
    samp = deliveries(seed, charger).problem
    problem = relax(samp, read_problem(samp)).problem
    model = ScheduleModel(problem)
    work = find_work(model, find_routes(model))
    assert work is not None  # breaks are work, too
    tour = improve(work, 40, 0, Deadline.never())
    assert tour is not None
    assert not validate_schedule(problem, build_schedule(problem, tour.schedule)).violations
    assert sum(name.startswith("deliver_") for name in tour.schedule.times) == 3
