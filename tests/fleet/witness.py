"""Random small fleets that have a plan: one is made first, and then the problem around it.

Whatever the problem asks (windows, levels of batteries, loads, doors) is drawn around a plan in
which one robot acts at a time. So nobody may call it unsolvable, nor a slower plan optimal.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

import numpy as np
from shapely.geometry import Polygon

from tests.fleet.floors import CLOSED, LEAF, LEFT, OPEN, RIGHT, WALL, map_with, zone_of
from up_samp.fleet.files import read_record
from up_samp.fleet.loads import with_load
from up_samp.fleet.outlines import body_of, placed, still
from up_samp.fleet.records import Attached, RobotType
from up_samp.geometry import load_map
from up_samp.model import Deadline, PathQuery, Placed
from up_samp.motion import MotionService

PALLET = (0.9, 0.7)


class NoWitnessError(Exception):
    """The random plan came to nothing: take another seed."""


@dataclass
class Made:
    """A problem as its author writes it (``spec``), and what its witness takes (s)."""

    spec: dict
    makespan: float
    features: set = field(default_factory=set)


class Maker:
    """Draws one problem, and makes its witness as it goes."""

    def __init__(self, seed: int, folder) -> None:
        self.rng = random.Random(seed)
        self.features = {f for f in FEATURES if self.rng.random() < FEATURES[f]}
        self.unit = self.rng.choice([1.0, 1.0, 0.5, 2.0])
        rooms = self.rng.random() < 0.6
        if not rooms:
            self.features -= {"door"}
        self.walls = WALL if rooms else ()
        path = map_with(self.walls, folder)
        self.spec = {
            "map": str(path), "seconds_per_unit": self.unit,
            "robot_types": {}, "robots": {}, "places": {}, "doors": {}, "zones": {},
            "resources": {}, "orders": [], "tasks": [], "walls": list(self.walls),
        }  # fmt: skip
        self.service = MotionService(load_map(path))
        self.clock = 0
        self.zone, self.crowd = None, 0
        self.shuts, self.opened = None, {}
        self.closes = self.rng.choice([None, None, 15.0, 30.0])
        if "zone" in self.features:
            self.zone = zone_of(self.rng)
        self.open = False
        self.windows: list = []
        self.more, self.begun = random.Random(-1 - seed), []
        self.driven, self.aboard = set(), random.Random(f"{seed}, aboard")
        self._people()
        self._jobs()
        self._wider()

    # -- what there is -----------------------------------------------------------------------------
    def _people(self) -> None:
        rng, spec = self.rng, self.spec
        spots = rng.sample(LEFT, len(LEFT)), rng.sample(RIGHT, len(RIGHT))
        self.left, self.right = [list(s) for s in spots]
        kind = {
            "footprint": [0.7, 0.5], "model": rng.choice(["diff", "diff", "omni"]),
            "v_max": rng.choice([1.0, 1.5, 2.0]), "a_max": 1.0, "omega_max": 2.0,
            "capacity": {"item": rng.choice([1, 1, 2])},
        }  # fmt: skip
        if "battery" in self.features:
            kind["battery"] = {"capacity": 1e6, "per_metre": 1.0, "reserve": 0.0}
        spec["robot_types"]["agv"] = kind
        self.kind = read_record(RobotType, kind)
        self.at, self.used, self.level, self.visits = {}, {}, {}, {}
        self.full = rng.choice([25.0, 40.0, 60.0])
        first = self.full * rng.choice([1.0, 0.7])
        if "charge" in self.features:
            kind["battery"] = {"capacity": self.full, "per_metre": 1.0, "level": first}
            self._place("plug")
            self.step = rng.choice([3, 5, 10])
        for i in range(rng.choice([1, 1, 2, 2, 3])):
            home = self._place(f"home{i}", self.left)
            spec["robots"][f"r{i}"] = {"type": "agv", "start": home}
            self.at[f"r{i}"], self.used[f"r{i}"] = home, []
            self.level[f"r{i}"], self.visits[f"r{i}"] = first, 0
        if "door" in self.features:
            inner, outer = self._place("button", self.left), self._place("knob", self.right)
            door = {"leaf": list(LEAF), "closed": list(CLOSED), "open": list(OPEN), "seconds": 2}
            spec["doors"]["gate"] = door | {"opened_from": [inner, outer]}
        if "resource" in self.features:
            spec["resources"]["table"] = {"capacity": 1}
        self.loads = {}

    def _place(self, name, spots=None):
        if spots is None:
            spots = self.rng.choice([s for s in (self.left, self.right) if s] or [None])
        if not spots:
            raise NoWitnessError
        x, y = spots.pop()
        turn = self.rng.choice([0.0, math.pi / 2, math.pi])
        self.spec["places"][name] = {"pose": [x, y, turn]}
        return name

    # -- what the witness does ---------------------------------------------------------------------
    def _units(self, seconds) -> int:
        return max(1, math.ceil(seconds / self.unit - 1e-9))

    def _drive(self, robot, to, load=None) -> None:
        """Drive while all others rest; levels are settled later."""
        if self.at[robot] == to:
            return
        if self.open and self.shuts is not None and self.clock > self.shuts:
            self.open = False
        if self._needs_door(self.at[robot], to) and not self.open:
            self._open(robot)
            if self.at[robot] == to:
                return
        self.driven.add(robot)
        poses = [tuple(self.spec["places"][p]["pose"]) for p in (self.at[robot], to)]
        others = self._in_the_way(robot, to, load)
        rides = load is not None and self.at[robot] == self.loads.get(load)
        body = with_load(self.kind, Attached(PALLET)) if rides else body_of(self.kind)
        way = self.service.plan(
            PathQuery(body, tuple(poses), tuple(others)), Deadline.after(20)
        ).trajectory
        if way is None:
            raise NoWitnessError
        length = self._units(way.duration)
        if self.open and self.shuts is not None and self.clock + length > self.shuts:
            self.clock, self.open = max(self.clock, self.shuts) + 1, False  # it shuts first
            self._drive(robot, to, load)
            return
        free = self.service.plan(PathQuery(body, tuple(poses)), Deadline.after(20)).trajectory
        metres = float(np.hypot(*np.diff(free.poses[:, :2], axis=0).T).sum())
        self.used[robot].append(metres)
        if "charge" in self.features:
            self.level[robot] -= metres + 0.001 * self.full
            if self.level[robot] < 0:
                raise NoWitnessError
        self.clock += length
        if rides:
            self.loads[load] = to
        self.at[robot] = to

    def _in_the_way(self, robot, to, load) -> list[Placed]:
        """Return what a drive has to get around: robots, loads, the door and perhaps the zone."""
        here = [self.spec["places"][p]["pose"] for r, p in self.at.items() if r != robot]
        others = [Placed(f"o{i}", body_of(self.kind), tuple(p)) for i, p in enumerate(here)]
        others += [
            Placed(o, still(PALLET), tuple(self.spec["places"][p]["pose"]))
            for o, p in self.loads.items()
            if o != load and p not in (self.at[robot], to)
        ]
        if any(p == to for o, p in self.loads.items() if o != load) and load is not None:
            raise NoWitnessError
        if "door" in self.features:
            others.append(Placed("gate", still(LEAF), OPEN if self.open else CLOSED))
        if any(self.at[r] == to for r in self.at):
            raise NoWitnessError
        if self._crossing(robot, to, load):
            corners = tuple(self.zone.exterior.coords[:-1])
            others.append(Placed("zone", still(corners), (0.0, 0.0, 0.0)))
        return others

    def _needs_door(self, a, b) -> bool:
        sides = [self.spec["places"][p]["pose"][0] < 8 for p in (a, b)]
        return "door" in self.features and sides[0] != sides[1]

    def _open(self, robot) -> None:
        side = self.spec["places"][self.at[robot]]["pose"][0] < 8
        self._drive(robot, "button" if side else "knob")
        self.clock += self._units(2) + 1
        self.open = True
        self.opened[robot] = self.opened.get(robot, 0) + 1
        if sum(self.opened.values()) > 8:
            raise NoWitnessError
        if self.closes is not None:
            self.shuts = self.clock - 1 + self._units(self.closes)
            self.spec["doors"]["gate"] |= {
                "closes": self.closes,
                "times": max(self.opened.values()),
            }

    def _stop(self, key, job, service) -> None:
        """Do something at a place, and say when it may be done."""
        start, self.clock = self.clock, self.clock + self._units(service)
        stop = job[key] if key else job
        stop["service" if key else "duration"] = service
        if "window" in self.features and self.rng.random() < 0.4:
            early = start * self.unit - self.rng.choice([0, 0, 3, 20])
            window = [max(0.0, early), self.clock * self.unit + self.rng.choice([0, 0, 2])]
            others = self.rng.sample([[0, 1 + service], [window[1] + 3, window[1] + 90]], 2)
            stop["window"] = self.rng.choice(
                [window, [window], [others[0], window], [*others, window]]
            )
        if "resource" in self.features and self.rng.random() < 0.5:
            stop["resources"] = ["table"]

    # -- what there is to do -----------------------------------------------------------------------
    def _jobs(self) -> None:
        rng = self.rng
        todo = [self._order(i) for i in range(rng.choice([1, 1, 2, 2, 3]))]
        if rng.random() < 0.3:
            job = {"id": "t0", "at": [self._place("t0at")]}
            self.spec["tasks"].append(job)
            todo.append(job)
        rng.shuffle(todo)
        done = []
        while todo:
            job = todo.pop()
            robot = rng.choice(list(self.at))
            self._charge(robot)
            mates = [j for j in todo if "pickup" in j and "attached" not in j]
            two = "pickup" in job and "attached" not in job and self.kind.capacity["item"] > 1
            if two and mates and rng.random() < 0.6:
                mate = mates[0]
                todo.remove(mate)
                self._pick(robot, job)
                self._pick(robot, mate)
                for j in rng.sample([job, mate], 2):
                    self._deliver(robot, j)
                done += [job, mate]
                names = [job, mate]
            elif "pickup" in job:
                self._pick(robot, job)
                self._deliver(robot, job)
                names = [job]
                done.append(job)
            else:
                self.begun.append(job)
                self._drive(robot, job["at"][0])
                self._stop(None, job, rng.choice([1, 3, 7]))
                names = [job]
                done.append(job)
            for j in names:
                self._rules(j, robot, [d for d in done if d not in names])
            if "handover" in self.features and isinstance(job.get("attached"), dict):
                self._onwards(job, robot)
        self._ends()
        self._battery()
        self._zone()

    def _wider(self) -> None:
        """More that may be asked for without a change of the witness: other places to choose from,
        who begins no later than whom, and what no robot does.
        """
        orders = [j for j in self.begun if "at" in j.get("pickup", ()) and "attached" not in j]
        if orders and self.more.random() < 0.3 and "zone" not in self.features:
            stop = self.more.choice(orders)[self.more.choice(["pickup", "delivery"])]
            if "button" not in stop["at"] and "button" in self.spec["places"]:
                stop["at"] = [*stop["at"], "button"]
        if self.more.random() < 0.3:
            for i, job in enumerate(reversed(self.begun)):
                job["priority"] = i // 2
        if self.more.random() < 0.3 and self.begun and not any("optional" in j for j in self.begun):
            last = self.spec["orders"][0]["id"]
            work = {"id": "m0", "duration": self.more.choice([2, 9]), "after": [last]}
            self.spec["tasks"].append(work | {"priority": -1})
            self.clock += self._units(work["duration"])

    def _order(self, i):
        job = {
            "id": f"o{i}",
            "pickup": {"at": [self._place(f"p{i}")]},
            "delivery": {"at": [self._place(f"d{i}")]},
        }
        if "attached" in self.features and self.rng.random() < 0.6:
            job["attached"] = {"footprint": list(PALLET)}
            self.loads[job["id"]] = f"p{i}"
        self.spec["orders"].append(job)
        return job

    def _pick(self, robot, job) -> None:
        if robot not in self.driven and "attached" not in job and self.aboard.random() < 0.3:
            job["pickup"] = {"on": robot}
            return
        self.begun.append(job)
        load = job["id"] if "attached" in job else None
        if load is None and any(p in (job["pickup"]["at"][0],) for p in self.loads.values()):
            raise NoWitnessError
        self._drive(robot, job["pickup"]["at"][0])
        self._stop("pickup", job, self.rng.choice([1, 2, 5]))

    def _deliver(self, robot, job) -> None:
        if "on" in job["pickup"]:
            self.begun.append(job)
        load = job["attached"] if isinstance(job.get("attached"), str) else job["id"]
        if (
            "attached" in job
            and self._needs_door(self.at[robot], job["delivery"]["at"][0])
            and not self.open
        ):
            raise NoWitnessError  # nobody opens a door with a load under way
        self._drive(robot, job["delivery"]["at"][0], load if "attached" in job else None)
        self._stop("delivery", job, self.rng.choice([1, 2, 5]))

    def _onwards(self, job, robot) -> None:
        """Another robot takes the load on."""
        others = [r for r in self.at if r != robot]
        if not others:
            return
        other = self.rng.choice(others)
        name = f"n{job['id']}"
        place = self._place(f"e{job['id']}")
        back = {"id": name, "pickup": {"at": job["delivery"]["at"]}, "delivery": {"at": [place]},
                "attached": job["id"], "robots": [other]}  # fmt: skip
        self.spec["orders"].append(back)
        self._drive(robot, self.spec["robots"][robot]["start"])
        self._pick(other, back)
        self._deliver(other, back)

    def _rules(self, job, robot, before) -> None:
        rng = self.rng
        if "skill" in self.features and rng.random() < 0.5:
            mine = self.spec["robots"][robot].setdefault("skills", [])
            if "lift" not in mine:
                mine.append("lift")
            job["skills"] = ["lift"]
        if "after" in self.features and before and rng.random() < 0.5:
            job["after"] = [rng.choice(before)["id"]]
        if "on" in job.get("pickup", ()):
            return
        if "robots" in self.features and rng.random() < 0.4:
            job["robots"] = [robot]
        if "optional" in self.features and rng.random() < 0.4 and "attached" not in job:
            job |= {"optional": True, "penalty": rng.choice([1, 5, 60])}

    def _ends(self) -> None:
        for robot, spec in self.spec["robots"].items():
            if self.rng.random() < 0.5:
                self._drive(robot, spec["start"])
            if self.at[robot] == spec["start"] or self.rng.random() < 0.3:
                spec["end"] = self.at[robot]

    def _charge(self, robot) -> None:
        """Charge where that is wanted."""
        if "charge" not in self.features or self.level[robot] > self.full * 0.75:
            return
        self._drive(robot, "plug")
        self.visits[robot] += 1
        for _ in range(self.rng.choice([1, 2, 3])):
            given = 2.0 * self.step * 0.999
            if self.level[robot] + given > self.full:
                break  # a step that would not fit is not taken
            self.level[robot] = min(self.full, self.level[robot] + given)
            self.clock += self._units(self.step)

    def _battery(self) -> None:
        """As much as the witness takes, hardly more; each drive may count a grain more."""
        if "charge" in self.features:
            times = max([1, *self.visits.values()])
            charger = {"per_second": 2.0, "step": self.step, "times": times}
            self.spec["places"]["plug"]["charger"] = charger
        if "battery" not in self.features or "charge" in self.features:
            return
        most = max((sum(u) for u in self.used.values()), default=0.0)
        drives = max(len(u) for u in self.used.values())
        reserve = self.rng.choice([0.0, 2.0])
        capacity = (most * self.rng.choice([1.0, 1.0, 1.05, 1.5]) + reserve) / (
            1 - 0.001 * (drives + 2)
        ) + 0.05
        battery = self.spec["robot_types"]["agv"]["battery"]
        battery |= {"capacity": capacity, "reserve": reserve}

    def _zone(self) -> None:
        """A zone in which as many robots may be as the witness has there at most."""
        if self.zone is not None and self.crowd:
            corners = [list(c) for c in self.zone.exterior.coords[:-1]]
            self.spec["zones"]["busy"] = {"polygon": corners, "max_robots": self.crowd}

    def _inside(self, robot, place, load) -> bool:
        """Return whether a robot, with its load, touches the zone at a place."""
        pose = tuple(self.spec["places"][place]["pose"])
        shapes = [self.kind.footprint] + ([PALLET] if load else [])
        return any(self.zone.intersects(Polygon(placed(s, pose))) for s in shapes)

    def _crossing(self, robot, to, load) -> bool:
        """Count the robots in the zone while one drives; return whether it drives around it."""
        if self.zone is None:
            return False
        others = [r for r in self.at if r != robot and self._inside(r, self.at[r], None)]
        visits = any(self._inside(robot, p, load) for p in (self.at[robot], to))
        self.crowd = max(self.crowd, len(others) + visits)
        return not visits


FEATURES = {
    "battery": 0.3, "charge": 0.25, "door": 0.4, "resource": 0.3, "window": 0.4,
    "attached": 0.3, "handover": 0.5,
    "skill": 0.3, "after": 0.3, "robots": 0.2, "optional": 0.25, "zone": 0.35,
}  # fmt: skip


def fleet_of(seed: int, folder) -> Made:
    """Return a random fleet with its witness.

    :raises NoWitnessError: where the random plan came to nothing.
    """
    made = Maker(seed, folder)
    return Made(made.spec, made.clock * made.unit, made.features)
