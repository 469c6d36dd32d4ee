"""Two things go wrong at once, or one while another one is not over: nobody drives where people, a
leaf, or a robot that is not heard any more may be, and nothing that is said wrong ends a day.
"""

import io
import math
import random
import threading
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from shapely import affinity
from shapely.geometry import Polygon, box

from tests.operate.days import NONE, Day
from tests.operate.sites import hall
from tests.operate.test_doors import two_rooms
from tests.operate.test_energy import charged_hall
from tests.operate.wire import AgvFloor
from up_samp.execution.reports import Heard, Report
from up_samp.model import UnsupportedError
from up_samp.operate.choice import BACK
from up_samp.operate.planner import Planner, check_job
from up_samp.operate.records import job_record
from up_samp.operate.upkeep import charge_task


@pytest.fixture
def days(tmp_path):
    made = []

    def begin(**options):
        made.append(Day(tmp_path, **options))
        return made[-1]

    yield begin
    for day in made:
        day.operation.close()


def bodies(day, since=0.0):
    """Yield (time, robot, body) of all that was driven, without any code of the package."""
    day.robots.close()
    site = day.fleet.records
    for drive in day.robots.drives:
        length, width = site.robot_types[site.robots[drive.robot].type].footprint
        own = box(-length / 2, -width / 2, length / 2, width / 2)
        for time, x, y, theta in drive.rows:
            if time >= since:
                turned = affinity.rotate(own, theta, origin=(0, 0), use_radians=True)
                yield time, drive.robot, affinity.translate(turned, x, y)


def under_way(day, robot, metres):
    """Run until a robot has driven so far; return its motion and path."""
    state = day.operation.executor.state
    day.until(
        lambda: (w := day.operation.executor.state.of_object.get(robot)) and w.told > metres, 90
    )
    state = day.operation.executor.state
    way = state.of_object[robot]
    return way, day.operation.executor.drives[way.activity, robot].path


def around(x, y, half):
    return box(x - half, y - half, x + half, y + half)


# ------------------ Areas


@pytest.mark.parametrize("seed", range(3))
def test_who_drives_out_of_one_area_enters_no_other_one(days, seed):
    """Several are blocked in the same second, in any order; the robot is in one of them."""
    rng = random.Random(f"areas {seed}")
    day = days(robots=1)
    day.order("o0", "rack1", "dock1")
    way, path = under_way(day, "r0", rng.uniform(1.5, 3.5))
    stands = day.operation.executor.state.braking(way)
    x, y, _ = path.poses_at(np.array([stands]))[0]
    mine = around(x, y, rng.uniform(0.5, 1.0))
    far = path.poses_at(np.array([stands + rng.uniform(3.5, 5.5)]))[0]
    others = [around(far[0], far[1] + rng.uniform(-0.3, 0.3), 0.3) for _ in range(2)]
    shapes = [("mine", mine), *zip(("one", "two"), others, strict=True)]
    rng.shuffle(shapes)
    since = day.clock.now()
    for name, shape in shapes:
        day.operation.block(name, shape.exterior.coords[:-1])
    day.run()
    assert day.state("o0") == "done"
    assert not any(b.intersects(s) for *_, b in bodies(day, since) for s in others)
    assert day.verdict().good, day.story()


def test_who_comes_back_into_the_area_that_it_leaves_waits_outside(days):
    """It turns to the other side of what it has left: into it again."""
    day = days(robots=1)
    day.order("o0", "rack1", "dock1")
    way, path = under_way(day, "r0", 2.0)
    stands = day.operation.executor.state.braking(way)
    (x, y, _), (u, v, _) = path.poses_at(np.array([stands, stands + 5.0]))
    # two ends and a way between them that is beside the robot's
    ends = around(x, y, 0.4), around(u, v, 0.4)
    beside = box(min(x, u) - 0.4, 3.6, max(x, u) + 0.4, 3.8)
    down = [box(a - 0.4, min(b, 3.6), a + 0.4, 3.8) for a, b in ((x, y), (u, v))]
    shape = Polygon(ends[0].union(beside).union(ends[1]).union(down[0]).union(down[1]).exterior)
    day.operation.block("people", shape.exterior.coords[:-1])
    limit = day.operation.executor.state.limits[way.activity]
    assert stands + 0.5 < limit < stands + 5.0
    held = day.clock.now() + 12.0
    day.until(lambda: day.clock.now() > held)
    assert day.robots.robots["r0"].s < limit + 0.1
    assert not list(bodies(day))[-1][2].intersects(shape)


