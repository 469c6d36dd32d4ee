"""Where robots come to rest when what is left is planned anew: of robots that obey late, tell
seldom, are held up, drive past their gates or stand beside their paths, by what they really do and
bodies of shapely. The rest begins where all stand, once they do, and nobody drives into who rests.
"""

import math
import random
from collections import deque
from itertools import combinations

import numpy as np
import pytest
from shapely import affinity
from shapely.geometry import Polygon
from unified_planning.shortcuts import get_environment

from tests.execution import floors
from up_samp.execution import Executor, Go, Heard, Surprise, dependencies_of, solve_remaining

TICK = 0.05


def small_floor(seed, yaml):
    """Two to four robots of any models and few motions, all listings shuffled (None: nobody
    drives)."""
    rng = random.Random(f"small {seed}")
    plan = floors.Plan(rng, yaml, clearance=0.08, size=rng.choice((7.0, 9.0)))
    for entry in plan.data["objects"]:
        entry["model"] = rng.choice(("REEDSSHEPP", "PIVOT", "SE2"))
        plan.model[entry["name"]] = entry["model"]
    for _ in range(rng.randint(3, 6)):
        plan.move(rng.choice(plan.robots))
    data = plan.data
    if not data["motions"]:
        return None
    data["makespan"] = max(a["end"] for a in data["activities"])
    for key in ("objects", "activities", "motions", "changes"):
        rng.shuffle(data[key])
    return floors._problem(rng, plan, yaml), data


class Late:
    """A robot that obeys ``reaction`` s late. ``firm``: it goes as far as it was ever let drive."""

    def __init__(self, rng, reaction, pose, firm):
        self.reaction, self.pose, self.firm = reaction, pose, firm
        self.share = rng.choice((1.0, 1.0, rng.uniform(0.4, 1.0)))
        self.halt, self.halted = rng.choice((math.inf, rng.uniform(0, 15))), rng.uniform(1, 6)
        self.orders, self.motion, self.s, self.v, self.until = deque(), "", 0.0, 0.0, 0.0

    def step(self, now, executor, name):
        while self.orders and self.orders[0][0] <= now - self.reaction + 1e-9:
            _, motion, until = self.orders.popleft()
            if motion != self.motion:
                self.motion, self.s, self.v, self.until = motion, 0.0, 0.0, 0.0
                self.path = executor.drives[motion, name].path
                self.travel = executor.dependencies.travels[motion, name]
            self.until = max(until, self.until if self.firm else 0.0)
        if not self.motion:
            return
        a, v, length = self.travel.accel, self.v, self.travel.length
        rests = next((x for x in self.travel.stops if x > self.s + 1e-9), length)
        goal = min(self.until, rests, length)
        if 0.0 < goal - self.s <= 2e-3 and v <= 0.05:
            self.s, self.v = goal, 0.0
        else:
            caps = self.travel.cap_at(self.s), self.travel.cap_at(self.s + v * TICK)
            wish = 0.0 if self.halt <= now < self.halt + self.halted else self.share * min(caps)
            room = 0.25 * (a * TICK) ** 2 + 2 * a * (goal - self.s - 0.5 * v * TICK)
            brakes = math.sqrt(max(0.0, room)) - 0.5 * a * TICK
            self.v = max(0.0, v - a * TICK, min(wish, brakes, v + a * TICK))
            self.s = min(self.s + 0.5 * (v + self.v) * TICK, length)
        self.pose = tuple(self.path.poses_at(np.array([self.s]))[0])


def on_the_floor(seed, yaml, ahead):
    """A plan under way at a random moment: its objects, its executor and its robots."""
    rng = random.Random(f"late {seed}")
    made = small_floor(seed, yaml)
    if made is None:
        return None
    problem, plan = made
    latency, lost = rng.choice((0.0, 1.0, 2.0, rng.uniform(0, 2))), rng.choice((0.0, 0.0, 0.8))
    found = dependencies_of(problem, plan)
    executor = Executor(plan, problem, dependencies=found, latency=latency, ahead=ahead)
    objects = {o["name"]: o for o in plan["objects"]}
    most = max(0.5, latency) - 2 * TICK  # what is told is a tick old
    robots = {
        n: Late(rng, rng.choice((most, rng.uniform(0, most))), o["initial"], ahead is not None)
        for n, o in objects.items()
    }
    end, now = rng.uniform(0.5, 0.9 * plan["makespan"]), 0.0
    while now < end:
        for name, command in executor.commands(now).items():
            if isinstance(command, Go):
                robots[name].orders.append((now, command.motion, command.until))
        for name, robot in robots.items():
            robot.step(now, executor, name)
        now = round(now + TICK, 9)
        for name, way in [*executor.state.of_object.items()]:
            robot = robots[name]
            if robot.motion == way.activity and rng.random() >= lost:
                executor.update(name, progress=robot.s, now=now)
    return rng, objects, executor, robots, now


