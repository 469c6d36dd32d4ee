"""Robots break down, join and are held; areas are blocked; orders are changed and cancelled."""

import math
import random

import numpy as np
import pytest
from shapely.geometry import box

from tests.operate.days import Day, Here
from tests.operate.sites import hall
from up_samp.execution.reports import Heard, Hold, Report
from up_samp.fleet.faults import find_faults
from up_samp.model import ProblemError
from up_samp.operate.choice import body_at
from up_samp.operate.horizon import Cut
from up_samp.operate.judge import where
from up_samp.operate.planner import problem_records
from up_samp.operate.simulated import Mishaps
from up_samp.operate.stitch import Kept, Question


@pytest.fixture
def day(tmp_path, request):
    made = Day(tmp_path, **getattr(request, "param", {}))
    yield made
    made.operation.close()


def under_way(day, robot):
    way = day.operation.executor and day.operation.executor.state.of_object.get(robot)
    return way is not None and way.progress > 2.0


@pytest.mark.parametrize(
    "day", [{"robots": 2, "mishaps": Mishaps(breakdowns=((9.0, "r0", 60.0),))}], indirect=True
)
def test_the_order_of_a_broken_robot_is_done_by_another_one(day):
    day.order("o0", "rack0", "dock0", robots=["r0"])
    day.until(lambda: under_way(day, "r0"))
    day.operation.add({"id": "o0b", "pickup": "shelf2", "delivery": "dock2"})
    day.until(lambda: day.clock.now() >= 9.0)
    day.operation.leave("r0", "broken")
    here = day.robots.pose("r0")
    assert math.dist(day.operation.poses["r0"][:2], here[:2]) < 1.0  # it brakes
    day.until(lambda: day.state("o0b") == "done", 200)
    assert day.operation.jobs["o0b"].robot == "r1"
    day.until(lambda: day.clock.now() >= 70.0)
    day.operation.join("r0")
    day.run()
    assert day.state("o0") == "done"
    verdict = day.verdict()
    assert verdict.good, (verdict, day.story())


def test_what_a_broken_robot_was_to_do_is_given_to_another_one(day):
    day.order("o0", "rack0", "dock2")
    day.until(lambda: any(under_way(day, r) for r in ("r0", "r1")))
    (first,) = (r for r in ("r0", "r1") if under_way(day, r))
    day.operation.leave(first, "broken")
    day.until(lambda: day.state("o0") == "done", 200)
    assert day.operation.jobs["o0"].robot == {"r0": "r1", "r1": "r0"}[first]
    assert day.verdict().good


@pytest.mark.parametrize("say", ["leave", "join"])
def test_nobody_is_said_to_stand_where_another_one_does(day, say):
    here = day.operation.pose("r1")
    day.operation.leave("r0", "pushed aside")
    with pytest.raises(ProblemError, match="cannot stand at"):
        getattr(day.operation, say)("r0", pose=here)
    beside = (here[0], here[1] + 0.55, here[2])  # as near as somebody measures it
    getattr(day.operation, say)("r0", pose=beside)
    assert day.operation.pose("r0") == beside


def test_who_was_moved_by_hand_goes_on_from_where_it_stands(day):
    """Nobody knows but who says so: its way is not driven on, from elsewhere."""
    day.order("o0", "rack0", "dock2")
    day.until(lambda: any(under_way(day, r) for r in ("r0", "r1")))
    (name,) = (r for r in ("r0", "r1") if under_way(day, r))
    robots, here = day.robots, (6.0, 8.5, 1.0)
    day.operation.leave(name, "pushed aside", here)
    for _ in range(10):  # it still tells how far it is on its way
        day.operation.step()
    assert day.operation.pose(name) == here
    robots.put(name, here)
    drives = len(robots.drives)
    day.operation.join(name, here)
    assert day.operation.pose(name) == here
    assert isinstance(day.operation.commands[name], Hold)
    day.run()
    assert day.state("o0") == "done"
    robots.close()
    later = [d.rows[0][1:] for d in robots.drives[drives:] if d.robot == name]
    assert math.dist(later[0], here) < 0.05 if later else day.operation.jobs["o0"].robot != name


