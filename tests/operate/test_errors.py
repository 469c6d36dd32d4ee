"""Robots that are wrong about where they are, and late, each by its own: kept apart, waited for and
let drive by that, and held where they are more wrong than was planned with.
"""

import math
from dataclasses import replace
from functools import partial

import pytest

from tests.operate.days import NONE, Day
from tests.operate.sites import hall
from tests.operate.wire import AgvFloor
from up_samp.execution.graph import At
from up_samp.execution.reports import Hold
from up_samp.execution.state import REACTION
from up_samp.model import ProblemError, UnsupportedError
from up_samp.operate.planner import check_site
from up_samp.operate.records import Settings

WRONG, LATE = {"r0": 0.15, "r1": 0.05}, {"r2": 2.0}
OTHERS, MARGIN = 0.06, 0.25


def mixed(folder, robots=3):
    """A hall with a robot that hardly knows where it is, an exact one, and a late one."""
    fleet = hall(folder, robots, localisation=OTHERS)
    site = fleet.records
    own = {
        n: replace(r, localisation=WRONG.get(n), latency=LATE.get(n))
        for n, r in site.robots.items()
    }
    fleet._hold(replace(site, robots=own, margin=MARGIN))
    return fleet


def begun(day, robot):
    executor = day.operation.executor
    way = executor and executor.state.of_object.get(robot)
    return way if way is not None and way.progress > 2.0 else None


def test_gates_clearances_and_braking_are_each_robots_own(tmp_path):
    day = Day(tmp_path, fleet=mixed(tmp_path))
    try:
        for k in range(3):
            day.order(f"o{k}", f"rack{k}", f"dock{k}", robots=[f"r{k}"])
        day.until(lambda: all(begun(day, f"r{k}") for k in range(3)))
        state = day.operation.executor.state
        errors = {**WRONG, "r2": OTHERS}
        assert {n: state.errors[n] for n in errors} == errors
        assert {n: day.operation.error(n) for n in errors} == errors
        for way in state.ways.values():
            late = 2.0 if way.object == "r2" else REACTION
            assert (way.error, way.reaction) == (errors[way.object], late)
            assert way.braked(1.0) == pytest.approx(late + 1.0 / (2 * way.travel.accel))
        told = 0
        for way in state.ways.values():
            for place, number in way.gates:
                event = state.graph.events[number]
                assert event.at is At.LEAVE
                told += 1
                assert place == pytest.approx(max(0.0, event.progress - errors[way.object]))
        for meeting in day.operation.executor.dependencies.meetings:
            pair = [life for life in (meeting.one, meeting.other) if life.drives]
            least = 0.01 + sum(errors[life.object] for life in pair)
            assert meeting.margin >= min(least, MARGIN) - 1e-9
        assert told
    finally:
        day.operation.close()


def test_all_are_as_late_as_the_settings_say_but_for_who_is_later(tmp_path):
    settings = Settings(stretch=20.0, latency=1.5)
    day = Day(tmp_path, fleet=mixed(tmp_path), settings=settings)
    try:
        for k in (1, 2):
            day.order(f"o{k}", f"rack{k}", f"dock{k}", robots=[f"r{k}"])
        day.until(lambda: all(begun(day, f"r{k}") for k in (1, 2)))
        late = {way.object: way.reaction for way in day.operation.executor.state.ways.values()}
        assert late == {"r1": 1.5, "r2": 2.0}
    finally:
        day.operation.close()


def as_told(folder, site, mishaps, seed):
    """AGVs as wrong, and as late, as their site says: part of it is how they follow their edges."""
    floor = AgvFloor(site, mishaps, seed, lost=0.05, twice=0.05)
    for name, agv in floor.agvs.items():
        agv.noise = (site.senses(name)["localisation"] - 0.03) / 2**0.5  # in x and in y
    floor.wire.lateness = {n: site.senses(n).get("latency", 0.5) / 2 for n in floor.agvs}
    return floor