def trouble(rng, executor, robots, now):
    """Let a robot drive past its closed gate, or stand beside its path, and tell so."""
    some = [n for n, w in executor.state.of_object.items() if robots[n].motion == w.activity]
    for name in rng.sample(sorted(some), min(len(some), 1)):
        robot, way = robots[name], executor.state.of_object[name]
        gate, before = executor.state.closed(way), (robot.s, robot.v)
        if gate is not None:
            robot.s = min(executor.state.nominal(gate) + way.error + 0.2, way.length)
            robot.v = min(robot.v, way.travel.speed_at(robot.s))
            if executor.update(name, progress=robot.s, now=now).heard is not Heard.HELD:
                robot.s, robot.v = before  # it cannot have driven so far
                executor.update(name, progress=robot.s, now=now)
        else:
            x, y, theta = robot.pose
            off, robot.motion = rng.choice((-0.6, 0.6)), ""
            robot.pose = (x - off * math.sin(theta), y + off * math.cos(theta), theta)
            executor.update(name, pose=robot.pose, now=now)


def stopped(executor, robots, left, now):
    """Let everybody come to rest that is told to; return when each stood."""
    for name, robot in robots.items():
        way = executor.state.of_object.get(name)
        if name in executor.state.strayed:
            robot.orders.clear()
        elif way is not None:
            robot.orders.append((now, way.activity, left.stops[name]))
    stood = dict.fromkeys(robots, now)
    for _ in range(round(40 / TICK)):
        for name, robot in robots.items():
            before = robot.s
            robot.step(now, executor, name)
            stood[name] = now + TICK if robot.s != before else stood[name]
        now = round(now + TICK, 9)
    return stood


def meet(objects, poses):
    """Return who overlaps whom."""
    bodies = {}
    for name, (x, y, theta) in poses.items():
        turned = affinity.rotate(Polygon(objects[name]["footprint"]), theta, (0, 0), True)
        bodies[name] = affinity.translate(turned, x, y)
    pairs = combinations(sorted(bodies), 2)
    return [(a, b) for a, b in pairs if bodies[a].intersection(bodies[b]).area > 1e-6]


def who_meets(objects, robots, rest):
    """Return who meets whom when the rest is driven from where everybody really stands."""
    for time in np.arange(0.0, rest["makespan"] + 1.0, 0.2):
        poses = {name: robot.pose for name, robot in robots.items()}
        for motion in sorted(rest["motions"], key=lambda m: m["samples"][0][0]):
            rows = np.array(motion["samples"])
            if time >= rows[0, 0]:
                turn = np.unwrap(rows[:, 3])
                columns = (rows[:, 1], rows[:, 2], turn)
                poses[motion["object"]] = tuple(np.interp(time, rows[:, 0], c) for c in columns)
        if found := meet(objects, poses):
            return time, found
    return None


def check(seed, yaml, *, ahead=None, harm=False, solve=True):
    made = on_the_floor(seed, yaml, ahead)
    if made is None:
        return
    rng, objects, executor, robots, now = made
    if harm:
        trouble(rng, executor, robots, now)
    if executor.finished:
        return
    left = executor.remaining_problem(Surprise(same_choices=True))
    stood = stopped(executor, robots, left, now)
    for name, robot in robots.items():
        assert math.dist(robot.pose[:2], left.poses[name][:2]) < 0.06, name
        if robot.share == 1.0 and robot.halt == math.inf:
            assert stood[name] <= left.since + TICK, name
    met = meet(objects, {name: robot.pose for name, robot in robots.items()})
    if solve and not met:  # who was put elsewhere may touch somebody
        rest = solve_remaining(left, seconds=60)
        assert who_meets(objects, robots, rest) is None


@pytest.fixture(scope="module")
def yaml(tmp_path_factory):
    get_environment().credits_stream = None
    return floors.hall(tmp_path_factory.mktemp("hall"))


def few(most):
    """Forty floors, of which the later ones are slow tests."""
    return [pytest.param(k, marks=pytest.mark.long if k >= most else ()) for k in range(40)]


BOTH = [
    pytest.param(
        seed, ahead, marks=pytest.mark.long if seed >= 10 or seed % 2 != (ahead is not None) else ()
    )
    for seed in range(40)
    for ahead in (None, 2.0)
]
"""On every other floor robots are let drive for good; slow tests: on each floor both ways."""


@pytest.mark.parametrize(("seed", "ahead"), BOTH)
def test_the_rest_begins_where_and_when_everybody_really_stands(seed, ahead, yaml):
    check(seed, yaml, ahead=ahead, solve=seed < 8)


@pytest.mark.parametrize("seed", few(8))
def test_it_does_for_who_is_where_nobody_led_it(seed, yaml):
    check(seed, yaml, harm=True, solve=False)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(40, 400))
def test_nobody_drives_into_who_rests(seed, yaml):
    check(seed, yaml, ahead=(None, 2.0)[seed % 2], harm=seed % 3 == 0)