@pytest.mark.parametrize("day", [{"robots": 1}], indirect=True)
def test_who_stands_elsewhere_as_the_day_begins_is_planned_from_there(day):
    robots, here, said = day.robots, (6.0, 8.5, 1.0), day.robots.reports

    def reports(now):
        standing = robots.robots["r0"].motion is None
        return [*said(now), *([Report("r0", now, pose=here)] if standing else ())]

    robots.put("r0", here)
    robots.reports = reports
    day.until(lambda: day.clock.now() > 8.0)
    assert day.operation.pose("r0") == here
    day.order("o0", "rack0", "dock2")
    day.run()
    assert day.verdict().good, day.story()
    assert robots.drives[1].rows[0][1:] == pytest.approx(here, abs=0.01)


@pytest.mark.parametrize("day", [{"robots": 1}], indirect=True)
def test_what_a_robot_drove_before_it_was_moved_by_hand_is_known_after_a_restart(day):
    """Others were let pass by it: they would seem to stand where they never could come to."""
    day.order("o0", "rack0", "dock2")
    day.until(lambda: under_way(day, "r0"))
    day.operation.leave("r0", "pushed aside", (6.0, 8.5, 1.0))
    known = day.operation.executor.save()
    day.restart()
    after = day.operation.executor.save()
    assert known["motions"] == after["motions"]
    assert known["motions"][0]["progress"] > 2.0
    assert known["strayed"].keys() == after["strayed"].keys() == {"r0"}


def test_everybody_is_held_at_once_and_released_one_by_one(day):
    day.order("o0", "rack0", "dock0")
    day.until(lambda: any(under_way(day, r) for r in ("r0", "r1")))
    assert day.operation.commands.keys() >= {"r0", "r1"}  # who is in no plan is told to stay, too
    state = day.operation.executor.state
    for way in state.of_object.values():
        assert way.progress < state.braking(way) <= state.until(way)
    day.operation.hold(why="emergency stop")
    stop = day.clock.now() + 10.0
    day.until(lambda: day.clock.now() >= stop)
    here = {r: day.robots.pose(r) for r in ("r0", "r1")}
    stop = day.clock.now() + 5.0
    day.until(lambda: day.clock.now() >= stop)
    assert here == {r: day.robots.pose(r) for r in ("r0", "r1")}
    for robot in ("r0", "r1"):
        day.operation.release(robot)
    day.run()
    assert day.verdict().good


@pytest.mark.parametrize("day", [{"robots": 1}], indirect=True)
def test_who_leaves_off_its_path_stands_where_it_told_to_be(day):
    """Not on its path."""
    day.order("o0", "rack0", "dock0")
    day.until(lambda: under_way(day, "r0"))
    operation = day.operation
    x, y, theta = operation.pose("r0")
    beside = (x, y + 1.0, theta)
    now = operation.clock.now() - operation.origin
    assert operation.executor.update("r0", pose=beside, now=now).heard is Heard.HELD
    assert operation.pose("r0") == pytest.approx(beside)
    operation.leave("r0")
    assert operation.poses["r0"] == pytest.approx(beside)


def test_nobody_enters_a_blocked_area(day):
    day.order("o0", "rack1", "dock1")
    day.until(lambda: any(under_way(day, r) for r in ("r0", "r1")))
    # the whole middle: between the shelves and the lower wall
    day.operation.block("people", [(9.5, 0.3), (11.5, 0.3), (11.5, 3.9), (9.5, 3.9)])
    day.run()
    assert day.state("o0") == "done"
    assert day.verdict().good
    for drive in day.robots.drives:
        assert not any(9.5 < x < 11.5 and y < 3.9 for _, x, y, _ in drive.rows)


