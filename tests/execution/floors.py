"""Random plans without a planner: robots on arcs in an empty hall, put in time one after the other.

Every plan is valid by construction (each motion is placed by the validator's swept check), and has
what executives have to heed: crossings and robots that follow each other, rests, a gate that is set
aside, tasks, a shared resource, precedences, exclusions and fluents.
"""

from __future__ import annotations

import itertools
import math
import random

import numpy as np
from PIL import Image
from unified_planning.model import (
    ClosedTimeInterval,
    Fluent,
    LeftOpenTimeInterval,
    Object,
    TimePointInterval,
    Timing,
)
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import (
    GE,
    LT,
    TRUE,
    BoolType,
    ConfigurationType,
    Equals,
    IntType,
    MovableType,
    Or,
    UserType,
)

from tests import handmade
from up_samp import Fleet
from up_samp.execution.judge import contacts_of
from up_samp.io.sampling import trajectory_rows
from up_samp.validation.scene import carried_along

SIZE = 12.0
BOX = ((-0.4, -0.25), (0.4, -0.25), (0.4, 0.25), (-0.4, 0.25))
BAR = ((-0.1, -0.6), (0.1, -0.6), (0.1, 0.6), (-0.1, 0.6))
CRATE = ((-0.25, -0.3), (0.25, -0.3), (0.25, 0.3), (-0.25, 0.3))
CLEAR = 0.015
"""Clearance (m) of every motion as planned."""