@pytest.mark.parametrize("seed", range(2))
def test_who_stands_before_an_area_stays_out_where_another_one_is_blocked_after_a_restart(
    days, seed
):
    """It was taken to be let drive as far as nobody had let it, and to come in anyhow."""
    rng = random.Random(f"before {seed}")
    day = days(robots=1)
    day.order("o0", "rack1", "dock1")
    way, path = under_way(day, "r0", rng.uniform(1.5, 3.0))
    ahead = day.operation.executor.state.braking(way) + rng.uniform(1.2, 2.0)
    x, y, _ = path.poses_at(np.array([ahead]))[0]
    people, since = around(x, y, 0.4), day.clock.now()
    day.operation.block("people", people.exterior.coords[:-1])
    limit = day.operation.executor.state.limits[way.activity]
    day.until(lambda: way.told > limit - 0.1, 15)
    for _ in range(rng.randrange(3)):
        day.step()
    day.restart()
    if rng.random() < 0.5:
        day.restart()
    day.operation.block("more", box(20, 12, 21, 13).exterior.coords[:-1])
    assert day.operation.executor.state.limits[way.activity] == pytest.approx(limit, abs=0.2)
    day.run()
    assert not any(b.intersects(people) for *_, b in bodies(day, since))
    assert day.verdict().good, day.story()


@pytest.mark.parametrize("what", ["area", "door"])
def test_who_is_inside_drives_out_also_after_a_restart(days, tmp_path, what):
    """What was kept of the floor is of a time when it could have stopped before."""
    day = days(fleet=two_rooms(tmp_path, robots=1), robots=1)
    day.order("o0", "rack0", "dock0")
    if what == "door":
        day.until(lambda: day.robots.pose("r0")[0] > 9.7, 300)
        day.operation.close_door("gate")
        out = lambda: day.robots.pose("r0")[0] > 10.8  # noqa: E731
    else:
        under_way(day, "r0", 3.0)
        x, y, _ = day.robots.pose("r0")
        shape = box(x - 1.0, y - 0.8, x + 0.6, y + 0.8)
        day.operation.block("people", shape.exterior.coords[:-1])
        out = lambda: not list(bodies(day))[-1][2].intersects(shape)  # noqa: E731
    before = dict(day.operation.executor.state.limits)
    day.restart()
    assert day.operation.executor.state.limits.keys() == before.keys()
    day.until(out, 20)


@pytest.mark.parametrize("seed", range(2))
def test_where_people_were_is_free_while_they_are_elsewhere(days, seed):
    """Blocked, opened, and another one blocked: plans kept the first one where the second was."""
    rng = random.Random(f"people {seed}")
    day = days(robots=1)
    ways = [(12.2, 2.2, 13.2, 3.6), (12.2, 10.4, 13.2, 11.8), (6.5, 6.0, 8.0, 7.0)]
    rng.shuffle(ways)
    corner = box(20.0, 12.0, 21.0, 13.0)
    for k, way in enumerate(ways):
        since, people = day.clock.now(), box(*way)
        day.operation.block("people", people.exterior.coords[:-1])
        if rng.random() < 0.5:
            day.operation.block("wet", corner.exterior.coords[:-1])
        day.order(f"o{k}", f"rack{rng.randrange(3)}", f"dock{rng.randrange(3)}")
        day.until(lambda k=k: day.state(f"o{k}") == "done", 120)
        assert not any(b.intersects(people) for *_, b in bodies(day, since))
        for name in [*day.operation.areas]:
            day.operation.unblock(name)
    day.operation.block("wet", corner.exterior.coords[:-1])
    day.order("last", "rack0", "dock0")
    day.run()
    names = {o["name"] for o in day.operation.executor.plan["objects"]}
    assert len(names) == 2  # the robot, and what is blocked now
    assert day.verdict().good, day.story()