def test_areas_are_called_as_anything(tmp_path):
    """Also as a robot, a place or a zone of the site, which stays what it is."""
    fleet = hall(tmp_path, 1)
    fleet.add_zone("slow", [(4.0, 1.0), (8.0, 1.0), (8.0, 13.0), (4.0, 13.0)], v_max=0.5)
    site = fleet.records
    shapes = {n: ((12.0, k), (12.3, k), (12.3, k + 0.3))
              for k, n in enumerate(("r0", "rack0", "slow", "wet / floor"))}  # fmt: skip
    cut = Cut(0.0, poses={"r0": site.places["home0"].pose})
    ask = Question(1, site, tmp_path, cut, Kept(), (), ("r0",), areas=shapes)
    left = problem_records(ask)
    assert find_faults(left) == []
    assert left.zones["slow"] == site.zones["slow"]
    closed = [z.polygon for z in left.zones.values() if z.keep_out == ("agv",)]
    assert sorted(closed) == sorted(shapes.values())
    assert left.zones.keys().isdisjoint({*left.robots, *left.places})


@pytest.mark.parametrize("what", ["another", "the same again", "restart"])
@pytest.mark.parametrize("day", [{"robots": 1}], indirect=True)
def test_who_stands_before_a_blocked_area_stays_out_whatever_happens_then(day, what):
    """It stands, and could not if it drove as fast as it may there."""
    day.order("o0", "rack1", "dock1")
    day.until(lambda: under_way(day, "r0"))
    operation, way = day.operation, day.operation.executor.state.of_object["r0"]
    path = operation.executor.drives[way.activity, "r0"].path
    ahead = operation.executor.state.braking(way) + 1.5
    x, y, _ = path.poses_at(np.array([ahead]))[0]
    people = box(x - 0.4, y - 0.4, x + 0.4, y + 0.4)
    operation.block("people", people.exterior.coords[:-1])
    limit = operation.executor.state.limits[way.activity]
    day.until(lambda: way.told > limit - 0.1, 10)
    if what == "restart":
        day.restart()
    else:
        shape = people if what == "the same again" else box(20, 12, 21, 13)
        operation.block("more" if what == "another" else "people", shape.exterior.coords[:-1])
    assert day.operation.executor.state.limits[way.activity] == pytest.approx(limit, abs=0.2)
    day.run()
    assert day.state("o0") == "done"
    assert day.verdict().good
    for drive in day.robots.drives:
        rows = np.array(drive.rows)[:, 1:]
        assert not any(body_at(day.fleet.records, "r0", p).intersects(people) for p in rows)


def test_an_area_is_blocked_while_somebody_brakes_for_its_goal(day):
    """Told late, it could stop only beyond the end of its way."""
    day.order("o0", "rack0", "dock0")

    def brakes():
        ways = day.operation.executor and day.operation.executor.state.of_object.values()
        return any(0.2 < way.length - way.progress < 0.6 for way in ways or ())

    day.until(brakes)
    day.operation.block("elsewhere", [(20.0, 12.0), (21.0, 12.0), (21.0, 13.0)])
    assert day.operation.executor.state.limits == {}


def test_orders_are_cancelled_and_changed_until_they_begin(day):
    day.order("o0", "rack0", "dock0")
    day.order("o1", "rack1", "dock1")
    day.order("o2", "rack2", "dock2")
    day.until(lambda: sum(day.state(f"o{k}") == "planned" for k in range(3)) >= 2, 60)
    day.operation.cancel("o2")
    day.until(lambda: day.state("o0") == "begun")
    with pytest.raises(ProblemError, match="it cannot be cancelled"):
        day.operation.cancel("o0")
    with pytest.raises(ProblemError, match="it cannot be changed"):
        day.order("o0", "rack1", "dock1")
    day.run()
    assert [day.state(f"o{k}") for k in range(3)] == ["done", "done", "cancelled"]
    verdict = day.verdict()
    assert verdict.good, (verdict, day.story())


def on_the_way(day, robot="r0", metres=2.0):
    """Run until a robot is on its way to where an order is picked up."""
    day.until(lambda: under_way(day, robot) or day.state("o0") == "begun", 60)
    assert day.state("o0") == "planned", day.story()


