"""Random small fleets as ``buildings`` draws them, with what sites asked for since: doors that open
by themselves, airlocks, rules of driving by zone, cars, robots that do not back up or slowly, lifts
for several robots, swapped batteries and charging curves, crews, several windows, resources,
set-ups, batches, buffers of limited room, objectives in an order, and loads on board at first.
"""

import copy
import random

from tests.fleet import buildings

MORE_TERMS = ("distance", "energy", "cost", "busiest")
RULES = ("v_max", "one_way", "pivoting", "stopping")
DOORWAY = [[6.3, 2.6], [7.5, 2.6], [7.5, 5.6], [6.3, 5.6]]
CURTAIN = [[9.95, 0.1], [10.5, 0.1], [10.5, 7.9], [9.95, 7.9]]


def strip(x, half=0.45):
    """The corners of a strip across the hall."""
    return [[x - half, 0.1], [x + half, 0.1], [x + half, 7.9], [x - half, 7.9]]


class Modern(buildings.Building):
    """One fleet of ``buildings``, and then more words of it by a draw of its own."""

    def __init__(self, seed, folder):
        super().__init__(seed, folder)
        self.rng = random.Random(f"{seed}, and more")
        self.spec |= {"automatic_doors": {}, "resources": {}}
        for part in ("robots", "doors", "zones", "lifts", "batteries", "crew", "jobs", "objective"):
            getattr(self, f"_more_{part}")()
        self.rng = random.Random(f"{seed}, and of late")
        for part in ("setups", "batches", "buffers", "turns", "stops"):
            getattr(self, f"_more_{part}")()
        self.rng = random.Random(f"{seed}, and aboard")
        self._more_aboard()
        self.rng = random.Random(f"{seed}, and ahead")
        self._more_backwards()

    def _chance(self, share):
        return self.rng.random() < share

    def _more_robots(self):
        r, kind = self.rng, self.spec["types"]["agv"]
        if self._chance(0.25):
            kind |= {"model": "car", "turning_radius": r.choice([0.5, 0.8])}
        if kind["model"] != "omni" and self._chance(0.6):
            kind["reverse"] = r.choice(["never", "slow"])
            if kind["reverse"] == "slow":
                kind["reverse_v_max"] = r.choice([0.3, 0.5])
        if self._chance(0.3):
            kind["costs"] = {
                "used": r.choice([0, 5]),
                "per_km": 100.0,
                "per_hour": r.choice([0, 60]),
            }

    def _more_backwards(self):
        kind = self.spec["types"]["agv"]
        if kind["model"] != "omni" and kind.get("reverse") != "never" and self._chance(0.7):
            kind["reverse_cost"] = self.rng.choice([1, 1, 4])

    def _more_doors(self):
        r, doors = self.rng, {}
        if self.wall and not self.spec["doors"] and self._chance(0.6):
            doors["hatch"] = {"polygon": DOORWAY}
        if self._chance(0.35):
            doors["curtain"] = {"polygon": CURTAIN, "floor": self._floor()}
        locked = len(doors) == 2 and self._chance(0.7)
        for door in doors.values():
            door["opens_in"] = r.choice([0, 3, 7.5])
            if locked:
                door |= {"airlock": "lock", "closes_in": r.choice([0, 2])}
            if self._chance(0.4):
                since = r.choice([0, 5, 12.5])
                door["shut"] = [[since, since + r.choice([6, 20])]]
                if self._chance(0.3):
                    door["shut"].append([since + 30, since + 35])
        self.spec["automatic_doors"] = doors

    def _more_zones(self):
        r, zones = self.rng, self.spec["zones"]
        if self._chance(0.35):
            shape = {"polygon": strip(r.choice([3.3, 10.2]), 0.6), "floor": self._floor()}
            zones["slowly"] = {**shape, "v_max": r.choice([0.4, 0.7])}
        if self._chance(0.2):
            half = [[7.9, 0.1], [8.5, 0.1], [8.5, 3.9], [7.9, 3.9]]
            zones["lane"] = {
                "polygon": half,
                "one_way": r.choice([0.0, 3.14159265]),
                "floor": self._floor(),
            }
        if self.spec["types"]["agv"]["model"] == "diff" and self._chance(0.25):
            shape = {"polygon": strip(r.choice([3.3, 10.2])), "floor": self._floor()}
            zones["shelves"] = {**shape, "pivoting": "never"}

    def _more_lifts(self):
        for lift in self.spec["lifts"].values():
            if self._chance(0.5):
                lift["per_floor"] = self.rng.choice([2, 5.5])
            if self._chance(0.4):
                x, y, turned = lift["stops"]["ground"]
                cabin = [[x, y, turned], [x, y + 1.0, turned]]
                lift["stops"] = dict.fromkeys(("ground", "first"), cabin)

    def _more_batteries(self):
        battery, r = self.spec["types"]["agv"].get("battery"), self.rng
        if battery is None:
            return
        if self._chance(0.4):
            battery["curve"] = [[r.choice([0.3, 0.5]) * battery["capacity"], 0.5]]
        plug = self.spec["places"].get("plug")
        if plug is not None and self._chance(0.4):
            plug["charger"] = {"swap": r.choice([8, 15.5])}

    def _more_crew(self):
        r, spots = self.rng, [name for name in self.spec["places"] if name.startswith("p")]
        if len(self.spec["robots"]) > 1 and self._chance(0.4):
            at = r.sample([s for s in spots if s != "plug"], 2)
            task = {"id": "together", "at": at, "duration": r.choice([2, 4.5]), "crew": 2}
            if self._chance(0.4):
                task |= {"optional": True, "penalty": r.choice([10, 100])}
            self.spec["tasks"].append(task)

    def _more_jobs(self):
        r = self.rng
        if self._chance(0.3):
            self.spec["resources"]["clerk"] = {"capacity": 1}
        for job in self.spec["orders"] + self.spec["tasks"]:
            if self.spec["resources"] and self._chance(0.6):
                told = job if "at" in job else _as_stop(job, "delivery")
                told["resources"] = "clerk"
            if self._chance(0.2):
                told = job if "at" in job else _as_stop(job, "delivery")
                first = r.choice([10, 25])
                told["window"] = [[0, first], [first + 12, first + r.choice([40, 200])]]

    def _more_objective(self):
        r, told = self.rng, self.spec["objective"]
        if self._chance(0.3):
            more = {term: r.choice([1, 0.5]) for term in r.sample(MORE_TERMS, r.randint(1, 2))}
            kind = self.spec["types"]["agv"]
            more = {
                t: w
                for t, w in more.items()
                if (t != "energy" or "battery" in kind) and (t != "cost" or "costs" in kind)
            }
            if more:
                self.spec["objective"] = more if told == "makespan" else told | more
        told = self.spec["objective"]
        if told != "makespan" and len(told) > 1 and self._chance(0.4):
            self.spec["objective"] = [{term: weight} for term, weight in told.items()]

    def _more_setups(self):
        r, clerk = self.rng, self.spec["resources"].get("clerk")
        if clerk is None or not self._chance(0.6):
            return
        clerk["setup"] = {"red": {"blue": r.choice([2, 7.5])}, "blue": {"red": r.choice([0, 4])}}
        if self._chance(0.5):
            clerk["kind"] = "red"
        for job in self.spec["orders"] + self.spec["tasks"]:
            job["kind"] = r.choice(["red", "blue"])

    def _more_batches(self):
        r, lasts = self.rng, {"red": self.rng.choice([4, 9.5]), "blue": 6}
        if not self._chance(0.3):
            return
        self.spec["resources"]["oven"] = {"capacity": 2, "batches": True}
        if self._chance(0.5):
            self.spec["resources"]["oven"]["setup"] = {"red": {"blue": 5}, "blue": {"red": 3.5}}
        for k in range(r.choice([2, 3])):
            kind = r.choice(["red", "blue"])
            task = {"id": f"b{k}", "duration": lasts[kind], "resources": "oven", "kind": kind}
            if self.spec["orders"] and self._chance(0.4):
                task["after"] = self.spec["orders"][0]["id"]
                if "repeat" in self.spec["orders"][0]:
                    del task["after"]
            self.spec["tasks"].append(task)

    def _more_buffers(self):
        stops = [_at(o[part]) for o in self.spec["orders"] for part in ("pickup", "delivery")]
        listed = {place for stop in stops if len(stop) > 1 for place in stop}
        for name, place in self.spec["places"].items():
            if name.startswith("p") and name not in listed and self._chance(0.3):
                there = sum(
                    o.get("repeat", {}).get("times", 1)
                    for o in self.spec["orders"]
                    if _at(o["pickup"]) == [name]
                )
                holds = self.rng.randint(0, there)
                place |= {"room": max(1, holds + self.rng.choice([0, 1])), "holds": holds}

    def _more_aboard(self):
        kind = self.spec["types"]["agv"]
        most = 1 if kind["unloading"] == "lifo" else kind["capacity"]["item"]
        room = dict.fromkeys(self.spec["robots"], most)
        said = ("attached", "together", "optional", "repeat", "robots")
        for order in self.spec["orders"]:
            robots = [name for name, left in room.items() if left and self._may(name, order)]
            if robots and not any(order.get(k) for k in said) and self._chance(0.3):
                order["pickup"] = {"on": self.rng.choice(robots)}
                room[order["pickup"]["on"]] -= 1

    def _may(self, robot, order):
        return set(order.get("skills", ())) <= set(self.spec["robots"][robot].get("skills", ()))

    def _more_turns(self):
        kind = self.spec["types"]["agv"]
        if kind["model"] == "diff" and self._chance(0.3):
            kind["pivoting"] = "never"

    def _more_stops(self):
        if self._chance(0.35):
            x, floor = self.rng.choice([3.3, 7.9, 10.25]), self._floor()
            self.spec["zones"]["through"] = {
                "polygon": strip(x, 0.3), "stopping": "never", "floor": floor,
            }  # fmt: skip
        if self._chance(0.2):
            half = [[8.6, 0.1], [9.1, 0.1], [9.1, 5.0], [8.6, 5.0]]
            avoid = self.rng.choice([0.5, 20])
            self.spec["zones"]["offices"] = {"polygon": half, "avoid": avoid}