@pytest.mark.long
@pytest.mark.parametrize("floor", [None, as_told], ids=["simulated", "vda"])
@pytest.mark.parametrize("seed", range(2))
def test_a_day_of_robots_with_errors_of_their_own(tmp_path, floor, seed):
    day = Day(
        tmp_path, fleet=mixed(tmp_path), floor=floor and partial(floor, tmp_path), seed=seed,
        settings=Settings(stretch=5.0, tick=0.4),
    )  # fmt: skip
    try:
        for k in range(9):
            day.order(f"o{k}")
        day.run(1500)
        assert day.verdict().good, (day.verdict(), day.story())
        assert {day.state(f"o{k}") for k in range(9)} == {"done"}
    finally:
        day.operation.close()


@pytest.mark.parametrize("version", ["2.1.0", "3.0.0"])
def test_who_is_less_sure_than_planned_with_is_held(tmp_path, version):
    quiet = partial(AgvFloor, lost=0.0, twice=0.0, late=0.0, version=version)
    day = Day(tmp_path, robots=1, mishaps=NONE, floor=quiet)
    try:
        day.order("o0", "rack0", "dock1")
        day.until(lambda: begun(day, "r0"))
        agv = day.robots.agvs["r0"]
        agv.deviation = 0.05
        day.operation.step()
        assert not day.operation.unsure
        agv.deviation, known = 0.3, begun(day, "r0").told
        day.until(lambda: day.operation.unsure, 5.0)
        assert isinstance(day.operation.commands["r0"], Hold)
        words = "it may be 0.30 m from where it tells to be, not 0.05 m"
        assert day.operation.commands["r0"].waiting_for == (words,)
        stop = day.clock.now() + 5.0
        day.until(lambda: day.clock.now() > stop)
        here = tuple(agv.pose)
        known = begun(day, "r0").told
        for _ in range(10):
            day.operation.step()
        assert tuple(agv.pose) == here
        assert agv.paused
        assert begun(day, "r0").told == known  # what it tells is not believed
        day.restart()
        assert day.operation.unsure == {"r0": words}
        agv.deviation = 0.01
        day.run()
        assert day.operation.unsure == {}
        assert day.state("o0") == "done"
        assert day.verdict().good, day.story()
        told = day.story()
        assert words in told
        assert "is sure again" in told
    finally:
        day.operation.close()


def test_an_agv_that_does_not_know_where_it_is_tells_no_pose(tmp_path):
    day = Day(tmp_path, robots=1, mishaps=NONE, floor=partial(AgvFloor, lost=0.0, twice=0.0))
    try:
        day.order("o0", "rack0", "dock1")
        day.until(lambda: begun(day, "r0"))
        day.robots.agvs["r0"].score = 0.0
        stop = day.clock.now() + 2.0
        day.until(lambda: day.clock.now() > stop)
        assert all(r.pose is None for r in day.robots.reports(day.clock.now()))
    finally:
        day.operation.close()


@pytest.mark.parametrize("kind", ["unsure", "silent"])
@pytest.mark.parametrize("seed", range(2))
def test_a_day_of_agvs_of_which_only_nodes_are_known(tmp_path, kind, seed):
    """Between two of them they drive on, and are not where they passed the last one: as if they
    stood there they were held, and planned anew from there.
    """
    day = Day(tmp_path, robots=2, mishaps=NONE, seed=seed, floor=partial(AgvFloor, late=0.3))
    try:
        for agv in day.robots.agvs.values():
            agv.score, plain = 0.0, agv.state_of_2
            if kind == "silent":
                agv.state_of_2 = lambda plain=plain: {**plain(), "agvPosition": None}
        for k in range(3):
            day.order(f"o{k}")
        day.until(lambda: any(begun(day, r) for r in ("r0", "r1")), 60)
        day.operation.hold()
        stop = day.clock.now() + 6.0
        day.until(lambda: day.clock.now() > stop)
        day.operation.release()
        day.run()
        assert {day.state(f"o{k}") for k in range(3)} == {"done"}
        assert "stands elsewhere" not in day.story(3000)
        assert day.verdict().good, day.story()
    finally:
        day.operation.close()