def handled_at(day, name):
    """Return where an order was picked up and delivered, by where its robot really was."""
    day.robots.close()
    mine = [h for h in day.robots.handled if h.what == name and h.kind in ("pick", "deliver")]
    return [where(h.robot, h.end, day.robots.initial, day.robots.drives)[:2] for h in mine]


@pytest.mark.parametrize("again", [False, True], ids=["", "and the process is restarted"])
@pytest.mark.parametrize("day", [{"robots": 1}], indirect=True)
def test_an_order_that_is_changed_while_somebody_is_on_the_way_is_done_as_changed(day, again):
    day.order("o0", "rack0", "dock0")
    on_the_way(day)
    day.order("o0", "shelf2", "dock2")
    if again:
        day.restart()
    day.run()
    assert day.state("o0") == "done"
    verdict = day.verdict()
    assert verdict.good, (verdict, day.story())
    places = day.fleet.records.places
    for spot, here in zip(("shelf2", "dock2"), handled_at(day, "o0"), strict=True):
        assert math.dist(places[spot].pose[:2], here) < 0.3


@pytest.mark.parametrize("again", [False, True], ids=["", "and the process is restarted"])
@pytest.mark.parametrize("day", [{"robots": 1}], indirect=True)
def test_an_order_that_is_cancelled_while_somebody_is_on_the_way_is_not_done(day, again):
    day.order("o0", "rack0", "dock0")
    on_the_way(day)
    day.operation.cancel("o0")
    if again:
        day.restart()
    day.order("o1", "rack2", "dock2")
    day.run()
    assert (day.state("o0"), day.state("o1")) == ("cancelled", "done")
    assert handled_at(day, "o0") == []
    assert day.verdict().good


class Slow(Here):
    """A planner whose answers come when they are let."""

    come = False

    def taken(self, wait=False):
        return self.said if self.come else None


@pytest.mark.parametrize("day", [{"robots": 1, "planner": Slow}], indirect=True)
def test_a_plan_that_was_asked_for_before_an_order_was_changed_is_not_followed(day):
    day.order("o0", "rack0", "dock0")
    for _ in range(2):
        day.operation.step()
    day.order("o0", "shelf2", "dock2")
    Slow.come = True
    day.run()
    spot = day.fleet.records.places["shelf2"].pose
    assert math.dist(spot[:2], handled_at(day, "o0")[0]) < 0.3
    assert day.verdict().good


@pytest.mark.parametrize("moved", [False, True], ids=["", "and is moved"])
@pytest.mark.parametrize("kind", ["pick", "deliver"])
@pytest.mark.parametrize("day", [{"robots": 2}], indirect=True)
def test_an_order_is_not_lost_with_who_leaves_while_it_handles_it(day, kind, moved):
    """Picked up in part it is picked up again, by anybody; delivered in part by who has it."""
    day.order("o0", "rack0", "dock0", robots=["r0"])
    doing = f"do {kind}_o0"
    day.until(lambda: doing in day.story(3), 100)
    here = (3.0, 9.0, 0.0) if moved else None
    if moved:
        day.robots.put("r0", here)
    day.operation.leave("r0", "out of order", here)
    day.order("o1", "shelf2", "dock2", robots=["r1"])
    day.until(lambda: day.state("o1") == "begun", 100)  # another plan
    day.operation.join("r0")
    day.run()
    assert (day.state("o0"), day.state("o1")) == ("done", "done"), day.story()
    verdict = day.verdict()
    wrong = (*verdict.contacts, *verdict.lost, *verdict.elsewhere)
    assert not wrong, (verdict, day.story())