def hall(folder):
    Image.new("L", (120, 120), 254).save(folder / "empty.png")
    path = folder / "empty.yaml"
    path.write_text(
        "image: empty.png\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


class Plan:
    """A plan dictionary under construction."""

    def __init__(self, rng, yaml, crates=None, clearance=CLEAR, size=SIZE):
        self.rng = rng
        self.clearance, self.size = clearance, size
        self.crates = crates
        """The generator of what is carried (``None``: nothing is)."""
        self.robots = [f"r{k}" for k in range(rng.choice((2, 3, 3, 4)))]
        self.speed = {r: rng.choice((0.8, 1.0, 1.5)) for r in self.robots}
        self.model = {r: rng.choice(("REEDSSHEPP", "SE2")) for r in self.robots}
        self.ready = dict.fromkeys(self.robots, 0)
        self.pose = {}
        self.tasks: list[dict] = []
        self.data = {
            "format": "up-samp-plan", "version": 1, "problem": "floor", "engine": "made",
            "status": "SOLVED_SATISFICING", "makespan": 0, "lower_bound": None,
            "seconds_per_unit": 1, "map": {"yaml": str(yaml)}, "objects": [], "activities": [],
            "motions": [], "changes": [],
        }  # fmt: skip
        for robot in self.robots:
            self._place(robot)

    def _object(self, name, kind, footprint, model, pose, v_max):
        self.data["objects"].append(
            {
                "name": name, "type": kind, "footprint": [list(c) for c in footprint],
                "model": model, "turning_radius": 1.0, "v_max": v_max, "a_max": 0.5,
                "initial": list(pose), "omega_max": 2.0,
            }
        )  # fmt: skip

    def _place(self, robot):
        while True:
            far = self.size - 1
            pose = (self.rng.uniform(1, far), self.rng.uniform(1, far), self.rng.uniform(-3, 3))
            if all(math.dist(pose[:2], p[:2]) > 1.2 for p in self.pose.values()):
                break
        self.pose[robot] = pose
        self._object(robot, "robot", BOX, self.model[robot], pose, self.speed[robot])

    def clear(self, data, robot=None):
        """Whether nobody (``robot``: whether nobody and this one) meets, with some clearance."""
        if robot is not None:
            motions = [
                m if m["object"] == robot else {**m, "avoid": [robot]} for m in data["motions"]
            ]
            data = {**data, "motions": motions}
        grown, c = [], self.clearance
        for entry in data["objects"]:
            scale = [(math.copysign(abs(x) + c, x), math.copysign(abs(y) + c, y))
                     for x, y in entry["footprint"]]  # fmt: skip
            grown.append({**entry, "footprint": scale})
        return not contacts_of({**data, "objects": grown})

    def gate(self):
        """Put a bar into the hall that a task sets aside."""
        pose = (self.rng.uniform(3, 9), self.rng.uniform(3, 9), self.rng.uniform(-3, 3))
        if any(math.dist(pose[:2], p[:2]) < 1.5 for p in self.pose.values()):
            return
        self._object("bar", "gate", BAR, "SE2", pose, 1.0)
        end = self.rng.randint(4, 14)
        self.data["activities"].append({"name": "set_aside", "start": end - 2, "end": end})
        self.data["changes"].append(
            {"activity": "set_aside", "object": "bar", "time": end,
             "configuration": [0.3, 11.4, math.pi]}
        )  # fmt: skip

    def drops(self, spots):
        """Let tasks set bars down at (x, y, theta, time), wherever nobody is and will be."""
        for k, (x, y, theta, time) in enumerate(spots):
            kept, name = self.data, f"bar{k}"
            self.data = {**kept, "objects": [*kept["objects"]]}
            self._object(name, "gate", BAR, "SE2", (0.2, 1.5 + 1.5 * k, 0.0), 1.0)
            task = {"name": f"set_{name}", "start": time - 2, "end": time}
            change = {"activity": f"set_{name}", "object": name, "time": time}
            self.data["activities"] = [*kept["activities"], task]
            self.data["changes"] = [*kept["changes"], {**change, "configuration": [x, y, theta]}]
            if self._near((x, y), time) or not self.clear(self.data):
                self.data = kept

    def _near(self, point, time):
        """Whether somebody is near a point at a time."""
        poses = {o["name"]: o["initial"] for o in self.data["objects"]}
        for motion in sorted(self.data["motions"], key=lambda m: m["samples"][0][0]):
            rows = [row for row in motion["samples"] if row[0] <= time]
            if rows:
                poses[motion["object"]] = rows[-1][1:]
        return any(math.dist(point, poses[robot][:2]) < 1.3 for robot in self.robots)

    def move(self, robot, given=None):
        """Add a motion of ``robot`` at the earliest time at which nobody is in its way."""
        for _ in range(1 if given else 6):
            pieces = given or self._pieces(robot)
            if pieces is None:
                continue
            for wait in range(0, 40, self.rng.choice((1, 2))):
                start = self.ready[robot] + wait
                entry, motion, end = self._timed(robot, pieces, start)
                data = {
                    **self.data,
                    "activities": [*self.data["activities"], entry],
                    "motions": [*self.data["motions"], motion],
                }
                laden = self._laden(data, robot, motion, end)
                if laden is not None and self.clear(laden):
                    data = laden
                if data is laden or self.clear(data, robot if given else None):
                    self.data = data
                    self.ready[robot] = end + 1
                    self.pose[robot] = tuple(motion["samples"][-1][1:])
                    return True
        return False

    def _laden(self, data, robot, motion, end):
        """A crate before or behind the robot that it takes along, once."""
        if self.crates is None or self.crates.random() < 0.4:
            return None
        offset = (self.crates.choice((0.75, -0.75)), 0.0, 0.0)
        way = carried_along(np.array(motion["samples"])[:, 1:], offset)
        if way[:, :2].min() < 0.5 or way[:, :2].max() > SIZE - 0.5:
            return None
        first, last = way[0].tolist(), way[-1].tolist()
        name = f"crate{len(data.get('rides', ()))}"
        crate = {
            "name": name, "type": "crate", "footprint": [list(c) for c in CRATE], "model": "SE2",
            "turning_radius": 1.0, "v_max": 1.0, "a_max": 0.5, "initial": first, "omega_max": 2.0,
        }  # fmt: skip
        activity = motion["activity"]
        ride = {"activity": activity, "object": name, "carrier": robot, "offset": list(offset)}
        change = {"activity": activity, "object": name, "time": end, "configuration": last}
        return {
            **data,
            "objects": [*data["objects"], crate],
            "changes": [*data["changes"], change],
            "rides": [*data.get("rides", ()), ride],
        }

    def _pieces(self, robot):
        # a free body also accelerates sideways in a bend
        bends = (0.0, 0.0, 0.4, -0.4, 0.7) if self.model[robot] == "REEDSSHEPP" else (0.0, 0.2)
        parts = [
            (self.rng.uniform(1.0, 4.0), self.rng.choice(bends))
            for _ in range(self.rng.randint(1, 3))
        ]
        length = sum(p[0] for p in parts)
        spots = [handmade.along(self.pose[robot], parts, s) for s in np.linspace(0, length, 30)]
        far = self.size - 0.8
        inside = all(0.8 < x < far and 0.8 < y < far for x, y, _ in spots)
        return parts if inside else None

    def _timed(self, robot, pieces, start):
        a_max = 0.5 if self.model[robot] == "REEDSSHEPP" else 0.3
        top = min(self.speed[robot], 1.0 if a_max < 0.5 else 9.0)
        trajectory = handmade.drive(self.pose[robot], pieces, float(start), top, a_max)
        end = start + math.ceil(trajectory.duration) + self.rng.randint(0, 1)
        count = sum(m["object"] == robot for m in self.data["motions"])
        name = f"move_{robot}_{count}"
        motion = {"activity": name, "object": robot, "samples": trajectory_rows(trajectory)}
        return {"name": name, "start": start, "end": end}, motion, end

    def work(self, robot):
        """Add a task of ``robot`` that takes one of two crews."""
        name = f"work_{robot}_{len(self.tasks)}"
        length = self.rng.randint(1, 3)
        start = self.ready[robot]
        while any(
            sum(t["start"] <= at < t["end"] for t in self.tasks) >= 2
            for at in range(start, start + length)
        ):
            start += 1
        entry = {"name": name, "start": start, "end": start + length, "robot": robot}
        self.tasks.append(entry)
        self.data["activities"].append({k: v for k, v in entry.items() if k != "robot"})
        self.ready[robot] = start + length + 1


def random_floor(
    seed, yaml, *, crates=False, clearance=CLEAR, size=SIZE, moves=(3, 8), shared=False
):
    """Return (problem, plan dictionary); with ``crates`` robots carry some along. Each body keeps
    ``clearance`` (m) around it, in a corner of the hall ``size`` (m) wide. ``shared``: as tells
    ``share``.
    """
    rng = random.Random(seed)
    plan = Plan(rng, yaml, random.Random(f"crates {seed}") if crates else None, clearance, size)
    if rng.random() < 0.4:
        plan.gate()
    for _ in range(rng.randint(*moves)):
        robot = rng.choice(plan.robots)
        plan.move(robot)
        if rng.random() < 0.5:
            plan.work(robot)
    return finished(rng, plan, yaml, shared=shared)


def rounds(seed, yaml, *, clearance=CLEAR, shared=False, drops=()):
    """Four robots on two rounds along and two across the hall: everybody crosses everybody's way,
    again and again. Bars are set down as tells ``drops``, where that is in nobody's way.
    """
    rng = random.Random(f"rounds {seed}")
    plan = Plan(rng, yaml, None, clearance)
    plan.robots, plan.data["objects"] = [f"r{k}" for k in range(4)], []
    plan.model = dict.fromkeys(plan.robots, "REEDSSHEPP")
    plan.ready = dict.fromkeys(plan.robots, 0)
    plan.speed = {r: rng.choice((0.8, 1.0, 1.5)) for r in plan.robots}
    starts = ((2.5, 3.1, 0.0), (2.5, 7.0, 0.0), (5.2, 2.0, math.pi / 2), (9.4, 2.0, math.pi / 2))
    for robot, (x, y, heading) in zip(plan.robots, starts, strict=True):
        plan.pose[robot] = (x + rng.uniform(-0.2, 0.2), y + rng.uniform(-0.2, 0.2), heading)
        plan._object(robot, "robot", BOX, "REEDSSHEPP", plan.pose[robot], plan.speed[robot])
    halves = [robot for robot in plan.robots for _ in range(rng.randint(2, 3))]
    rng.shuffle(halves)
    for robot in halves:
        plan.move(robot, [(rng.uniform(6.8, 7.0), 0.0), (math.pi / 0.9, 0.9)])
        if rng.random() < 0.3:
            plan.work(robot)
    plan.drops(drops)
    return finished(rng, plan, yaml, shared=shared)


def crossing(yaml, wait=6, further=()):
    """Two robots of which r0 crosses the way of r1 at (6, 6), and r1 that of r0 once it has. So do
    r2, ..., at (6, y) with ``further`` y.
    """
    rng = random.Random(0)
    plan = Plan(rng, yaml)
    plan.robots, plan.data["objects"] = [f"r{k}" for k in range(2 + len(further))], []
    plan.model = dict.fromkeys(plan.robots, "REEDSSHEPP")
    plan.speed = dict.fromkeys(plan.robots, 1.0)
    plan.pose = {"r0": (2.0, 6.0, 0.0), "r1": (6.0, 2.0, math.pi / 2)}
    plan.pose |= {f"r{k}": (2.0, y, 0.0) for k, y in enumerate(further, 2)}
    for robot in plan.robots:
        start = wait if robot == "r1" else 0
        plan._object(robot, "robot", BOX, "REEDSSHEPP", plan.pose[robot], 1.0)
        entry, motion, _ = plan._timed(robot, [(8.0, 0.0)], start)
        plan.data["activities"].append(entry)
        plan.data["motions"].append(motion)
    assert plan.clear(plan.data)
    return finished(rng, plan, yaml)


def fleet(seed, yaml, *, margin):
    """Return (problem, plan dictionary) of a solved fleet: a zone for one or two parts the hall,
    robots stop at the same places one after the other, and share a tool.
    """
    rng = random.Random(f"fleet {seed}")
    made = Fleet(yaml, margin=margin)
    made.add_robot_type("agv", (0.8, 0.5), model=rng.choice(("car", "diff", "omni")), a_max=0.5)
    aisle = [(4.5, 0), (7.5, 0), (7.5, 12), (4.5, 12)]
    made.add_zone("aisle", aisle, max_robots=rng.choice((1, 2)))
    made.add_resource("tool")
    for name, y in (("north", 9.0), ("south", 3.0)):
        made.add_place(f"in_{name}", 1.5, y)
        made.add_place(f"out_{name}", 10.5, y)
    for k, y in enumerate(rng.sample((1.2, 6.0, 10.8), rng.choice((2, 2, 3)))):
        made.add_place(f"home{k}", 1.5, y, park=1)
        made.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}")
    for k in range(rng.choice((2, 3))):
        stops = [
            {"at": f"{side}_{rng.choice(('north', 'south'))}", "service": rng.randint(1, 4)}
            for side in rng.sample(("in", "out"), 2)
        ]
        stops[rng.randint(0, 1)]["resources"] = ["tool"]
        made.add_order(f"o{k}", *stops)
    result = made.solve(timeout=60.0, workers=1, seed=seed, first_plan=True)
    assert result.data is not None, result.status
    return made.problem, result.data


