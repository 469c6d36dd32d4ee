"""Random small SAMP problems as plain values, and the UP problems that they mean.

Two rooms joined by a gap that a door may close, two robots, two to four drives (chains, options,
alternatives), door changes, precedences, releases and deadlines. A unit of time is 5 s, so that
schedules are short enough to be enumerated.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

import numpy as np
import shapely
from PIL import Image
from shapely.affinity import rotate, translate
from unified_planning.environment import get_environment
from unified_planning.model.metrics import MinimizeMakespan
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
from unified_planning.shortcuts import LT, Or

from tests.shuffled import shuffled

SECONDS = 5.0
"""Seconds per unit."""
RESOLUTION = 0.1
BOX = ((-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2))
DOOR = ((-0.1, -0.8), (0.1, -0.8), (0.1, 0.8), (-0.1, 0.8))
CRATE = ((-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3))
PLACES = {
    "a": (1.5, 1.2, 0.0),
    "b": (1.5, 4.8, 0.0),
    "b2": (1.7, 4.9, math.pi / 2),  # overlaps b
    "m": (2.6, 3.0, 0.0),
    "c": (8.5, 1.2, 0.0),
    "d": (8.5, 4.8, math.pi),
    "d2": (8.3, 4.7, 0.0),  # overlaps d
    "e": (7.4, 3.0, math.pi),
    "shut": (5.0, 3.0, 0.0),
    "away": (5.0, 1.2, 0.0),
    "aside": (5.0, 4.8, 0.0),
    "corner": (3.8, 4.8, 0.0),
    "gap": (4.4, 3.0, 0.0),
}
LEFT, RIGHT = ("a", "b", "b2", "m"), ("c", "d", "d2", "e")
PACK = ((-0.15, -0.15), (0.15, -0.15), (0.15, 0.15), (-0.15, 0.15))
AHEAD = 0.5
"""Metres from a robot's middle to that of what it carries."""


def placed(shape, pose):
    """Return a footprint at a pose."""
    turned = rotate(shapely.Polygon(shape), pose[2], origin=(0, 0), use_radians=True)
    return translate(turned, pose[0], pose[1])


def pack_at(place):
    """Return the pose of a pack whose robot is at a place."""
    x, y, turn = PLACES[place]
    return x + AHEAD * math.cos(turn), y + AHEAD * math.sin(turn), turn


@dataclass(frozen=True)
class Drive:
    """A motion activity. ``heeds`` names its obstacles (``None``: everything); those in
    ``static`` have to rest meanwhile.
    """

    name: str
    robot: str
    start: str
    goal: str
    optional: bool = False
    release: int = 0
    deadline: int | None = None
    heeds: tuple[str, ...] | None = None
    static: tuple[str, ...] = ()


@dataclass(frozen=True)
class Change:
    """An activity of one unit that sets the door elsewhere at its end."""

    name: str
    goal: str
    optional: bool = False
    release: int = 0
    deadline: int | None = None


@dataclass(frozen=True)
class World:
    """A problem. ``before``: (x, y), x ends before y starts if both are present; ``either``: one
    of them is present at least. ``carried``: the drives that a pack rides along with, one after the
    other, ahead of its robot; it rests where the first begins until then, and where the last leads.
    """

    seed: int
    car: bool
    robots: tuple[tuple[str, str], ...]
    drives: tuple[Drive, ...]
    changes: tuple[Change, ...] = ()
    door: str | None = None
    crate: str | None = None
    before: tuple[tuple[str, str], ...] = ()
    either: tuple[tuple[str, str], ...] = ()
    carried: tuple[str, ...] = ()

    @property
    def activities(self) -> tuple[Drive | Change, ...]:
        return self.drives + self.changes