@pytest.mark.parametrize("day", [{"robots": 2}], indirect=True)
def test_others_keep_away_at_once_from_who_is_put_on_their_way(day):
    day.order("o0", "rack0", "dock0", robots=["r0"])
    on_the_way(day, metres=1.0)
    way = day.operation.executor.state.of_object["r0"]
    path = day.operation.executor.drives[way.activity, "r0"].path
    x, y, theta = path.poses_at([way.progress + 6.0])[0]
    day.robots.put("r1", (x, y, theta))
    day.operation.leave("r1", "by hand", (x, y, theta))
    day.order("o1", "shelf2", "dock2", robots=["r1"])
    stop = day.clock.now() + 8.0
    day.until(lambda: day.clock.now() >= stop)
    day.operation.join("r1")
    day.run()
    assert (day.state("o0"), day.state("o1")) == ("done", "done"), day.story()
    assert day.verdict().good


@pytest.mark.parametrize("day", [{"robots": 2}], indirect=True)
def test_robots_are_let_drive_a_little_farther_than_they_can_stand(day):
    """And no plan that is taken over makes that less."""
    for k in range(6):
        day.order(f"o{k}", f"rack{k % 3}", f"dock{(k + 1) % 3}")
    let, far = {}, 0.0
    while not day.operation.idle:
        day.operation.step()
        executor = day.operation.executor
        for way in executor.state.of_object.values() if executor else ():
            gone = day.operation.gone.get(way.activity, 0.0)
            key = way.activity, way.object
            assert way.let + gone >= let.get(key, 0.0) - 0.01
            let[key] = way.let + gone
            far = max(far, way.let - way.progress)
    assert 2.0 < far < 8.0
    assert day.verdict().good


@pytest.mark.parametrize("end", ["pickup", "delivery"])
def test_nobody_is_planned_to_go_where_somebody_stands_for_good(day, end):
    """Others are not to wait for such orders, however late those are."""
    ends = {"pickup": "rack0", "delivery": "dock0"}
    x, y, theta = day.fleet.records.places[ends[end]].pose
    day.robots.put("r1", (x + 0.3, y + 0.6, theta + 0.4))  # beside it
    day.operation.leave("r1", "broken", day.robots.pose("r1"))
    other = {"pickup": "shelf2", "delivery": "dock1"}
    day.order("covered", **{**other, end: ends[end]}, due=1.0)
    day.order("free", **other, due=600.0)
    day.until(lambda: day.state("free") == "done", 120)
    assert day.state("covered") == "waiting"
    assert all(taken for *_, taken in day.operation.costs)
    day.operation.join("r1")
    day.run()
    assert day.state("covered") == "done"
    assert day.verdict().good, day.story()


def test_nobody_takes_up_what_cannot_be_brought_where_somebody_broke_down_meanwhile(day):
    places = day.fleet.records.places
    day.order("o0", "rack0", "dock0", robots=["r0"])
    day.until(lambda: day.state("o0") == "planned")
    day.robots.put("r1", places["dock0"].pose)
    day.operation.leave("r1", "broken down", places["dock0"].pose)
    assert day.state("o0") == "waiting"
    day.order("o1", "rack2", "dock2")
    day.until(lambda: day.state("o1") == "done")
    assert not day.operation.on_board()
    assert day.state("o0") == "waiting"
    day.robots.put("r1", places["home1"].pose)
    day.operation.join("r1", places["home1"].pose)
    day.run()
    assert day.state("o0") == "done"
    assert day.verdict().good, day.story()


def test_what_no_plan_was_found_for_is_put_aside_longer_each_time(day):
    operation = day.operation
    for seconds in (30.0, 60.0, 120.0):
        operation.put_aside(["o"], ["r0"])
        assert operation.aside == {"o": seconds, "r0": seconds}
    operation.again = 5.0
    assert operation.turns() == (0.0,)
    day.until(lambda: day.clock.now() >= 5.0)
    assert operation.turns() == (day.clock.now(), math.inf)
    operation.block("wet", [(3, 3), (4, 3), (4, 4)])  # the floor is another one
    assert not operation.aside


