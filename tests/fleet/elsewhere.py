"""The same fleet laid elsewhere: its floors moved and turned in the world, corners of polygons told
from another one on, the other way round, and with more of them on straight sides.
"""

import copy
import math
import random
import re
from pathlib import Path


class Elsewhere:
    """Where things of a fleet are when the origin of the world is in or far from its hall."""

    def __init__(self, seed):
        rng = self.rng = random.Random(f"{seed}, elsewhere")
        self.turn = rng.choice((0.0, math.pi / 2, math.pi, rng.uniform(-math.pi, math.pi)))
        # in the hall, where its bodies pass, near it, or as far away as where maps count from
        far = rng.choice((1.0, 1.0, 40.0, 3e5))
        x, y = far * rng.uniform(0.0, 15.0), far * rng.uniform(0.0, 8.0)
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        self.frame = cos, sin, -cos * x + sin * y, -sin * x - cos * y

    def pose(self, pose):
        """Return a point or a pose."""
        cos, sin, dx, dy = self.frame
        x, y, *heading = pose
        return [cos * x - sin * y + dx, sin * x + cos * y + dy, *(h + self.turn for h in heading)]

    def polygon(self, corners):
        """Return the corners of a polygon, told in another way."""
        rng, found = self.rng, []
        for (x, y), (u, v) in zip(corners, [*corners[1:], corners[0]], strict=True):
            found.append((x, y))
            if rng.random() < 0.3:
                share = rng.uniform(0.2, 0.8)
                found.append((x + share * (u - x), y + share * (v - y)))
        first = rng.randrange(len(found))
        found = found[first:] + found[:first]
        return [self.pose(c) for c in (found if rng.random() < 0.5 else found[::-1])]

    def map(self, file):
        """Return a copy of a map's file, with its origin where it is now."""
        text = Path(file).read_text()
        origin = ", ".join(map(repr, self.pose((0.0, 0.0, 0.0))))
        text, told = re.subn(r"origin: \[[^\]]*\]", f"origin: [{origin}]", text)
        assert told == 1
        there = Path(file).with_name(f"elsewhere-{Path(file).name}")
        there.write_text(text)
        return str(there)

    def spec(self, spec):
        """Return the fleet."""
        spec = copy.deepcopy(spec)
        spec["map"] = self.map(spec["map"])
        spec["floors"] = {n: (self.map(file), z) for n, (file, z) in spec["floors"].items()}
        for place in spec["places"].values():
            place["pose"] = self.pose(place["pose"])
        for robot in spec["robots"].values():
            if not isinstance(robot["start"], str):
                robot["start"] = self.pose(robot["start"])
        for door in spec["doors"].values():
            door |= {key: self.pose(door[key]) for key in ("closed", "open")}
        for lift in spec["lifts"].values():
            lift["stops"] = {
                floor: list(map(self.pose, stop)) if isinstance(stop[0], list) else self.pose(stop)
                for floor, stop in lift["stops"].items()
            }
        for area in (*spec["zones"].values(), *spec.get("automatic_doors", {}).values()):
            area["polygon"] = self.polygon(area["polygon"])
            if "one_way" in area:
                area["one_way"] += self.turn
        return spec