# ------------------ A door


@pytest.mark.parametrize("seed", range(2))
def test_nobody_drives_where_the_leaf_stands_of_a_door_that_went_out_of_order_open(
    days, tmp_path, seed
):
    """Once it is mended that is free again."""
    rng = random.Random(f"leaf {seed}")
    fleet = two_rooms(tmp_path)
    fleet.add_place("low", 8.0, 4.5)
    fleet.add_place("left", 3.0, 5.5)
    x = rng.uniform(5.0, 6.5)
    gate = replace(fleet.records.doors["gate"], open=(x, 5.5, 0.0))
    fleet._hold(replace(fleet.records, doors={"gate": gate}))
    day = days(fleet=fleet, seed=seed)
    day.order("o0", "rack0", "dock0", robots=["r0"])
    day.until(lambda: day.state("o0") == "done", 300)
    since = day.clock.now()
    day.operation.close_door("gate")
    if rng.random() < 0.5:
        day.restart()
    for k in range(2):  # the second is planned by a plan that was made while it is out of order
        day.order(f"l{k}", "left", "low", robots=["r1"])
        day.until(lambda k=k: day.state(f"l{k}") == "done", 200)
    leaf = box(x - 0.15, 4.1, x + 0.15, 6.9)
    assert not any(b.intersects(leaf) for *_, b in bodies(day, since))
    assert day.verdict().good, day.story()
    day.operation.close_door("gate", BACK)
    closed = day.clock.now()
    day.order("l2", "left", "low", robots=["r1"])
    day.until(lambda: day.state("l2") == "done", 200)
    shut = box(9.9, 3.1, 10.2, 5.9)
    assert not any(b.intersects(shut) for *_, b in bodies(day, closed))
    assert any(b.intersects(leaf) for *_, b in bodies(day, closed))


@pytest.mark.parametrize("restarted", [False, True])
def test_a_door_that_was_mended_and_opened_again_is_driven_through_again(days, tmp_path, restarted):
    """By plans that come later, too: they kept a closed leaf there."""
    day = days(fleet=two_rooms(tmp_path, robots=1))
    day.operation.close_door("gate")
    day.order("o0", "dock0", "button")
    day.until(lambda: day.state("o0") == "done", 100)
    day.operation.close_door("gate", BACK)
    for k in (1, 2):
        day.order(f"o{k}", f"rack{k - 1}", "dock0")
        day.until(lambda k=k: day.state(f"o{k}") == "done", 200)
        if restarted:
            day.restart()
    assert day.verdict().good, day.story()