@pytest.mark.parametrize(
    ("end", "order"),
    [
        (None, {"pickup": "rack0", "delivery": "dock0"}),
        (None, {"pickup": "rack0", "delivery": "dock0", "robots": ["r0"]}),
        ("rack0", {"pickup": "shelf0", "delivery": "dock1", "robots": ["r0"]}),
    ],
)
def test_who_has_nothing_to_do_goes_out_of_the_way(tmp_path, end, order):
    """r0 stands where the order ends, r1 where it begins, or where r0 ends its day."""
    fleet = hall(tmp_path, 0)
    fleet.add_robot("r0", "agv", start="dock0", end=end)
    fleet.add_robot("r1", "agv", start="rack0")
    day = Day(tmp_path, fleet=fleet)
    day.operation.add({"id": "o", **order})
    day.run(120)
    assert day.state("o") == "done"
    assert day.verdict().good
    day.operation.close()


def test_an_order_that_nobody_can_do_is_told_with_what_stands_in_its_way(tmp_path):
    fleet = hall(tmp_path, 0)
    fleet.add_robot("r0", "agv", start="dock0")
    fleet.add_zone("closed", [(17, 1), (21, 1), (21, 5), (17, 5)], keep_out="agv")
    day = Day(tmp_path, fleet=fleet)
    day.order("o", "rack0", "dock1")
    day.until(lambda: "dropped" in day.story(), 60)
    assert "move_r0_dock0_to_rack0" in day.story()
    day.operation.close()


def test_who_cannot_bring_its_order_now_waits_and_keeps_nobody_else_waiting(tmp_path):
    day = Day(tmp_path, robots=3)
    try:
        places = day.fleet.records.places
        day.order("o0", "rack0", "dock0", robots=["r0"])
        day.until(lambda: "o0" in day.operation.on_board())
        day.robots.put("r1", places["dock0"].pose)
        day.operation.leave("r1", "broken down", places["dock0"].pose)
        stop = day.clock.now() + 20.0
        day.until(lambda: day.clock.now() > stop)
        asked = len(day.operation.costs)
        day.order("o1", "rack2", "dock2", robots=["r2"])
        day.until(lambda: day.state("o1") == "done")
        assert len(day.operation.costs) <= asked + 2, day.story()
        assert day.operation.on_board() == {"o0": "r0"}
        day.robots.put("r1", places["home1"].pose)
        day.operation.join("r1", places["home1"].pose)
        day.run()
        assert day.state("o0") == "done"
        assert day.verdict().good, day.story()
    finally:
        day.operation.close()


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_what_a_robot_uses_that_leaves_is_used_by_nobody_else_until_it_is_away(
    tmp_path, seed, moved
):
    """It stands in the gate, say: others were sent there, as if it had let go of it."""
    rng = random.Random(f"holds {seed}")
    fleet, most = hall(tmp_path, robots=2), rng.choice((1, 2))
    fleet.add_resource("gate", most)
    day = Day(tmp_path, fleet=fleet, seed=seed)
    uses = [{"at": f"rack{k}", "service": 12, "resources": ["gate"]} for k in range(3)]
    first, other, _ = rng.sample(uses, 3)
    second = rng.sample([other, "shelf0"], 2)
    try:
        day.order("first", first, "dock0", robots=["r0"])
        day.until(lambda: any(w.robot == "r0" for w in day.robots.work.values()), 90)
        day.order("other", "shelf1", "dock1", robots=["r1"])
        ends = dict(zip(("pickup", "delivery"), second, strict=True))
        day.operation.add({"id": "second", **ends, "robots": ["r1"]})
        for _ in range(rng.choice((1, 30))):
            day.step()
        day.operation.leave("r0", "broken")
        left = day.clock.now()
        if rng.random() < 0.5:
            day.restart()
        day.until(lambda: day.clock.now() > left + 150.0, 200)
        assert (day.state("second") == "done") == (most == 2)
        assert day.state("other") == "done"
        assert day.verdict().overfull == ()
        pose = (3.0, 11.5, 0.0) if moved else None
        if moved:
            day.robots.put("r0", pose)
            day.operation.leave("r0", "towed away", pose)
        else:
            day.operation.join("r0")
        day.until(lambda: day.state("second") == "done", 400)
        assert day.verdict().contacts == day.verdict().overfull == ()
    finally:
        day.operation.close()