def finished(rng, plan, yaml, *, shared=False):
    """Return (problem, plan dictionary) of a plan made so far; ``shared``: see ``share``."""
    data = plan.data
    if shared:
        stay(rng, plan)
    data["activities"].sort(key=lambda a: a["start"])
    data["motions"].sort(key=lambda m: m["samples"][0][0])
    data["changes"].sort(key=lambda c: c["time"])
    data["makespan"] = max(a["end"] for a in data["activities"])
    problem = _problem(rng, plan, yaml)
    if shared:
        share(rng, plan, problem)
    return problem, data


def _own(plan):
    """Return each robot's activities (names) in the order of time."""
    spans = {e["name"]: (e["start"], e["end"]) for e in plan.data["activities"]}
    return {
        robot: sorted((n for n in spans if f"_{robot}_" in n), key=lambda n: spans[n])
        for robot in plan.robots
    }


def stay(rng, plan):
    """Let drives last until another robot starts something: much happens at one instant."""
    entries = {a["name"]: a for a in plan.data["activities"]}
    carrying = {r["activity"] for r in plan.data.get("rides", ())}
    own = _own(plan)
    for robot, mine in own.items():
        starts = [entries[n]["start"] for other in own if other != robot for n in own[other]]
        for name, later in itertools.zip_longest(mine, mine[1:]):
            end, latest = entries[name]["end"], entries[later]["start"] - 1 if later else math.inf
            some = [t for t in starts if end <= t <= latest]
            if some and name.startswith("move") and name not in carrying and rng.random() < 0.7:
                entries[name]["end"] = min(some)


