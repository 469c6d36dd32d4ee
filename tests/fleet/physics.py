"""What a fleet's plan means on the floor: batteries, loads, zones, doors, windows, who is where.

Judged from the problem as its author wrote it (a dictionary) and the plan file's dictionary, by
sampled instants. Nothing of the package is used but the names that it gives activities; what a
drive takes when nobody is in the way, its path planner tells, for the bodies that it makes of
robots and loads.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from shapely.geometry import Polygon

from tests.fleet.shapes import deep, moved, outline, same
from tests.fleet.undisturbed import Undisturbed

STEP = 0.1
"""Sampled instants are so far apart (s)."""


@dataclass(frozen=True)
class Done:
    """An activity of the plan: what it is, by whom, and when (s)."""

    kind: str
    what: str
    robot: str
    start: float
    end: float


class Physics:
    """One plan of one fleet problem. ``faults`` tells all that is wrong with it."""

    def __init__(self, spec, plan) -> None:
        self.spec, self.plan = spec, plan
        self.unit = plan["seconds_per_unit"]
        self.meter = Undisturbed(spec)
        self.done = [self._told(a) for a in plan["activities"]]
        self.motions = {r: [] for r in spec["robots"]}
        for m in plan["motions"]:
            self.motions[m["object"]].append(np.array(m["samples"], dtype=float))
        for some in self.motions.values():
            some.sort(key=lambda rows: rows[0, 0])
        self.over = max((d.end for d in self.done if d.kind != "leave"), default=0.0)

    def _told(self, a) -> Done:
        name, start, end = a["name"], a["start"] * self.unit, a["end"] * self.unit
        words = name.split("_")
        if name.startswith("leave_out_"):
            return Done("leave", name.removeprefix("leave_out_"), "", start, end)
        if words[0] == "skip":
            return Done("skip", words[2], "", start, end)
        if words[0] == "move":
            return Done("move", "", words[1], start, end)
        if words[0] == "charge":
            return Done("charge", words[3], words[1], start, end)
        if words[0] in ("pick", "deliver", "open", "close", "carry"):
            return Done(words[0], words[1], words[2], start, end)
        return Done("task", words[0], words[1] if len(words) > 1 else "", start, end)

    @property
    def faults(self) -> list[str]:
        """Return all that is wrong, in words."""
        rules = (
            self._robots, self._jobs, self._limits, self._orders, self._resources, self._room,
            self._batteries, self._doors, self._shapes, self._penalties,
        )  # fmt: skip
        return [fault for rule in rules for fault in rule()]

    # -- where things are ------------------------------------------------------------------------
    def pose(self, robot, t):
        """Return where a robot is at ``t`` (s)."""
        found = self.spec["places"][self.spec["robots"][robot]["start"]]["pose"]
        for rows in self.motions[robot]:
            if t < rows[0, 0]:
                break
            if t >= rows[-1, 0]:
                found = rows[-1, 1:4]
                continue
            i = int(np.searchsorted(rows[:, 0], t, side="right")) - 1
            share = (t - rows[i, 0]) / (rows[i + 1, 0] - rows[i, 0])
            found = rows[i, 1:4] + share * (rows[i + 1, 1:4] - rows[i, 1:4])
        return np.asarray(found, dtype=float)

    def is_at(self, robot, places, start, end) -> bool:
        """Return whether a robot rests at one of ``places`` all the while."""
        times = [start, (start + end) / 2, end - 1e-6]
        poses = [self.pose(robot, t) for t in times]
        return any(
            all(same(p, self.spec["places"][place]["pose"]) for p in poses) for place in places
        )

    def kind(self, robot):
        """Return the robot's type, as it was written."""
        return self.spec["robot_types"][self.spec["robots"][robot]["type"]]

    def body(self, robot, t):
        """Return the robot's outline on the floor."""
        return moved(outline(self.kind(robot)["footprint"]), self.pose(robot, t))

    def load(self, order, t):
        """Return where the load of an order with a footprint is: on the floor or on its robot."""
        spec = self._order(order)
        place = _first(spec["pickup"])
        pose = self.spec["places"][place]["pose"]
        for carry in sorted(self._carries(order), key=lambda d: d.start):
            if t >= carry.start:
                pose = self.pose(carry.robot, min(t, carry.end - 1e-9))
        return moved(outline(spec["attached"]["footprint"]), pose)

    def _carries(self, order):
        """Return all rides of an order's load, also by orders that take it on."""
        ids = {order} | {o["id"] for o in self.spec["orders"] if o.get("attached") == order}
        return [d for d in self.done if d.kind == "carry" and d.what in ids]

    def _order(self, name):
        return next(o for o in self.spec["orders"] if o["id"] == name)

    def _of(self, kind, what):
        return [d for d in self.done if (d.kind, d.what) == (kind, what)]

    # -- rules -----------------------------------------------------------------------------------
    def _robots(self):
        for robot, spec in self.spec["robots"].items():
            mine = sorted((d for d in self.done if d.robot == robot), key=lambda d: d.start)
            mine = [d for d in mine if d.kind != "close"]
            for a, b in itertools.pairwise(mine):
                if a.end > b.start + 1e-6:
                    yield f"{robot} does two things at a time: {a}, {b}"
            where = self.spec["places"][spec["start"]]["pose"]
            for rows in self.motions[robot]:
                if not same(rows[0, 1:4], where):
                    yield f"{robot} jumps at {rows[0, 0]}"
                where = rows[-1, 1:4]
                steps = np.hypot(*np.diff(rows[:, 1:3], axis=0).T) / np.diff(rows[:, 0])
                if steps.max(initial=0) > self.kind(robot)["v_max"] * 1.01:
                    yield f"{robot} drives {steps.max():.3f} m/s"
            if spec.get("end") and not same(where, self.spec["places"][spec["end"]]["pose"]):
                yield f"{robot} ends elsewhere"

    def _jobs(self):
        for job in [*self.spec["orders"], *self.spec["tasks"]]:
            left = bool(self._of("leave", job["id"]))
            kinds = [("task", job.get("at"))]
            if "pickup" in job:
                kinds = [
                    (k, _stop(job[k2])["at"])
                    for k, k2 in (("pick", "pickup"), ("deliver", "delivery"))
                    if "on" not in _stop(job[k2])
                ]
            if left and not job.get("optional"):
                yield f"{job['id']} is left out and must not be"
            for kind, places in kinds:
                found = self._of(kind, job["id"])
                if len(found) != (0 if left else 1):
                    yield f"{job['id']}: {len(found)} times {kind}"
                for d in found if places else ():
                    if not self.is_at(d.robot, _listed(places), d.start, d.end):
                        yield f"{d}: the robot is not there"
                    if not set(_listed(job.get("skills", ()))) <= set(
                        self.spec["robots"][d.robot].get("skills", ())
                    ):
                        yield f"{d}: the robot lacks a skill"
                    if job.get("robots") and d.robot not in _listed(job["robots"]):
                        yield f"{d}: the robot is none of those named"
            picks, delivers = self._of("pick", job["id"]), self._of("deliver", job["id"])
            carrier = _carrier(job)
            if carrier and (picks or any(d.robot != carrier for d in delivers)):
                yield f"{job['id']} is on {carrier}: picked {picks}, delivered {delivers}"
            for a, b in zip(picks, delivers, strict=False):
                if a.robot != b.robot or a.end > b.start + 1e-6:
                    yield f"{job['id']}: picked {a}, delivered {b}"

    def _limits(self):
        for d, stop, length in self._stops():
            if d.end - d.start < length - 1e-6:
                yield f"{d} should last {length} s"
            windows = stop.get("window", [])
            windows = [windows] if windows and not isinstance(windows[0], list) else windows
            if windows and not any(a - 1e-6 <= d.start and d.end <= b + 1e-6 for a, b in windows):
                yield f"{d} is outside its windows {windows}"

    def _stops(self):
        """Return each stop and task that is done, as it is written, and how long it lasts."""
        for job in self.spec["orders"]:
            for kind, key in (("pick", "pickup"), ("deliver", "delivery")):
                stop = _stop(job[key])
                for d in self._of(kind, job["id"]):
                    yield d, stop, stop.get("service", 1.0)
        for job in self.spec["tasks"]:
            for d in self._of("task", job["id"]):
                yield d, job, job["duration"]

    def _orders(self):
        jobs = {j["id"]: j for j in [*self.spec["orders"], *self.spec["tasks"]]}
        first = {j: "deliver" if _carrier(job) else "pick" for j, job in jobs.items()}
        begins = {j: self._of(first[j], j) + self._of("task", j) for j in jobs}
        ends = {j: self._of("deliver", j) + self._of("task", j) for j in jobs}
        for name, job in jobs.items():
            before = [*_listed(job.get("after", ()))]
            if isinstance(job.get("attached"), str):
                before.append(job["attached"])
            for earlier in before:
                if begins[name] and not ends[earlier]:
                    yield f"{name} without {earlier}"
                for a, b in itertools.product(ends[earlier], begins[name]):
                    if a.end > b.start + 1e-6:
                        yield f"{name} begins before {earlier} is over"
            for other, second in jobs.items():
                if job.get("priority", 0) > second.get("priority", 0):
                    for a, b in itertools.product(begins[name], begins[other]):
                        if a.start > b.start + 1e-6:
                            yield f"{name} begins after {other}"

    def _resources(self):
        users = [(d, r) for d, stop, _ in self._stops() for r in _listed(stop.get("resources", ()))]
        for name, resource in self.spec["resources"].items():
            mine = [d for d, r in users if r == name]
            for d in mine:
                count = sum(e.start <= d.start < e.end for e in mine)
                if count > resource["capacity"]:
                    yield f"{count} use {name} at {d.start}"

    def _room(self):
        for robot in self.spec["robots"]:
            room = self.kind(robot).get("capacity", {"item": 1})
            for t in [0.0, *(d.start for d in self.done if (d.kind, d.robot) == ("pick", robot))]:
                held = {}
                for job in self.spec["orders"]:
                    since = [d.start for d in self._of("pick", job["id"]) if d.robot == robot]
                    if _carrier(job) == robot:
                        since = [0.0]
                    b = next(iter(self._of("deliver", job["id"])), None)
                    if since and since[0] <= t and (b is None or t < b.end - 1e-6):
                        for k, n in job.get("load", {"item": 1}).items():
                            held[k] = held.get(k, 0) + n
                for k, n in held.items():
                    if n > room.get(k, 0):
                        yield f"{robot} holds {n} {k} at {t}"

    def _batteries(self):
        """Drives count as long as they are when nobody is in the way; what they really take may be
        more, by detours among the others, and then the lowest level is told as it is.
        """
        for robot in self.spec["robots"]:
            battery = self.kind(robot).get("battery")
            if battery is None:
                continue
            for d in self.done:
                charges = d.kind == "charge" and d.robot == robot
                if charges and not self.is_at(robot, [d.what], d.start, d.end):
                    yield f"{d}: the robot is not there"
            low = battery.get("reserve", 0) - 1e-6 * battery["capacity"]
            for t, level in self._course(robot, undisturbed=True):
                if level < low:
                    yield f"{robot}'s battery is at {level:.3f} after {t:.2f} s, without detours"

    def levels(self, robot) -> list[float]:
        """Return a robot's battery after each drive and charge, by what is really driven."""
        return [level for _, level in self._course(robot, undisturbed=False)]

    def _course(self, robot, *, undisturbed):
        battery = self.kind(robot)["battery"]
        changes = []
        for rows in self.motions[robot]:
            if undisturbed:
                amount = self.meter.amount(robot, rows, self._riding(robot, rows))
            else:
                metres = np.hypot(*np.diff(rows[:, 1:3], axis=0).T).sum()
                seconds = rows[-1, 0] - rows[0, 0]
                amount = battery.get("per_metre", 0) * metres
                amount += battery.get("per_second", 0) * seconds
            changes.append((rows[-1, 0], -amount))
        for d in self.done:
            if d.kind == "charge" and d.robot == robot:
                charger = self.spec["places"][d.what]["charger"]
                changes.append(
                    (d.end, charger["per_second"] * min(charger["step"], d.end - d.start))
                )
        level = battery.get("level", battery["capacity"])
        course = [(0.0, level)]
        for t, change in sorted(changes):
            level = min(battery["capacity"], level + change)
            course.append((t, level))
        return course

    def _riding(self, robot, rows):
        """Return the order, as it is written, whose load is on board in a drive."""
        for d in self.done:
            if d.kind == "carry" and d.robot == robot and d.start - 1e-6 <= rows[0, 0] < d.end:
                order = self._order(d.what)
                while isinstance(order["attached"], str):
                    order = self._order(order["attached"])
                return order
        return None

    def _doors(self):
        for name, door in self.spec["doors"].items():
            for d in self._of("open", name):
                if not self.is_at(d.robot, _listed(door["opened_from"]), d.start, d.end):
                    yield f"{d}: the robot is not there"
                if d.end - d.start < door.get("seconds", 1.0) - 1e-6:
                    yield f"{d}: too quick"
        for name, leaf, t in (
            (n, self._leaf(n, t), t) for n in self.spec["doors"] for t in self._ticks()
        ):
            for robot in self.spec["robots"]:
                if deep(self.body(robot, t), leaf):
                    yield f"{robot} is in {name} at {t:.2f}"

    def _leaf(self, name, t):
        """Return where a door's leaf is: closed, or open so long after it was opened."""
        door = self.spec["doors"][name]
        stays = door.get("closes") or math.inf
        is_open = any(
            d.end <= t < d.end + math.ceil(stays / self.unit - 1e-9) * self.unit
            if stays < math.inf
            else d.end <= t
            for d in self._of("open", name)
        )
        return moved(outline(door["leaf"]), door["open" if is_open else "closed"])

    def _ticks(self):
        return np.arange(0.0, self.over + STEP, STEP)

    def _shapes(self):
        walls = self.spec["walls"]
        loads = [o["id"] for o in self.spec["orders"] if isinstance(o.get("attached"), dict)]
        for t in self._ticks():
            bodies = {r: self.body(r, t) for r in self.spec["robots"]}
            pallets = {o: self.load(o, t) for o in loads}
            for robot, shape in bodies.items():
                if any(deep(shape, w) for w in walls):
                    yield f"{robot} is in a wall at {t:.2f}"
            for o, shape in pallets.items():
                if any(deep(shape, w) for w in walls):
                    yield f"the load of {o} is in a wall at {t:.2f}"
            for (a, x), (b, y) in itertools.combinations([*bodies.items(), *pallets.items()], 2):
                if deep(x, y) and not self._under(a, b, t):
                    yield f"{a} and {b} meet at {t:.2f}"
            yield from self._zones(bodies, pallets, t)

    def _under(self, robot, order, t) -> bool:
        """Return whether a robot may be under a load: on its way to it, with it, and away."""
        if robot not in self.spec["robots"] or order in self.spec["robots"]:
            return False
        mine = sorted((d for d in self.done if d.robot == robot), key=lambda d: d.start)
        for ride in (d for d in self._carries(order) if d.robot == robot):
            drives = [d for d in mine if d.kind in ("move", "carry")]
            i = drives.index(ride)
            start = drives[i - 1].start if i else 0.0
            end = drives[i + 1].end if i + 1 < len(drives) else math.inf
            if start <= t <= end:
                return True
        return False

    def _zones(self, bodies, pallets, t):
        for name, zone in self.spec["zones"].items():
            floor = Polygon(zone["polygon"])
            inside = []
            for robot, shape in bodies.items():
                riding = [
                    pallets[o]
                    for o in pallets
                    if any(d.robot == robot and d.start < t < d.end for d in self._carries(o))
                ]
                if any(deep(s, floor) for s in (shape, *riding)):
                    inside.append(robot)
            if len(inside) > zone.get("max_robots", math.inf):
                yield f"{inside} are in {name} at {t:.2f}"
            for robot in inside:
                if self.spec["robots"][robot]["type"] in _listed(zone.get("keep_out", ())):
                    yield f"{robot} is in {name} at {t:.2f}, which it must keep out of"

    def _penalties(self):
        jobs = {j["id"]: j for j in [*self.spec["orders"], *self.spec["tasks"]]}
        owed = sum(jobs[d.what]["penalty"] for d in self.done if d.kind == "leave")
        makespan = self.plan["makespan"] * self.unit
        if makespan < self.over + owed - 1e-6:
            yield f"a makespan of {makespan} s, with {self.over} s and penalties of {owed}"


def _first(stop):
    return _listed(_stop(stop)["at"])[0]


def _stop(value):
    return value if isinstance(value, dict) else {"at": value}


def _carrier(job):
    """Return who has a load on board at first."""
    return _stop(job.get("pickup", {})).get("on")


def _listed(value):
    return [value] if isinstance(value, str) else list(value)