@pytest.mark.parametrize("ending", ["joins", "mended"])
@pytest.mark.parametrize("seed", range(2))
def test_a_door_may_open_though_who_opens_it_does_nothing_any_more(days, tmp_path, seed, ending):
    """Others were planned as if it stood closed: through where its leaf swings to."""
    rng = random.Random(f"opener {seed}")
    fleet = two_rooms(tmp_path, seconds=rng.randint(10, 20))
    fleet.add_place("low", 8.0, 4.5)
    fleet.add_place("left", 3.0, 5.5)
    fleet.add_place("other", 8.0, 2.0)
    x = rng.uniform(5.5, 6.0)
    gate = fleet.records.doors["gate"]
    gate = replace(gate, open=(x, 5.5, 0.0), opened_from=("button", "other"))
    fleet._hold(replace(fleet.records, doors={"gate": gate}))
    quiet = partial(AgvFloor, lost=0.0, twice=0.0, late=0.0)
    day = days(fleet=fleet, mishaps=NONE, floor=quiet)
    day.order("o0", "rack0", "dock0", robots=["r0"])
    agv = day.robots.agvs["r0"]
    day.until(lambda: any(a["actionType"] == "open" for _, a in agv.work), 200)
    for _ in range(rng.randrange(5, 20)):
        day.step()
    since, end = day.clock.now(), agv.work[0][0]
    if ending == "mended":
        agv.work[0] = (math.inf, agv.work[0][1])  # it never tells that it has done so
    day.operation.leave("r0", "broken")
    if rng.random() < 0.5:
        day.restart()
    for k in range(2):
        day.order(f"l{k}", "left", "low", robots=["r1"])
        day.until(lambda k=k: day.state(f"l{k}") == "done", 200)
    leaf = box(x - 0.15, 4.1, x + 0.15, 6.9)
    assert not any(b.intersects(leaf) for *_, b in bodies(day, since))
    if ending == "joins":
        day.until(lambda: day.clock.now() > end)
        day.operation.join("r0")
        day.run()
        assert day.verdict().good, day.story()
        return
    day.operation.close_door("gate", BACK)
    day.order("o1", "rack1", "dock0", robots=["r1"])
    day.until(lambda: day.state("o1") == "done", 300)
    opened = [h for h in day.robots.handled if h.kind == "open"]
    assert [h.robot for h in opened] == ["r1"]
    assert day.verdict().contacts == ()


@pytest.mark.parametrize("restarted", [False, True])
def test_who_does_nothing_opens_no_door(days, tmp_path, restarted):
    """It stands where doors are opened from: others waited for it for ever."""
    fleet = two_rooms(tmp_path, robots=1)
    fleet.add_place("other", 8.0, 6.4)
    gate = replace(fleet.records.doors["gate"], opened_from=("button", "other"))
    fleet._hold(replace(fleet.records, doors={"gate": gate}))
    fleet.add_robot("r1", "agv", start="button", end="button")
    day = days(fleet=fleet)
    day.operation.leave("r1", "broken")
    if restarted:
        day.restart()
    day.order("o0", "rack0", "dock0")
    day.run()
    (opened,) = [h for h in day.robots.handled if h.kind == "open"]
    assert opened.robot == "r0"
    assert day.verdict().good, day.story()


# ------------------ A robot that is not heard any more


@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_planned_through_where_a_robot_may_be_that_left_and_is_not_heard(days, seed):
    """Cut off it drives on to the end of what it was let; others were led through there."""
    rng = random.Random(f"silent {seed}")
    quiet = partial(AgvFloor, lost=0.0, twice=0.0, late=0.0)
    day = days(robots=2, mishaps=NONE, floor=quiet)
    day.order("o0", "rack1", "dock1", robots=["r0"])
    under_way(day, "r0", rng.uniform(2.5, 3.5))
    wire, agv = day.robots.wire, day.robots.agvs["r0"]
    wire.lose, plain = lambda name, *_: name == "r0", wire.state_of
    wire.state_of = lambda one: one is agv or plain(one)
    for _ in range(rng.randrange(5, 15)):
        day.operation.step()
    day.operation.leave("r0", "its connection is broken")
    orders = [("rack1", "dock0"), ("rack0", "dock2")]
    for k, (pickup, delivery) in enumerate(orders):
        day.order(f"p{k}", pickup, delivery, robots=["r1"])
    wait = day.clock.now() + 60.0
    day.until(lambda: day.clock.now() > wait)
    assert day.verdict().contacts == ()
    here = tuple(agv.pose)
    assert math.dist(here[:2], day.operation.poses["r0"][:2]) > 1.0  # it drove on
    assert day.operation.adrift() == ["r0"]
    assert "r0 may drive on" in day.story()
    day.operation.leave("r0", "it stands there", here)
    day.until(lambda: {day.state("p0"), day.state("p1")} == {"done"}, 200)
    assert day.verdict().contacts == ()


