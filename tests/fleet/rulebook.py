"""What a fleet's plan has to keep, in seconds, read from what its author asked for alone.

Knows nothing of Unified Planning: of the plan it takes what happens when, and the motions.
"""

import itertools
import math
from fractions import Fraction

import numpy as np

from tests.fleet import driving

NEAR = 1e-6


class Rulebook:
    """One plan of a fleet of ``buildings``. ``faults`` tells all that is wrong with it."""

    def __init__(self, spec, result):
        self.spec, self.result, self.plan = spec, result, result.data
        self.unit = unit = self.plan["seconds_per_unit"]
        self.faults = []
        self.done = [
            (what, a, a["start"] * unit, a["end"] * unit)
            for what, a in result.written.happening(self.plan["activities"])
        ]
        self.rests = {robot: self._rests(robot) for robot in spec["robots"]}
        for robot in spec["robots"]:
            self._robot(robot)
            self._load(robot)
        if len(spec["robots"]) == 1:
            self._battery(*spec["robots"])
        self._lifts()
        driving.check(spec, self.plan, self.fault)
        self.begun, self.ended, self.penalty, self.used = {}, {}, 0.0, {}
        for job, name, later in self.repeated():
            self._job(job, name, later)
        for resource, some in self.used.items():
            self._used(resource, spec["resources"][resource], sorted(some))
        for place, told in spec["places"].items():
            if "room" in told:
                self._buffer(place, told)
        self._sequels()
        self._value()

    def fault(self, *words):
        """Note a fault."""
        self.faults.append(" ".join(map(str, words)))

    def repeated(self):
        """Yield every job as often as it is to be done: (told, its name, how much later, s)."""
        for job in self.spec["orders"] + self.spec["tasks"]:
            again = job.get("repeat", {"every": 0, "times": 1})
            for i in range(again["times"]):
                yield job, job["id"] + (f"_{i + 1}" if i else ""), i * again["every"]

    # -- where robots are ------------------------------------------------------------------------

    def _rests(self, robot):
        """Return when a robot stands where: (since, until, floor, pose)."""
        start = self.spec["robots"][robot]["start"]
        floor, pose = "ground", start
        if isinstance(start, str):
            place = self.spec["places"][start]
            floor, pose = place["floor"], place["pose"]
        events = [(m["samples"][0][0], m) for m in self.plan["motions"] if m["object"] == robot]
        rides = [d for d in self.done if d[0].kind.value == "ride" and d[0].robot == robot]
        rests, since = [], 0.0
        for time, item in sorted(events + [(d[2], d) for d in rides], key=lambda e: e[0]):
            rests.append((since, time, floor, pose))
            if isinstance(item, dict):
                pose, since = self._driven(robot, item, floor, pose)
            else:
                floor, pose, since = self._ridden(item, floor, pose)
        return [*rests, (since, math.inf, floor, pose)]

    def _driven(self, robot, motion, floor, pose):
        rows = motion["samples"]
        if math.dist(rows[0][1:3], pose[:2]) > 1e-3:
            self.fault(robot, "jumps", motion["activity"], rows[0], pose)
        maps = self.plan.get("maps") or [self.plan["map"]]
        upstairs = maps[motion.get("map", 0)].get("height")
        if self.spec["floors"] and ("first" if upstairs else "ground") != floor:
            self.fault(robot, "drives on another floor than", floor)
        return rows[-1][1:4], rows[-1][0]

    def _ridden(self, done, floor, pose):
        what, activity, start, end = done
        lift = self.spec["lifts"][what.what]
        if end - start < lift["seconds"] + lift.get("per_floor", 0) - NEAR:
            self.fault("a ride too quick", activity)
        seats = [
            k for k, at in enumerate(_seats(lift, floor)) if math.dist(at[:2], pose[:2]) < 1e-3
        ]
        if not seats:
            self.fault("rides from elsewhere", activity, pose)
        floor = "first" if floor == "ground" else "ground"
        there = _seats(lift, floor)[seats[0] if seats else 0]
        set_ = [c for c in self.plan["changes"] if c["activity"] == activity["name"]]
        if len(set_) != 1 or math.dist(set_[0]["configuration"][:2], there[:2]) > 1e-3:
            self.fault("a ride that leads elsewhere", activity, set_)
        return floor, there, end

    def _stands(self, robot, places, start, end):
        """Return whether a robot stands at one of some places all the time."""
        for since, until, floor, pose in self.rests[robot]:
            if since <= start + NEAR and until >= end - NEAR:
                for place in map(self.spec["places"].get, places):
                    near = math.dist(place["pose"][:2], pose[:2]) < 1e-3
                    if place["floor"] == floor and near:
                        return True
        return False

    # -- robots ----------------------------------------------------------------------------------

    def _of(self, robot):
        mine = [d for d in self.done if d[0].robot == robot and d[0].kind.value != "skip"]
        return sorted(mine, key=lambda d: d[2])

    def _robot(self, robot):
        told, mine = self.spec["robots"][robot], self._of(robot)
        for one, two in itertools.pairwise(mine):
            if one[3] > two[2] + NEAR:
                self.fault(robot, "does two things at a time", one[1], two[1])
        begin, end = told.get("shift", (-math.inf, math.inf))
        for what, activity, low, high in mine:
            outside = low < begin - NEAR or high > end + NEAR
            if outside and what.kind.value != "break":
                self.fault(robot, "outside its shift", activity)
        breaks = sorted(told.get("breaks", ()), key=lambda b: b["window"][0])
        taken = [d for d in mine if d[0].kind.value == "break"]
        if len(taken) != len(breaks):
            self.fault(robot, "takes", len(taken), "breaks")
        for asked, (_, activity, low, high) in zip(breaks, taken, strict=False):
            first, last = asked["window"]
            within = first - NEAR <= low and high <= last + NEAR
            if not within or high - low < asked["duration"] - NEAR:
                self.fault(robot, "takes a wrong break", activity, asked)
            if not any(a <= low + NEAR and b >= high - NEAR for a, b, _, _ in self.rests[robot]):
                self.fault(robot, "drives in its break")
        if told.get("end") and not self._stands(robot, [told["end"]], math.inf, math.inf):
            self.fault(robot, "ends elsewhere")

    def _load(self, robot):
        kind = self.spec["types"]["agv"]
        loaded = [o["id"] for o in self.spec["orders"] if _carrier(o) == robot]
        moved = [
            (low if what.kind.value == "pick" else high, what.kind.value == "pick", what.what)
            for what, _, low, high in self._of(robot)
            if what.kind.value in ("pick", "deliver")
        ]
        for _, picks, item in sorted(moved):
            if picks:
                loaded.append(item)
                if len(loaded) > kind["capacity"]["item"]:
                    self.fault(robot, "is overfull", loaded)
            elif item not in loaded:  # nor at first
                self.fault(robot, "delivers what it has not", item)
            else:
                if kind["unloading"] == "lifo" and loaded[-1] != item:
                    self.fault(robot, "unloads from below", loaded, item)
                loaded.remove(item)

    def _battery(self, robot):
        battery = self.spec["types"]["agv"].get("battery")
        if battery is None:
            return
        changes, full = [], battery["capacity"]
        for motion in self.plan["motions"]:
            rows = np.array(motion["samples"])
            metres = np.hypot(*np.diff(rows[:, 1:3], axis=0).T).sum()
            used = metres * battery["per_metre"]
            used += battery["per_second"] * (rows[-1, 0] - rows[0, 0])
            changes.append((rows[-1, 0], -used))
        for what, _, low, high in self._of(robot):
            if what.kind.value == "charge":
                charger = self.spec["places"][what.what]["charger"]
                changes.append((high, _charged(charger, battery)))
                if high - low < charger.get("swap", charger.get("step", 0)) - NEAR:
                    self.fault(robot, "charges too short")
                if not self._stands(robot, [what.what], low, high):
                    self.fault(robot, "charges elsewhere")
        level = self.spec["robots"][robot].get("level", battery["level"])
        for time, change in sorted(changes, key=lambda c: c[0]):
            level = change(level) if callable(change) else level + change
            if level > full * 1.001:
                self.fault("overcharged", level, time)
            if level < battery["reserve"] - 0.003 * battery["capacity"]:
                self.fault("empty", level, time)

    def _lifts(self):
        rides = {}
        for what, _, low, high in self.done:
            if what.kind.value == "ride":
                rides.setdefault(what.what, []).append((low, high, what.robot))
        for lift, some in rides.items():
            stop = self.spec["lifts"][lift]["stops"]["ground"]
            takes = len(stop) if isinstance(stop[0], list) else 1
            for one in some:
                together = [
                    two for two in some if two[0] < one[1] - NEAR and one[0] < two[1] - NEAR
                ]
                if len(together) > takes or any(two[:2] != one[:2] for two in together):
                    self.fault(lift, "takes", together)

    # -- jobs ------------------------------------------------------------------------------------

    def _job(self, job, name, later):
        mine = {d[0].kind.value: [] for d in self.done}
        for done in self.done:
            if done[0].what == name:
                mine[done[0].kind.value].append(done)
        left = bool(mine.get("leave out"))
        if left:
            self.penalty += job.get("penalty", 0)
            if not job.get("optional"):
                self.fault("left out:", name)
        if "pickup" in job:
            parts = [("pick", _stop(job["pickup"]), 1.0), ("deliver", _stop(job["delivery"]), 1.0)]
            parts = parts[bool(_carrier(job)) :]
        else:
            parts = [("task", job, job["duration"])]
        found, crew = [], job.get("crew", 1)
        for kind, stop, lasts in parts:
            here = mine.get(kind, [])
            if len(here) != (0 if left else crew):
                self.fault(name, kind, len(here), "times; left out:", left)
            for done in here:
                found.append(done)
                self._part(job, name, stop, done, stop.get("service", lasts), later)
        if crew > 1 and found:
            self._crew(job, name, found)
        elif len(found) == 2:
            first, then = found
            if first[0].robot != then[0].robot or first[3] > then[2] + NEAR:
                self.fault(name, "is not delivered by who picked it up, after that")
        if found:
            self.begun[name], self.ended[name] = found[0][2], found[-1][3]

    def _crew(self, job, name, found):
        if len({(low, high) for _, _, low, high in found}) > 1:
            self.fault(name, "is not begun and ended together")
        if len({d[0].robot for d in found}) < len(found):
            self.fault(name, "is done twice by one robot")
        for place in _listed(job["at"]):
            if not any(self._stands(d[0].robot, [place], d[2], d[3]) for d in found):
                self.fault(name, "has nobody at", place)

    def _part(self, job, name, stop, done, lasts, later):
        what, activity, low, high = done
        if low < job.get("release", 0) + later - NEAR:
            self.fault(name, "before its release", low)
        if high - low < lasts - NEAR:
            self.fault(name, "too short", activity)
        if not any(
            low >= begin + later - NEAR and high <= end + later + NEAR
            for begin, end in _windows(stop.get("window", (-math.inf, math.inf)))
        ):
            self.fault(name, "outside its window", activity)
        if stop.get("resources"):
            used = (low, high, name, job.get("kind", ""))
            self.used.setdefault(stop["resources"], set()).add(used)
        if "at" in stop and not self._stands(what.robot, _listed(stop["at"]), low, high):
            self.fault(name, "elsewhere", activity)
        if job.get("robots") and what.robot not in _listed(job["robots"]):
            self.fault(name, "by another robot", what.robot)

    def _used(self, name, resource, some):
        """Told in the order of their starts: who uses a resource when, of which kind."""
        lasts = {(a, b): s for a, row in resource.get("setup", {}).items() for b, s in row.items()}
        for one in some:
            if one[0] < lasts.get((resource.get("kind"), one[3]), 0) - NEAR:
                self.fault(name, "is not set up yet for", one)
            at_once = [two for two in some if two[0] < one[1] - NEAR and one[0] < two[1] - NEAR]
            alike = len({two[:2] + two[3:] for two in at_once}) == 1
            odd = resource.get("batches") and not alike
            if len(at_once) > resource.get("capacity", 1) or odd:
                self.fault(name, "is used at a time by", at_once)
        one_kind = resource.get("batches") or resource.get("capacity", 1) == 1
        for one, two in itertools.combinations(some, 2) if one_kind else ():
            gap = lasts.get((one[3], two[3]), 0)
            if one[:2] != two[:2] and one[1] + gap > two[0] + NEAR:
                self.fault(name, "is not set up in time", one, two)

    def _buffer(self, place, told):
        """Loads are there from when a delivery begins until a pickup ends."""
        changes = []
        for what, _, low, high in self.done:
            if what.kind.value in ("pick", "deliver") and self._stands(
                what.robot, [place], high, high
            ):
                came = what.kind.value == "deliver"
                changes.append((low, 1) if came else (high, -1))
        level = told.get("holds", 0)
        for time, change in sorted(changes):
            level += change
            if not 0 <= level <= told["room"]:
                self.fault(place, "holds", level, "at", time)

    def _sequels(self):
        jobs = {j["id"]: j for j in self.spec["orders"] + self.spec["tasks"]}
        times = {name: j.get("repeat", {}).get("times", 1) for name, j in jobs.items()}
        for name, job in jobs.items():
            before = job.get("after")
            if before is None or times[before] != times[name]:
                continue
            for i in range(times[name]):
                again = f"_{i + 1}" if i else ""
                begun, ended = self.begun.get(name + again), self.ended.get(before + again)
                if begun is not None and (ended is None or begun < ended - NEAR):
                    self.fault(name + again, "is not after", before + again)

    # -- what it costs ---------------------------------------------------------------------------

    def _value(self):
        if self.spec["objective"] == "makespan":
            over = max((d[3] for d in self.done if d[0].kind.value not in _IDLE), default=0.0)
            if self.result.makespan < over - NEAR:
                self.fault("a makespan of", self.result.makespan, "ends at", over)
            return
        costs, told = self.result.costs, self.spec["objective"]
        if isinstance(told, list):
            told = {term: weight for rank in told for term, weight in rank.items()}
        mine = {term: weight * self._term(term) for term, weight in told.items() if term in _KNOWN}
        for term, value in {**mine, "left_out": self.penalty}.items():
            if abs(value - float(costs.get(term, 0))) > NEAR:
                self.fault(term, "costs", value, "and is told to cost", costs)
        bound = (self.result.outcome.metrics or {}).get("value_bound", "-")
        ranked = isinstance(self.spec["objective"], list)
        if (
            not ranked
            and bound not in ("-", None, "")
            and float(Fraction(bound)) > sum(costs.values()) + NEAR
        ):
            self.fault("a bound of", bound, "above the plan's", costs)

    def _term(self, term):
        drives = [d for d in self.done if d[0].kind.value in ("move", "carry")]
        rides = [d for d in self.done if d[0].kind.value == "ride"]
        if term == "makespan":
            return self.plan["makespan"] * self.unit
        if term == "driving":
            return sum(high - low for _, _, low, high in drives)
        if term == "robots":
            return len({d[0].robot for d in drives + rides})
        found = 0.0
        for job, name, later in self.repeated():
            if name not in self.ended:
                continue
            weight = job.get("weight", 1)
            if term == "completion":
                found += weight * self.ended[name]
            elif job.get("due") is not None:
                due = math.floor((job["due"] + later) / self.unit + 1e-9) * self.unit
                found += weight * max(0, self.ended[name] - due)
        return found


