"""Rules of driving that a fleet's plan keeps, read off its samples by shapes alone: doors that open
by themselves, airlocks, zones, and robots that do not back up.
"""

import itertools
import json
import math

import numpy as np
from shapely import affinity
from shapely.geometry import Point, Polygon

from tests.fleet.shapes import outline
from up_samp.execution import Delays, dependencies_of, simulate
from up_samp.execution.judge import broken_rules

SHARE, NEAR = 1.01, 1e-3


def hurried(fleet, plan, seeds, share):
    """Drive a plan late, by the rules; return what the judge of what was driven says of the last
    run if all its motions take that share of their time.
    """
    dependencies = dependencies_of(fleet.problem, plan)
    for seed in range(seeds):
        run = simulate(dependencies, plan, Delays(slow=0.7, stops=2), seed)
        assert run.finished
        assert not run.contacts
        assert not run.broken, run.broken
    record = json.loads(json.dumps(run.record))
    for motion in record["motions"]:
        begin = motion["samples"][0][0]
        for row in motion["samples"]:
            row[0] = begin + share * (row[0] - begin)
    return broken_rules(dependencies, record)[0]


def check(spec, plan, fault):
    """Tell ``fault`` what motions do against the rules of their robots' type, zones and doors."""
    kind = spec["types"]["agv"]
    body = outline(kind["footprint"])
    maps = plan.get("maps") or [plan["map"]]
    passed = []
    for motion in plan["motions"]:
        upstairs = maps[motion.get("map", 0)].get("height")
        floor = "first" if spec["floors"] and upstairs else "ground"
        rows = np.array(motion["samples"])
        steps = [*_steps(rows)]
        _backing(kind, motion, steps, fault)
        _turning(kind, motion, steps, fault)
        zones = [z for z in spec["zones"].values() if z.get("floor", "ground") == floor]
        for zone in zones:
            _zone(zone, kind, body, motion, steps, fault)
        for name, door in spec.get("automatic_doors", {}).items():
            if door.get("floor", "ground") == floor:
                times = [t for t, pose in _dense(rows) if _touches(body, pose, door["polygon"])]
                if times:
                    passed.append((min(times), max(times), name, motion["object"]))
    _doors(spec, passed, fault)


def _steps(rows):
    """Yield (time, pose in the middle, m driven ahead, m driven, rad turned, s) of each step."""
    for one, two in itertools.pairwise(rows):
        lasts = two[0] - one[0]
        if lasts <= 0:
            continue
        middle = (one[1:4] + two[1:4]) / 2
        dx, dy = two[1:3] - one[1:3]
        ahead = dx * math.cos(middle[2]) + dy * math.sin(middle[2])
        yield one[0], middle, ahead, (dx, dy), two[3] - one[3], lasts


def _dense(rows):
    """Yield times and poses between rows, no more than 5 cm or 0.1 rad apart."""
    for one, two in itertools.pairwise(rows):
        far = max(math.dist(one[1:3], two[1:3]) / 0.05, abs(two[3] - one[3]) / 0.1)
        for share in np.linspace(0, 1, 2 + int(far)):
            time, *pose = one + share * (two - one)
            yield time, pose


def _touches(body, pose, polygon):
    turned = affinity.rotate(body, pose[2], origin=(0, 0), use_radians=True)
    shape = affinity.translate(turned, pose[0], pose[1])
    return shape.intersection(Polygon(polygon)).area > NEAR


def _backing(kind, motion, steps, fault):
    way = kind.get("reverse", "free")
    most = {"free": math.inf, "never": NEAR, "slow": kind.get("reverse_v_max", 0) * SHARE}[way]
    for time, _, ahead, _, _, lasts in steps:
        if -ahead > most * lasts + 1e-6:
            fault(motion["object"], "drives backwards at", time, -ahead / lasts, "m/s")
            return


def _turning(kind, motion, steps, fault):
    for time, pose, _, way, turned, _ in steps:
        if kind.get("pivoting") == "never" and abs(turned) > 0.02 and math.hypot(*way) < 1e-6:
            fault(motion["object"], "turns on the spot at", time, pose)
            return


def _zone(zone, kind, body, motion, steps, fault):
    """A step whose middle is in a zone keeps to its rules: but for the last 2 cm at its edges."""
    shrunk = Polygon(zone["polygon"]).buffer(-0.02)
    ends = [row[1:4] for row in (motion["samples"][0], motion["samples"][-1])]
    if zone.get("stopping") == "never" and any(
        _touches(body, p, shrunk.exterior.coords) for p in ends
    ):
        fault(motion["object"], "rests in a zone", ends)
    for time, pose, _, (dx, dy), turned, lasts in steps:
        moved = math.hypot(dx, dy)
        inside = _touches(body, pose, shrunk.exterior.coords)
        if "v_max" in zone and inside and moved > zone["v_max"] * SHARE * lasts + NEAR:
            fault(motion["object"], "drives too fast in a zone", time, moved / lasts)
            return
        pivots = abs(turned) > 0.02 and moved < 1e-6
        if zone.get("pivoting") == "never" and inside and pivots:
            fault(motion["object"], "turns on the spot in a zone", time, pose)
            return
        stands = moved < 1e-6 and abs(turned) < 1e-6 and lasts > 0.01
        if zone.get("stopping") == "never" and inside and stands:
            fault(motion["object"], "stands in a zone", time, pose)
            return
        if "one_way" in zone and shrunk.contains(Point(pose[:2])):
            along = dx * math.cos(zone["one_way"]) + dy * math.sin(zone["one_way"])
            if along < -NEAR:
                fault(motion["object"], "drives against the way of a zone", time, pose)
                return


def _doors(spec, passed, fault):
    doors = spec.get("automatic_doors", {})
    for since, until, name, robot in passed:
        for shut in doors[name].get("shut", ()):
            if since < shut[1] - NEAR and until > shut[0] + NEAR:
                fault(robot, "is in", name, since, until, "which is shut", shut)
    for one, two in itertools.combinations(sorted(passed), 2):
        lock = doors[one[2]].get("airlock")
        same = lock is not None and doors[two[2]].get("airlock") == lock
        if same and one[2:] != two[2:] and one[1] > two[0] + NEAR:
            fault("two doors of an airlock at a time", one, two)