def random_world(seed: int) -> World:
    rng = random.Random(seed)
    starts = ["a", "b"] if rng.random() < 0.5 else ["a", "d"]
    robots = tuple((f"r{k}", place) for k, place in enumerate(starts))
    drives: list[Drive] = []
    either: list[tuple[str, str]] = []
    for robot, place in robots:
        _add_chain(rng, robot, place, drives, either)
    door, changes = _door(rng)
    names = [d.name for d in drives]
    before = []
    if rng.random() < 0.35:
        x, y = rng.sample([d for d in drives], 2)
        if x.robot != y.robot:
            before.append((x.name, y.name))
    if changes and rng.random() < 0.2:
        before.append((rng.choice(names), changes[-1].name))
    crate = rng.choice(("corner", "gap")) if rng.random() < 0.2 else None
    drives = [_with_obstacles(rng, d, door, crate) for d in drives]
    car = rng.random() < 0.5
    return World(
        seed, car, robots, tuple(drives), changes, door, crate, tuple(before), tuple(either)
    )


def random_ride(seed: int) -> World | None:
    """Return the world of a seed with a pack that rides along with some drives of one robot; None
    where none of them surely happens, or a robot starts where the pack is.
    """
    world, rng = random_world(seed), random.Random(f"ride {seed}")
    sure = [d for d in world.drives if not d.optional]
    if not sure:
        return None
    first = rng.choice(sure)
    own = [d for d in sure if d.robot == first.robot]
    here = own.index(first)
    carried = own[here : here + rng.choice((1, 2))]
    names = tuple(d.name for d in carried)
    pack = placed(PACK, pack_at(first.start))
    if any(pack.intersection(placed(BOX, PLACES[p])).area > 0.0 for _, p in world.robots):
        return None
    drives = tuple(
        d
        if d.heeds is None or d.name in names or rng.random() < 0.5
        else replace(d, heeds=(*d.heeds, "pack"))
        for d in world.drives
    )
    return replace(world, drives=drives, carried=names)


def _add_chain(rng, robot, place, drives, either):
    steps = rng.choice((1, 1, 1, 2))
    for step in range(steps):
        last = step == steps - 1
        across = rng.random() < 0.5
        side = LEFT if place in LEFT else RIGHT
        other = RIGHT if side is LEFT else LEFT
        goal = rng.choice([p for p in (other if across else side) if p != place])
        first = Drive(f"{robot}_{step}", robot, place, goal, release=rng.choice((0, 0, 0, 1)))
        if last and rng.random() < 0.3:
            second = rng.choice([p for p in PLACES if p in LEFT + RIGHT and p not in (place, goal)])
            one = Drive(first.name, robot, place, goal, True, deadline=rng.choice((None, 5)))
            two = Drive(f"{robot}_{step}x", robot, place, second, True)
            drives += [one, two]
            either.append((one.name, two.name))
        else:
            limit = rng.choice((None, None, None, 4, 6))
            drives.append(Drive(first.name, robot, place, goal, False, first.release, limit))
        place = goal


def _door(rng):
    kind = rng.choice(("none", "none", "open", "open", "twice", "close", "both"))
    late, free = rng.choice((0, 1, 2)), rng.random() < 0.5
    opening = Change("open", "away", free, late)
    if kind == "none":
        return None, ()
    if kind == "open":
        return "shut", (opening,)
    if kind == "twice":
        again = Change("open_more", rng.choice(("away", "aside")), rng.random() < 0.5, late + 1)
        return "shut", (opening, again)
    closing = Change("close", "shut", False, 0, rng.choice((None, 5)))
    if kind == "close":
        return "away", (closing,)
    return "shut", (opening, closing)


def _with_obstacles(rng, drive, door, crate):
    others = tuple(r for r in ("r0", "r1") if r != drive.robot)
    roll = rng.random()
    if roll < 0.75:
        return drive
    values = vars(drive) | {"heeds": others}
    if door is not None and roll < 0.92:
        values |= {"heeds": (*others, "door")}
        if roll < 0.87:
            values |= {"static": ("door",)}
    elif crate is not None:
        values |= {"heeds": (*others, "crate", *(("door",) if door else ()))}
    return Drive(**values)