_IDLE = ("leave out", "skip")
_KNOWN = ("makespan", "tardiness", "completion", "driving", "robots")
"""The terms that are judged here; others are of ways that robots take when nobody is in them."""


def _seats(lift, floor):
    stop = lift["stops"][floor]
    return stop if isinstance(stop[0], list) else [stop]


def _stop(value):
    return value if isinstance(value, dict) else {"at": value}


def _carrier(job):
    """Return who has a load on board at first."""
    return _stop(job.get("pickup", {})).get("on")


def _charged(charger, battery):
    """Return what a visit to a charger adds, or (of curves and swaps) what it makes of a level."""
    if "swap" in charger:
        return lambda _: battery["capacity"]
    if "curve" not in battery:
        return charger["per_second"] * charger["step"]

    def charge(level):
        left, tops = charger["step"], [*battery["curve"], (battery["capacity"], 0.0)]
        for (top, _), share in zip(tops, [1.0, *(share for _, share in tops)], strict=False):
            rate = charger["per_second"] * share
            took = min(left, max(0.0, top - level) / rate)
            level, left = level + took * rate, left - took
        return level

    return charge


def _windows(value):
    return [value] if isinstance(value[0], int | float) else value


def _listed(value):
    return [value] if isinstance(value, str) else list(value)