def share(rng, plan, problem):
    """Let robots share what the plan has just enough of: a zone for one, a zone for as many as
    are ever in it at once, a tool, and a place that each hands over to the next by name.
    """
    spans = {e["name"]: (e["start"], e["end"]) for e in plan.data["activities"]}
    visits = []
    for mine in _own(plan).values():
        first = 0
        while first < len(mine):
            last = min(first + rng.randint(0, 1), len(mine) - 1)
            if rng.random() < 0.7:
                visits.append((mine[first], mine[last]))
            first = last + 1
    _zone(problem, "wide", visits, spans)
    _zone(problem, "narrow", _in_turns(rng, visits, spans), spans)
    tool = problem.add_resource("tool", 1)
    moves = [(n, n) for n in spans if n.startswith("move")]
    for name, _ in _in_turns(rng, moves, spans):
        problem.get_activity(name).uses(tool)
    _hand_over(problem, [n for n, _ in _in_turns(rng, moves, spans)], spans)


def _in_turns(rng, visits, spans):
    """Return some (first, last) activities of which one visit ends before the next begins."""
    found = []
    for first, last in rng.sample(visits, len(visits)):
        if all(
            spans[last][1] <= spans[one][0] or spans[other][1] <= spans[first][0]
            for one, other in found
        ):
            found.append((first, last))
    return sorted(found, key=lambda v: spans[v[0]])


