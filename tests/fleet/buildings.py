"""Random small fleets of all that a fleet can be asked, as plain dictionaries.

One or two storeys with lifts, one or two robots with shifts, breaks, batteries and racks that are
unloaded last in, first out; orders and tasks with releases, due times, windows, repeats,
priorities, penalties; a door, a zone, and objectives of several terms.
"""

import copy
import math
import random

import numpy as np

from up_samp.fleet import Fleet
from up_samp.geometry import write_map

SIZE, CELL = (8.0, 15.0), 0.1
SPOTS = [(x, y, 0.0) for x in (2.0, 4.6) for y in (1.6, 4.1, 6.4)]
SPOTS += [(x, y, math.pi) for x in (9.3, 11.2) for y in (1.6, 4.1, 6.4)]
TERMS = ("makespan", "tardiness", "completion", "driving", "robots")


def storey(folder, name, wall=None):
    """Write a hall, with a wall and a doorway in it or without; return its file."""
    cells = np.zeros([round(side / CELL) for side in SIZE], dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    if wall is not None:
        x = round(wall / CELL)
        cells[:, x : x + 2] = True
        cells[30:52, x : x + 2] = False
    return str(write_map(folder, name, cells, CELL))


class Building:
    """Draws one fleet. ``spec`` maps each word of a fleet file's tables to what is told there."""

    def __init__(self, seed, folder):
        r = self.rng = random.Random(seed)
        self.wall = 6.8 if r.random() < 0.5 else None
        self.upstairs = r.random() < 0.55
        self.free = {f: r.sample(SPOTS, len(SPOTS)) for f in ("ground", "first")}
        terms = r.sample(TERMS, r.randint(1, 3)) if r.random() < 0.6 else ()
        self.spec = {
            "map": storey(folder, "low", self.wall), "unit": r.choice([1.0, 1.0, 0.5, 2.0]),
            "objective": {t: r.choice([1, 2, 0.5, 10, 0.1]) for t in terms} or "makespan",
            "floors": {}, "lifts": {}, "types": {}, "robots": {}, "places": {}, "doors": {},
            "zones": {}, "orders": [], "tasks": [],
        }  # fmt: skip
        if self.upstairs:
            self.spec["floors"]["first"] = (storey(folder, "high"), 4.0)
            for k in range(r.choice([1, 1, 2])):
                stop = [13.4, (1.6, 6.4)[k], 0]
                self.spec["lifts"][f"lift{k}"] = {
                    "stops": {"ground": stop, "first": stop}, "seconds": r.choice([5, 11.5, 20]),
                }  # fmt: skip
        self.battery = r.random() < 0.4
        self._type()
        for i in range(r.choice([1, 1, 2, 2])):
            self._robot(i)
        self._jobs()
        self._rooms()

    def _floor(self):
        return self.rng.choice(["ground", "first"] if self.upstairs else ["ground"])

    def _place(self, name, floor=None, **options):
        floor = floor or self._floor()
        place = {"pose": list(self.free[floor].pop()), "floor": floor, **options}
        self.spec["places"][name] = place
        return name

    def _type(self):
        r = self.rng
        kind = {
            "footprint": [0.7, 0.5], "model": r.choice(["diff", "omni", "omni"]),
            "v_max": r.choice([1.0, 2.0]), "a_max": 1.0, "omega_max": 2.0,
            "capacity": {"item": r.choice([1, 2, 2])},
            "unloading": r.choice(["any", "any", "lifo"]),
        }  # fmt: skip
        if self.battery:
            capacity = r.choice([25.0, 40.0, 80.0])
            kind["battery"] = {
                "capacity": capacity, "per_metre": 1.0, "per_second": r.choice([0, 0.1]),
                "reserve": r.choice([0, 2.0]), "level": r.choice([0.6, 1.0]) * capacity,
            }  # fmt: skip
            if r.random() < 0.7:
                charger = {"per_second": r.choice([1.0, 2.0]), "step": r.choice([5, 10])}
                self._place("plug", charger=charger)
        self.spec["types"]["agv"] = kind

    def _robot(self, i):
        r = self.rng
        robot = {"type": "agv"}
        floor = "ground" if not self.upstairs or r.random() < 0.7 else "first"
        if r.random() < 0.4 and floor == "ground":
            robot["start"] = list(self.free["ground"].pop())
        else:
            robot["start"] = self._place(f"home{i}", floor)
            if r.random() < 0.5:
                robot["end"] = robot["start"]
        if r.random() < 0.35:
            begin = r.choice([0, 0, 7.5, 20])
            robot["shift"] = [begin, begin + r.choice([40, 90.5, 300])]
        if r.random() < 0.35:
            begin, lasts = r.choice([0, 6, 12.5]), r.choice([5, 10.5])
            until = begin + lasts + r.choice([2, 20, 60])
            robot["breaks"] = [{"duration": lasts, "window": [begin, until]}]
            if r.random() < 0.3:
                robot["breaks"].append({"duration": 4, "window": [until, until + 30]})
        if self.battery and r.random() < 0.3:
            full = self.spec["types"]["agv"]["battery"]["capacity"]
            robot["level"] = r.choice([0.3, 0.8]) * full
        self.spec["robots"][f"r{i}"] = robot

    def _jobs(self):
        r, spec = self.rng, self.spec
        spots = [self._place(f"p{k}") for k in range(r.choice([2, 3]))]
        for k in range(r.choice([0, 1, 1, 2])):
            pickup, delivery = r.sample(spots, 2)
            order = {"id": f"o{k}", "pickup": pickup, "delivery": delivery}
            if r.random() < 0.3:
                window, service = [0, r.choice([60, 200])], r.choice([0.5, 3, 4.2])
                order["pickup"] = {"at": pickup, "service": service, "window": window}
            if r.random() < 0.25:
                order["delivery"] = r.sample(spots, 2)
            spec["orders"].append(order)
        for k in range(r.choice([0, 1, 1]) if spec["orders"] else r.choice([1, 2])):
            task = {"id": f"t{k}", "at": r.choice(spots), "duration": r.choice([1, 2.5, 6])}
            spec["tasks"].append(task)
        jobs = spec["orders"] + spec["tasks"]
        more = 4 - len(jobs)
        for i, job in enumerate(jobs):
            self._asked(job)
            if more > 0 and r.random() < 0.3:
                job["repeat"] = {"every": r.choice([10, 25.5]), "times": 2}
                more -= 1
            if i and r.random() < 0.2:
                job["after"] = jobs[0]["id"]

    def _asked(self, job):
        r = self.rng
        if r.random() < 0.35:
            job["release"] = r.choice([3, 9.5, 25])
        if "tardiness" in self.spec["objective"] and r.random() < 0.8:
            job["due"], job["weight"] = r.choice([8, 20.5, 40]), r.choice([1, 2, 0.5])
        elif "completion" in self.spec["objective"] and r.random() < 0.4:
            job["weight"] = r.choice([2, 0.5])
        if r.random() < 0.25:
            job["optional"], job["penalty"] = True, r.choice([3, 15, 60.5])
        if r.random() < 0.15:
            job["priority"] = 1
        if r.random() < 0.15:
            job["robots"] = r.choice(list(self.spec["robots"]))

    def _rooms(self):
        r = self.rng
        if self.wall and r.random() < 0.4:
            self.spec["doors"]["gate"] = {
                "leaf": [0.2, 2.1], "closed": [6.9, 4.1, 0], "open": [6.9, 6.5, 0],
                "opened_from": [self._place("button", "ground")], "seconds": 2,
            }  # fmt: skip
        if r.random() < 0.3:
            x, floor = r.choice([4.6, 9.3]), self._floor()
            corners = [[x + a, b] for a, b in ((-1.2, 2.9), (1.2, 2.9), (1.2, 5.3), (-1.2, 5.3))]
            self.spec["zones"]["busy"] = {"polygon": corners, "max_robots": 1, "floor": floor}


def built(spec):
    """Return the fleet that a dictionary tells of."""
    unit, objective = spec["unit"], spec["objective"]
    fleet = Fleet(spec["map"], objective=objective, seconds_per_unit=unit)
    for name, (file, height) in spec["floors"].items():
        fleet.add_floor(name, file, height)
    for name, place in spec["places"].items():
        options = {k: v for k, v in place.items() if k != "pose"}
        fleet.add_place(name, *place["pose"], **options)
    tables = (
        ("lifts", fleet.add_lift), ("types", fleet.add_robot_type), ("robots", fleet.add_robot),
        ("doors", fleet.add_door), ("zones", fleet.add_zone), ("resources", fleet.add_resource),
        ("automatic_doors", fleet.add_automatic_door),
    )  # fmt: skip
    for table, add in tables:
        for name, options in spec.get(table, {}).items():
            add(name, **options)
    for order in spec["orders"]:
        fleet.add_order(**order)
    for task in spec["tasks"]:
        fleet.add_task(**task)
    return fleet


def looser(spec, seed):
    """Return a fleet that is asked for less, and what it is not asked any more: no plan of the
    first is none of the second.
    """
    spec = copy.deepcopy(spec)
    kind = spec["types"]["agv"]
    asked = [(r, k) for r in spec["robots"].values() for k in ("shift", "breaks", "end") if k in r]
    for job in spec["orders"] + spec["tasks"]:
        asked += [(job, k) for k in ("release", "after", "priority", "robots") if k in job]
        pickup = job.get("pickup")
        asked += [(pickup, "window")] if isinstance(pickup, dict) else []
    asked += [(zone, "max_robots") for zone in spec["zones"].values() if "max_robots" in zone]
    asked += [(kind, k) for k in ("unloading", "battery") if kind.get(k, "any") != "any"]
    if not asked:
        return spec, "nothing"
    told, what = random.Random(seed).choice(asked)
    if what == "max_robots":
        told[what] = 9
    elif what == "battery":
        told[what] |= {"capacity": 1e3, "level": 1e3}
        for robot in spec["robots"].values():
            robot.pop("level", None)
    elif what == "unloading":
        told[what] = "any"
    else:
        del told[what]
    return spec, what