def _at(stop):
    at = stop.get("at", []) if isinstance(stop, dict) else stop
    return [at] if isinstance(at, str) else at


def _as_stop(job, part):
    if not isinstance(job[part], dict):
        job[part] = {"at": job[part]}
    return job[part]


def _by_ways(objective):
    """Whether metres of ways count: the quickest way under fewer rules may be a longer one."""
    terms = objective if isinstance(objective, dict) else [t for r in objective for t in r]
    return objective != "makespan" and not {"distance", "energy", "cost"}.isdisjoint(terms)


def looser(spec, seed):
    """Return a fleet that is asked for less, and what it is not asked any more."""
    spec = copy.deepcopy(spec)
    kind, r = spec["types"]["agv"], random.Random(f"{seed}, less")
    asked = [
        (d, k) for d in spec["automatic_doors"].values() for k in ("shut", "airlock") if d.get(k)
    ]
    asked += [(lift, "per_floor") for lift in spec["lifts"].values() if "per_floor" in lift]
    if not _by_ways(spec["objective"]):
        for zone in spec["zones"].values():
            asked += [(zone, k) for k in RULES if k in zone]
        asked += [(kind, "reverse")] if kind.get("reverse", "free") != "free" else []
        asked += [(kind, "pivoting")] if "pivoting" in kind else []
    asked += [(r, k) for r in spec["resources"].values() for k in ("setup", "batches") if k in r]
    asked += [(place, "room") for place in spec["places"].values() if "room" in place]
    asked += [(kind["battery"], "curve")] if "curve" in kind.get("battery", {}) else []
    for job in spec["orders"] + spec["tasks"]:
        stops = [job, *(job[k] for k in ("pickup", "delivery") if isinstance(job.get(k), dict))]
        asked += [(stop, k) for stop in stops for k in ("resources", "window") if k in stop]
    if not asked or r.random() < 0.2:
        return buildings.looser(spec, seed)
    told, what = r.choice(asked)
    if what in RULES and told is not kind:
        spec["zones"] = {name: zone for name, zone in spec["zones"].items() if zone is not told}
    elif what == "reverse":
        kind.pop("reverse_v_max", None)
        kind["reverse"] = "free"
    elif what == "airlock":
        for door in spec["automatic_doors"].values():
            door.pop("airlock", None)
            door.pop("closes_in", None)
    elif what in ("setup", "room"):
        del told[what]
        told.pop("kind" if what == "setup" else "holds", None)
    else:
        del told[what]
    return spec, what