def _zone(problem, name, visits, spans):
    """A zone with room for as many as are in it at once; who leaves lets in who comes then."""
    times = [(spans[first][0], spans[last][1]) for first, last in visits]
    most = max((sum(s <= at < e for s, e in times) for at, _ in times), default=1)
    room = problem.add_fluent(name, IntType(0, most), default_initial_value=most)
    for first, last in visits:
        a, b = problem.get_activity(first), problem.get_activity(last)
        a.add_decrease_effect(a.start, room(), 1)
        b.add_increase_effect(b.end, room(), 1)


def _hand_over(problem, turns, spans):
    """Each takes a place that the one before it has handed over to it at its end."""
    kind = UserType("turn")
    mine = [problem.add_object(Object(f"turn_{name}", kind)) for name in turns]
    if not mine:
        return
    whose = problem.add_fluent("whose", kind, default_initial_value=mine[0])
    for k, name in enumerate(turns):
        a = problem.get_activity(name)
        touches = k > 0 and spans[turns[k - 1]][1] == spans[name][0]
        interval = LeftOpenTimeInterval if touches else ClosedTimeInterval
        a.add_condition(interval(Timing(0, a.start), Timing(0, a.end)), Equals(whose(), mine[k]))
        if k + 1 < len(turns):
            a.add_effect(a.end, whose(), mine[k + 1])


