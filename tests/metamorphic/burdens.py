"""Random small fleets and what burdens them: a door, a zone, windows, batteries, loads with a
footprint, more work, ... Who can carry out a plan under some burdens can do so under fewer.
"""

import copy
import math
import random

import yaml
from shapely.geometry import Point, box

from up_samp import Fleet
from up_samp.fleet.importers import map_from_polygons

WIDE, HIGH = 14.0, 9.0


class Burdened:
    """The fleet of a seed, and its ``burdens``: functions that change what its file holds."""

    def __init__(self, seed, folder):
        self.seed, self.folder = seed, folder
        self.rng = rng = random.Random(f"burdens {seed}")
        hall, half = box(0, 0, WIDE, HIGH), rng.choice([0.5, 0.8, 1.4, 3.0])
        self.gap = x, y = WIDE / 2, rng.uniform(3.5, 5.5)
        deep = rng.choice([0.1, 1.5])
        wall = box(x - deep, 0, x + deep, HIGH)
        self.hall = hall.difference(wall.difference(box(0, y - half, WIDE, y + half)))
        map_from_polygons(self.hall, folder, cell=0.1)
        self.doorway = [[x - deep, y - half], [x + deep, y - half]]
        self.doorway += [[x + deep, y + half], [x - deep, y + half]]
        self.leaf = {"leaf": [0.2, 2 * half - 0.1], "closed": [x, y, 0.0]}
        self.leaf["open"] = [x, y + (2 * half + 0.3) * rng.choice([-1, 1]), 0.0]
        self.robots = [f"r{k}" for k in range(rng.choice([1, 2, 2, 3]))]
        self.spots = [f"p{k}" for k in range(4)]
        self.spec = self._spec(deep)
        self.jobs = [job["id"] for kind in ("orders", "tasks") for job in self.spec[kind]]
        self.burdens = [
            getattr(self, name)() for name in rng.sample(BURDENS, rng.choice([1, 3, 5]))
        ]

    def _spec(self, deep):
        rng, poses = self.rng, []
        while len(poses) < len(self.robots) + len(self.spots):
            x, y = rng.uniform(0.9, WIDE - 0.9), rng.uniform(0.9, HIGH - 0.9)
            near = any(math.dist((x, y), pose[:2]) < 1.5 for pose in poses)
            if abs(x - self.gap[0]) > deep + 1.6 and not near:
                assert self.hall.contains(Point(x, y))
                poses.append([x, y, rng.uniform(-3.0, 3.0)])
        homes = [f"home_{name}" for name in self.robots]
        limits = {"v_max": rng.choice([0.7, 1.5]), "a_max": rng.choice([0.4, 1.0])}
        model = rng.choice([{"model": "omni"}, {"model": "diff"}, {"turning_radius": 0.5}])
        kind = {"footprint": [0.8, 0.5], "capacity": {"item": 2}, **limits, **model}
        orders = []
        for k in range(rng.choice([1, 2])):
            pickup, delivery = rng.sample(self.spots, 2)
            orders.append({"id": f"o{k}", "pickup": {"at": pickup}, "delivery": {"at": delivery}})
        return {
            "format": "up-samp-problem", "version": 1, "map": "map.yaml",
            "seconds_per_unit": rng.choice([2, 5]), "robot_types": {"kind": kind},
            "robots": {r: {"type": "kind", "start": f"home_{r}"} for r in self.robots},
            "places": dict(zip([*homes, *self.spots], poses, strict=True)),
            "orders": orders, "tasks": [{"id": "look", "at": self.spots, "duration": 5}],
            "resources": {"tool": {}},
        }  # fmt: skip

    def fleet(self, burdens):
        """Return the fleet under some burdens, its lists in any order."""
        spec, rng = copy.deepcopy(self.spec), random.Random(f"{self.seed} {len(burdens)}")
        for burden in burdens:
            burden(spec)
        for kind in ("orders", "tasks"):
            rng.shuffle(spec[kind])
        for kind in ("robots", "places"):
            spec[kind] = dict(rng.sample(sorted(spec[kind].items()), len(spec[kind])))
        path = self.folder / f"under_{len(burdens)}.yaml"
        path.write_text(yaml.safe_dump(spec, sort_keys=False))
        return Fleet.from_file(path)

    # ------------------ Burdens

    def _job(self, **said):
        """Say more of some job, in whichever of its ends it belongs to."""
        name, end = self.rng.choice(self.jobs), self.rng.choice(["pickup", "delivery"])

        def burden(spec):
            job = next(j for kind in ("orders", "tasks") for j in spec[kind] if j["id"] == name)
            at_end = "pickup" in job and said.keys() & {"window", "resources"}
            (job[end] if at_end else job).update(copy.deepcopy(said))

        return burden

    def _kind(self, **said):
        return lambda spec: spec["robot_types"]["kind"].update(copy.deepcopy(said))

    def _named(self, kind, **said):
        return lambda spec: spec.update({kind: {f"the_{kind}": copy.deepcopy(said)}})

    def door(self):
        buttons = self.rng.sample(self.spots, 2)
        return self._named("doors", **self.leaf, opened_from=buttons, seconds=2)

    def curtain(self):
        return self._named("automatic_doors", polygon=self.doorway, opens_in=3)

    def zone(self):
        rule = self.rng.choice([{"max_robots": 1}, {"v_max": 0.3}, {"pivoting": "never"}])
        return self._named("zones", polygon=self.doorway, **rule)

    def release(self):
        return self._job(release=self.rng.choice([5, 20]))

    def window(self):
        return self._job(window=[self.rng.choice([0, 10]), self.rng.choice([30, 60])])

    def tool(self):
        return self._job(resources="tool")

    def by(self):
        return self._job(robots=self.rng.choice(self.robots))

    def battery(self):
        capacity = self.rng.choice([12, 25, 60])
        return self._kind(battery={"capacity": capacity, "per_metre": 1})

    def ahead(self):
        slow = self._kind(v_max=0.5)
        return slow if "model" in self.spec["robot_types"]["kind"] else self._kind(reverse="never")

    def home(self):
        robot = self.rng.choice(self.robots)
        return lambda spec: spec["robots"][robot].update(end=f"home_{robot}")

    def rest(self):
        robot, span = self.rng.choice(self.robots), {"duration": 8, "window": [0, 40]}
        return lambda spec: spec["robots"][robot].update(breaks=[span])

    def pallet(self):
        load = {"footprint": self.rng.choice([[0.5, 0.5], [1.0, 0.6], [0.6, 1.0]])}
        return lambda spec: spec["orders"][0].update(attached=load)

    def more(self):
        task = {"id": "more", "at": self.rng.choice(self.spots), "duration": 3}
        return lambda spec: spec["tasks"].append(task)


BURDENS = (
    "door", "curtain", "zone", "release", "window", "tool", "by", "battery", "ahead", "home",
    "rest", "pallet", "more",
)  # fmt: skip