@pytest.mark.parametrize("metres", [3.0, 4.5])
def test_who_leaves_while_it_brakes_is_noted_where_it_comes_to_stand(days, metres):
    """The last centimetres count: others are planned as near to it as the margin allows."""
    day = days(robots=1)
    day.order("o0", "rack1", "dock1")
    under_way(day, "r0", metres)
    day.operation.leave("r0")
    later = day.clock.now() + 8.0
    day.until(lambda: day.clock.now() > later)
    assert math.dist(day.robots.pose("r0"), day.operation.poses["r0"]) < 0.01
    day.operation.join("r0")
    assert not day.operation.placed
    day.run()
    assert day.verdict().good, day.story()


# ------------------ What is said wrong


def test_what_a_robot_says_to_be_over_that_another_one_does_does_not_count(days):
    day = days(robots=2)
    day.order("o0", "rack1", "dock1", robots=["r0"])
    said, replies = day.robots.reports, []

    def reports(now):
        phases = day.operation.executor.state.phase
        running = [n for n, p in phases.items() if p.value == "running" and n.startswith("pick")]
        return [*said(now), *(Report("r1", now, n, done=True) for n in running)]

    plain = day.operation.executor.done
    day.robots.reports = reports
    day.run()
    replies.append(plain("nothing", robot="r1"))
    assert replies[0].heard is Heard.IGNORED
    assert [h.kind for h in day.robots.handled] == ["pick", "deliver"]
    assert day.verdict().good, day.story()


@pytest.mark.parametrize("name", ["busy.r0", "busy.o", "area.0", "now.r0", "leaf.gate", "break.r0"])
def test_orders_are_called_as_anything(days, tmp_path, name):
    """They were left out of plans, which nobody could follow then, over and over."""
    day = days(fleet=charged_hall(tmp_path, 2))
    day.order(name, "rack0", "dock0")
    day.order("other", "rack1", "dock1")
    day.run()
    assert (day.state(name), day.state("other")) == ("done", "done")
    assert day.verdict().good


def test_places_and_zones_are_called_as_anything(days, tmp_path):
    """Those that plans add are called otherwise: a place was moved to where a robot stood."""
    fleet = hall(tmp_path, 1)
    fleet.add_place("now.r0", 12.5, 2.0)
    fleet.add_zone("area.0", [(4.0, 1.0), (8.0, 1.0), (8.0, 13.0), (4.0, 13.0)], v_max=0.5)
    day = days(fleet=fleet)
    day.robots.put("r0", (5.0, 7.0, 0.5))
    day.operation.join("r0", (5.0, 7.0, 0.5))
    day.operation.block("wet", [(20.0, 12.0), (21.0, 12.0), (21.0, 13.0)])
    day.order("o0", "now.r0", "dock2")
    day.run()
    assert day.state("o0") == "done"
    assert day.verdict().good, day.story()


def test_no_order_is_taken_for_a_charge(tmp_path):
    """The robot would count as full once it is done."""
    site = charged_hall(tmp_path).records
    check_job(charge_task(site, "r0", "charge.r0.3", 0.0))
    order = {"id": "charge.o", "pickup": "rack0", "delivery": "dock0"}
    tasks = [{"id": n, "at": "rack0", "duration": 2} for n in ("charge.o", "charge.r0.1")]
    tasks.append({**tasks[1], "robots": ["r1"]})
    for job in (order, *tasks):
        with pytest.raises(UnsupportedError, match="call it otherwise"):
            check_job(job_record(job))


def test_half_an_answer_of_a_planner_is_told_and_the_next_question_is_answered(monkeypatch):
    """Whatever that is read as: it was awaited for ever, and nothing was planned any more."""
    planner = Planner()
    group = SimpleNamespace(sink=io.BytesIO(), source=io.BytesIO(b"cno_such_module\nthing\n."))
    group.close = group.end = lambda: None
    monkeypatch.setattr(planner, "_come", lambda: group)
    monkeypatch.setattr(threading, "excepthook", lambda _told: None)
    planner.ask(SimpleNamespace(number=7))
    said = planner.taken(wait=True)
    assert (said.number, said.plan) == (7, None)
    assert "planner is lost" in said.why
    assert not planner.busy