# -------------------------------------------------------------------------------- UP problems
def write_rooms(folder):
    """Two rooms of 4.8 m x 5.8 m, joined by a gap of 1.6 m around (5, 3)."""
    occupied = np.zeros((60, 100), dtype=bool)
    occupied[:1], occupied[-1:], occupied[:, :1], occupied[:, -1:] = True, True, True, True
    occupied[:22, 49:51] = occupied[38:, 49:51] = True
    Image.fromarray(np.where(occupied[::-1], 0, 255).astype(np.uint8)).save(folder / "rooms.png")
    path = folder / "rooms.yaml"
    path.write_text(
        f"image: rooms.png\nresolution: {RESOLUTION}\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


def build(world, map_file, *, pack=PACK):
    """Return the UP problem of a world; ``pack``: the outline of its pack."""
    env = get_environment()
    types = env.type_manager
    kind = types.ConfigurationType(
        "place", OccupancyMap(str(map_file), (0, 0)), ConfigurationKind.SE2
    )
    problem = SchedulingMotionProblem(f"world{world.seed}", env)
    places = {}
    for name, pose in PLACES.items():
        places[name] = ConfigurationObject(name, kind, SE2(*pose), env)
        problem.add_object(places[name])
    objects = {}
    limits = {"v_max": 1.0, "a_max": 0.5}
    robot = (
        {
            "motion_model": MotionModels.REEDSSHEPP,
            "motion_parameters": limits | {"turning_radius": 0.5},
        }
        if world.car
        else {"motion_model": MotionModels.SE2, "motion_parameters": limits}
    )
    for name, place in world.robots:
        objects[name] = (BOX, place, robot)
    for name, shape, place in (("door", DOOR, world.door), ("crate", CRATE, world.crate)):
        if place is not None:
            objects[name] = (shape, place, {"motion_model": MotionModels.SE2})
    movable = {}
    for name, (shape, place, keywords) in objects.items():
        item = MovableObject(
            name, types.MovableType(f"{name[0]}_type"), footprint=list(shape), env=env, **keywords
        )
        movable[name] = item
        problem.add_object(item)
        problem.set_initial_configuration(item, places[place])
    if world.carried:
        _add_pack(problem, world, kind, movable, places, pack)
    built = {a.name: _activity(problem, a, movable, places) for a in world.activities}
    for drive in world.drives:
        if drive.name in world.carried:
            built[drive.name].add_motion_effect(movable["pack"], places[f"pack_{drive.goal}"])
    for x, y in world.before:
        problem.add_constraint(
            LT(built[x].end, built[y].start),
            [built[n].present for n in (x, y) if built[n].optional],
        )
    for x, y in world.either:
        problem.add_constraint(Or(built[x].present, built[y].present))
    problem.add_quality_metric(MinimizeMakespan())
    return shuffled(problem, world.seed, rename=False).problem


def _add_pack(problem, world, kind, movable, places, outline):
    env = problem.environment
    drives = [d for d in world.drives if d.name in world.carried]
    for place in dict.fromkeys((drives[0].start, *(d.goal for d in drives))):
        name = f"pack_{place}"
        places[name] = ConfigurationObject(name, kind, SE2(*pack_at(place)), env)
        problem.add_object(places[name])
    movable["pack"] = MovableObject(
        "pack",
        env.type_manager.MovableType("p_type"),
        footprint=list(outline),
        motion_model=MotionModels.SE2,
        env=env,
    )
    problem.add_object(movable["pack"])
    problem.set_initial_configuration(movable["pack"], places[f"pack_{drives[0].start}"])


def _activity(problem, a, movable, places):
    item = problem.add_motion_activity(a.name, 1, a.optional)
    if isinstance(a, Change):
        item.add_motion_effect(movable["door"], places[a.goal])
    else:
        item.set_duration_bounds(1, 40)
        lists = {}
        if a.heeds is not None:
            lists["static_obstacles"] = [movable[n] for n in a.heeds if n in a.static]
            lists["dynamic_obstacles_at_start"] = [movable[n] for n in a.heeds if n not in a.static]
        item.add_motion_constraint(
            ActivityWaypoints(movable[a.robot], places[a.start], [places[a.goal]], **lists)
        )
    if a.release:
        item.add_release_date(a.release)
    if a.deadline is not None:
        item.add_deadline(a.deadline)
    return item