@pytest.mark.parametrize("metres", [9.0, 9.4])
def test_who_leaves_between_two_nodes_is_nowhere_until_somebody_says(tmp_path, metres):
    """Others were led to where it stood, metres beyond the node that it had passed."""
    quiet = partial(AgvFloor, lost=0.0, twice=0.0, late=0.0)
    day = Day(tmp_path, robots=2, mishaps=NONE, floor=quiet)
    try:
        agv = day.robots.agvs["r0"]
        agv.score = 0.0
        day.order("o0", "rack1", "dock1", robots=["r0"])
        start = day.robots.initial["r0"]
        day.until(lambda: math.dist(agv.pose[:2], start[:2]) > metres, 60)
        day.operation.leave("r0")
        for k, (pickup, delivery) in enumerate([("rack1", "dock0"), ("rack0", "dock2")]):
            day.order(f"p{k}", pickup, delivery, robots=["r1"])
        stop = day.clock.now() + 60.0
        day.until(lambda: day.clock.now() > stop)
        assert day.verdict().contacts == ()
        day.operation.leave("r0", "it stands there", tuple(agv.pose))
        day.until(lambda: {day.state("p0"), day.state("p1")} == {"done"}, 200)
        assert day.verdict().contacts == ()
    finally:
        day.operation.close()


def test_an_agv_that_misses_its_end_is_planned_from_where_it_stands(tmp_path):
    day = Day(tmp_path, robots=1, mishaps=NONE, floor=partial(AgvFloor, lost=0.0, twice=0.0))
    try:
        agv = day.robots.agvs["r0"]
        points, orders = agv.points, []

        def missed(edge, node):
            orders.append(agv.order["orderId"])
            *found, (x, y, theta) = points(edge, node)
            last = not agv.horizon and agv.ahead[-1][1] is node
            if last and orders[-1] == orders[0]:  # the end of its first motion
                x, y = x - 0.07 * math.cos(theta), y - 0.07 * math.sin(theta)
            return [*found, (x, y, theta)]

        agv.points = missed
        day.order("o0", "rack0", "dock1")
        day.run()
        assert day.state("o0") == "done"
        assert "robot r0 stands elsewhere" in day.story()
        assert day.verdict().contacts == (), day.story()
    finally:
        day.operation.close()


class Pushed(AgvFloor):
    """AGVs that are pushed by up to 8 cm each way, once where they stand, now and then."""

    def step(self, now, seconds):
        super().step(now, seconds)
        self.pushed = getattr(self, "pushed", set(self.agvs))
        for name, agv in self.agvs.items():
            if agv.way or agv.ahead:
                self.pushed.discard(name)
            elif name not in self.pushed and agv.random.random() < 0.02:
                self.pushed.add(name)
                agv.pose[0] += agv.random.uniform(-0.08, 0.08)
                agv.pose[1] += agv.random.uniform(-0.08, 0.08)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_a_day_of_agvs_that_are_pushed_off_their_places(tmp_path, seed):
    floor = partial(Pushed, lost=0.05, twice=0.05)
    settings = Settings(stretch=5.0, tick=0.4)
    day = Day(tmp_path, robots=3, mishaps=NONE, floor=floor, seed=seed, settings=settings)
    try:
        for k in range(5):
            day.order(f"o{k}")
        day.run(1200)
        assert {day.state(f"o{k}") for k in range(5)} == {"done"}
        assert day.verdict().contacts == (), day.story()
    finally:
        day.operation.close()


def test_errors_that_the_margin_does_not_cover_are_refused(tmp_path):
    fleet = hall(tmp_path, 2)
    check_site(fleet.records, 1.0)  # nobody says anything
    fleet._hold(replace(fleet.records, robots={
        "r0": replace(fleet.records.robots["r0"], localisation=0.2), **{
            n: r for n, r in fleet.records.robots.items() if n != "r0"
        }
    }))  # fmt: skip
    with pytest.raises(UnsupportedError, match=r"robot 'r0' may be 0.2 m .* margin of 0.26 m"):
        check_site(fleet.records, 0.05)
    fleet._hold(replace(fleet.records, margin=0.26))
    check_site(fleet.records, 0.05)


@pytest.mark.parametrize("name", ["localisation", "latency", "budget"])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_settings_that_cannot_be_are_refused(name, value):
    with pytest.raises(ProblemError, match=f"'{name}' cannot be"):
        Settings(**{name: value})