def _problem(rng, plan, yaml):
    problem = SchedulingMotionProblem("floor")
    kinds = {name: MovableType(name) for name in ("robot", "gate", "crate")}
    pose_type = ConfigurationType("pose", OccupancyMap(str(yaml), (0, 0)), ConfigurationKind.SE2)
    items = {}
    for entry in plan.data["objects"]:
        limits = {"v_max": entry["v_max"], "a_max": 0.5}
        if entry["model"] == "REEDSSHEPP":
            limits["turning_radius"] = 1.0
        else:
            limits["omega_max"] = 2.0
        if entry["model"] == "PIVOT":
            limits["turning_radius"] = 0.0
        item = MovableObject(
            entry["name"],
            kinds[entry["type"]],
            footprint=[tuple(c) for c in entry["footprint"]],
            motion_model=MotionModels[entry["model"].replace("PIVOT", "REEDSSHEPP")],
            motion_parameters=limits,
        )
        items[entry["name"]] = item
        problem.add_object(item)
        place = ConfigurationObject(f"start_{item.name}", pose_type, SE2(*entry["initial"]))
        problem.add_object(place)
        problem.set_initial_configuration(item, place)
    crew = problem.add_resource("crew", 2)
    activities = {}
    for entry in plan.data["activities"]:
        name = entry["name"]
        motion = next((m for m in plan.data["motions"] if m["activity"] == name), None)
        if motion is not None:
            a = problem.add_motion_activity(name)
            a.set_duration_bounds(1, 400)
            ends = []
            for which, row in (("from", motion["samples"][0]), ("to", motion["samples"][-1])):
                place = ConfigurationObject(f"{name}_{which}", pose_type, SE2(*row[1:]))
                problem.add_object(place)
                ends.append(place)
            a.add_motion_constraint(ActivityWaypoints(items[motion["object"]], ends[0], [ends[1]]))
            for change in (c for c in plan.data["changes"] if c["activity"] == name):
                set_down = SE2(*change["configuration"])
                place = ConfigurationObject(f"{name}_{change['object']}", pose_type, set_down)
                problem.add_object(place)
                a.add_motion_effect(items[change["object"]], place)
        elif name.startswith("set_"):
            a = problem.add_motion_activity(name, entry["end"] - entry["start"])
            (change,) = [c for c in plan.data["changes"] if c["activity"] == name]
            place = ConfigurationObject(f"{name}_to", pose_type, SE2(*change["configuration"]))
            problem.add_object(place)
            a.add_motion_effect(items[change["object"]], place)
            if name != "set_aside":
                problem.add_constraint(GE(a.start, entry["start"]))
        else:
            a = problem.add_activity(name, duration=entry["end"] - entry["start"])
            a.uses(crew, 1)
        activities[name] = a
    _constrain(rng, plan, problem, activities)
    return problem


def _constrain(rng, plan, problem, activities):
    spans = {e["name"]: (e["start"], e["end"]) for e in plan.data["activities"]}
    for robot in plan.robots:
        mine = sorted((n for n in spans if f"_{robot}_" in n), key=lambda n: spans[n])
        for one, two in itertools.pairwise(mine):
            a, b = activities[one], activities[two]
            if rng.random() < 0.5:
                problem.add_constraint(LT(a.end, b.start))
            else:
                problem.add_constraint(Or(LT(a.end, b.start), LT(b.end, a.start)))
    names = sorted(spans)
    lamp = Fluent("lamp", BoolType())
    problem.add_fluent(lamp, default_initial_value=False)
    lit = None
    for _ in range(4):
        one, two = rng.sample(names, 2) if len(names) > 1 else (names[0], names[0])
        if spans[one][1] >= spans[two][0]:
            continue
        a, b = activities[one], activities[two]
        if lit is None and rng.random() < 0.5:
            lit = one
            a.add_effect(a.end, lamp, TRUE())
            if rng.random() < 0.5:
                b.add_condition(TimePointInterval(Timing(0, b.start)), lamp)
            else:
                span = ClosedTimeInterval(Timing(0, b.start), Timing(0, b.end))
                b.add_condition(span, lamp)
        else:
            problem.add_constraint(Or(LT(a.end, b.start), LT(b.end, a.start)))


def drive(executor, robot, to, now, step=0.1):
    """Tell progress up to ``to`` m at 1 m/s; return the time, and the last answer."""
    at, reply = executor.state.of_object[robot].told, None
    while at < to - 1e-9:
        at, now = min(to, at + step), now + step
        reply = executor.update(robot, progress=at, now=now)
        executor.commands(now)
    return now, reply
