"""Traffic in tight places: groups of robots that have to give way to each other, as plain motions.

Every case is a map and who drives from where to where on it; no tasks, no schedule. A place is
tight when no order of priorities gets everybody through: somebody has to step aside, or all have to
move together. Lengths in m, angles in rad.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from up_samp.geometry import OccupancyGrid, Scene
from up_samp.model import Body, GroupQuery, Kinematics, MotionModel, Rest, TimedMotion

Box = tuple[float, float, float, float]
Pose = tuple[float, float, float]

UP = math.pi / 2
SQUARE = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
TRUCK = ((-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4))
DISC = tuple((0.5 * math.cos(math.pi * k / 8), 0.5 * math.sin(math.pi * k / 8)) for k in range(16))
SMALL = ((-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4))
ELL = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.0), (0.0, 0.0), (0.0, 0.5), (-0.5, 0.5))


@dataclass(frozen=True)
class Traffic:
    """A map and the motions on it, all to be done together."""

    name: str
    grid: OccupancyGrid
    query: GroupQuery


def omni(footprint: Sequence[tuple[float, float]] = SQUARE) -> Body:
    """Return a body that moves in any direction."""
    return Body(tuple(footprint), Kinematics(MotionModel.SE2))


def car(footprint: Sequence[tuple[float, float]] = TRUCK) -> Body:
    """Return a car that turns within 1 m."""
    return Body(tuple(footprint), Kinematics(MotionModel.REEDSSHEPP))


def differential(footprint: Sequence[tuple[float, float]] = TRUCK) -> Body:
    """Return a body with two driven wheels: it turns on the spot."""
    return Body(tuple(footprint), Kinematics(MotionModel.PIVOT))


BODIES: dict[str, Callable[[], Body]] = {
    "omni": omni,
    "car": car,
    "differential": differential,
}


def hall(width: float, height: float, free: Sequence[Box], cell: float = 0.05) -> OccupancyGrid:
    """Return a map that is occupied but for the boxes ``free`` (x low, y low, x high, y high)."""
    occupied = np.ones((round(height / cell), round(width / cell)), dtype=np.bool_)
    for box in free:
        x0, y0, x1, y1 = (round(v / cell) for v in box)
        occupied[y0:y1, x0:x1] = False
    return OccupancyGrid(occupied, cell)


def drives(body: Body, ends: Sequence[tuple[Pose, Pose]], rests: Sequence[Rest] = ()) -> GroupQuery:
    """Return a group in which robot i drives from ``ends[i][0]`` to ``ends[i][1]``, all released
    at 0 and due whenever they like.
    """
    motions = [
        TimedMotion(f"go{i}", f"r{i}", body, (start, goal), 0.0, 1e6)
        for i, (start, goal) in enumerate(ends)
    ]
    return GroupQuery(tuple(motions), tuple(rests))


def pocket(body: Body) -> Traffic:
    """Two swap the ends of a corridor through its side pocket."""
    grid = hall(20, 10, [(0, 4.2, 20, 5.8), (9, 4.2, 11, 7.6)])
    ends = [((2.0, 5.0, 0.0), (16.4, 5.0, 0.0)), ((18.0, 5.0, 0.0), (3.6, 5.0, 0.0))]
    return Traffic("pocket", grid, drives(body, ends))


def door(body: Body, robots: int) -> Traffic:
    """Robots on both sides of a door for one want to get to the other side."""
    grid = hall(20, 12, [(0.5, 0.5, 9.6, 11.5), (10.4, 0.5, 19.5, 11.5), (9.6, 5.2, 10.4, 6.8)])
    ends: list[tuple[Pose, Pose]] = []
    for i in range(robots):
        y = 2.0 + 2.6 * (i // 2) % 9.0
        left, right = (3.0, y, 0.0), (17.0, y, 0.0)
        ends.append((left, (14.0, y, 0.0)) if i % 2 == 0 else (right, (6.0, y, 0.0)))
    return Traffic(f"door-{robots}", grid, drives(body, ends))


def ring(body: Body, robots: int) -> Traffic:
    """Everybody drives to where the next one is, in a ring for one."""
    wide = 1.7
    grid = hall(
        10, 10, [(1, 1, 9, 1 + wide), (1, 9 - wide, 9, 9), (1, 1, 1 + wide, 9), (9 - wide, 1, 9, 9)]
    )
    low, high, mid = 1 + wide / 2, 9 - wide / 2, 5.0
    places: list[Pose] = [(mid, low, 0.0), (high, mid, UP), (mid, high, math.pi), (low, mid, -UP)]
    places = places[:robots]
    ends = [(p, places[(i + 1) % len(places)]) for i, p in enumerate(places)]
    return Traffic(f"ring-{robots}", grid, drives(body, ends))


def full_ring(body: Body, robots: int = 3, speeds: Sequence[float] = ()) -> Traffic:
    """Everybody drives to where the next one is, in a round way with no place left over; with
    ``speeds`` (m/s) of their own.
    """
    radius, wide, cell = (1.0, 1.8, 0.05) if robots < 4 else (0.27 * robots, 1.8, 0.05)
    size = 2 * (radius + wide) + 1.0
    across = (np.arange(round(size / cell)) + 0.5) * cell - size / 2
    away = np.hypot(across[None, :], across[:, None])
    grid = OccupancyGrid((away < radius - wide / 2) | (away > radius + wide / 2), cell)
    places: list[Pose] = []
    for i in range(robots):
        angle = 2 * math.pi * i / robots
        x, y = (size / 2 + radius * f(angle) for f in (math.cos, math.sin))
        places.append((x, y, math.remainder(angle + UP, 2 * math.pi)))
    query = drives(body, [(p, places[(i + 1) % robots]) for i, p in enumerate(places)])
    if speeds:
        motions = [
            replace(m, body=replace(body, kinematics=replace(body.kinematics, v_max=v)))
            for m, v in zip(query.motions, speeds, strict=True)
        ]
        query = GroupQuery(tuple(motions))
    return Traffic(f"full-ring-{robots}", grid, query)


def carousel(body: Body, spacing: float = 1.6) -> Traffic:
    """Four in the corners of a room that holds no more; each drives to the next corner."""
    low, high = 2.0, 2.0 + spacing
    grid = hall(6, 6, [(low - 0.7, low - 0.7, high + 0.7, high + 0.7)])
    corners = [(low, low, 0.0), (high, low, 0.0), (high, high, 0.0), (low, high, 0.0)]
    ends = [(p, corners[(i + 1) % 4]) for i, p in enumerate(corners)]
    return Traffic("carousel", grid, drives(body, ends))


def puzzle(body: Body) -> Traffic:
    """Four in a room with 3 x 3 places; the ones in opposite corners change places."""
    grid = hall(5.2, 5.2, [(0.8, 0.8, 4.4, 4.4)])
    at = [1.4, 2.6, 3.8]
    corners = [(at[0], at[0]), (at[2], at[0]), (at[2], at[2]), (at[0], at[2])]
    ends = [
        ((*corners[i], 0.0), (*corners[(i + 2) % 4], 0.0))  # all at once through the middle
        for i in range(4)
    ]
    return Traffic("puzzle", grid, drives(body, ends))


def full_puzzle(body: Body) -> Traffic:
    """Seven in a room with 3 x 3 places: a sliding puzzle with two free places."""
    grid = hall(5.2, 5.2, [(0.8, 0.8, 4.4, 4.4)])
    at = [1.4, 2.6, 3.8]
    cells = [(x, y) for y in at for x in at]
    goals = [3, 0, 1, 4, 2, 5, 7]
    ends = [((*cells[i], 0.0), (*cells[goal], 0.0)) for i, goal in enumerate(goals)]
    return Traffic("full-puzzle", grid, drives(body, ends))


def square(body: Body, robots: int = 10) -> Traffic:
    """Robots on a circle drive across the square to the other side of it."""
    grid = hall(16, 16, [(0.5, 0.5, 15.5, 15.5)])
    ends: list[tuple[Pose, Pose]] = []
    for i in range(robots):
        angle = 2 * math.pi * i / robots
        c, s = math.cos(angle), math.sin(angle)
        heading = math.remainder(angle + math.pi, 2 * math.pi)
        ends.append(((8 + 6 * c, 8 + 6 * s, heading), (8 - 6 * c, 8 - 6 * s, heading)))
    return Traffic(f"square-{robots}", grid, drives(body, ends))


def lay_by(body: Body) -> Traffic:
    """A fast one is behind a slow one that it can only overtake in a lay-by."""
    grid = hall(40, 8, [(0, 3.2, 40, 4.8), (14, 3.2, 20, 6.4)])
    kin = body.kinematics
    slow = Body(body.footprint, Kinematics(kin.model, kin.turning_radius, 0.2, kin.a_max))
    motions = (
        TimedMotion("slow", "tortoise", slow, ((6.0, 4.0, 0.0), (34.0, 4.0, 0.0)), 0.0, 1e6),
        TimedMotion("fast", "hare", body, ((3.0, 4.0, 0.0), (37.0, 4.0, 0.0)), 0.0, 1e6),
    )
    return Traffic("lay-by", grid, GroupQuery(motions))


def pillars() -> OccupancyGrid:
    """Return a hall of 30 m x 22 m with six pillars of 2 m x 2 m."""
    grid = hall(30, 22, [(0.5, 0.5, 29.5, 21.5)], 0.1)
    occupied = grid.occupied.copy()
    for x in (6, 14, 22):
        for y in (6, 14):
            occupied[10 * y : 10 * y + 20, 10 * x : 10 * x + 20] = True
    return OccupancyGrid(occupied, 0.1)


def aisles() -> OccupancyGrid:
    """Return a store of 30 m x 22 m: shelves with aisles for one robot, and ways for two around."""
    free: list[Box] = [(0.5, 0.5, 29.5, 4.0), (0.5, 9.5, 29.5, 13.0), (0.5, 18.0, 29.5, 21.5)]
    free += [(x, 0.5, x + 1.8, 21.5) for x in (0.5, 5.0, 9.5, 14.0, 18.5, 23.0, 27.7)]
    return hall(30, 22, free, 0.1)


def errands(grid: OccupancyGrid, body: Body, robots: int, seed: int) -> Traffic:
    """Robots at random places, all different, drive to random places, all different."""
    rng = random.Random(seed)
    scene = Scene(grid, 0.05)
    shape = scene.shape(body)
    width, height = grid.size

    def places() -> list[Pose]:
        found: list[Pose] = []
        while len(found) < robots:
            heading = rng.choice((UP, -UP))  # along the aisles
            pose = (rng.uniform(0.0, width), rng.uniform(0.0, height), heading)
            apart = 2.2 * shape.circumscribed
            if scene.clearance(shape, (), pose) > 0.02 and all(
                math.dist(pose[:2], other[:2]) > apart for other in found
            ):
                found.append(pose)
        return found

    ends = list(zip(places(), places(), strict=True))
    return Traffic(f"errands-{robots}-{seed}", grid, drives(body, ends))


def corner() -> Traffic:
    """An L-shaped body slides round a corner of two corridors with 4 cm to spare."""
    grid = hall(8, 8, [(0.5, 0.5, 7.5, 1.54), (6.46, 0.5, 7.5, 7.5)], 0.02)
    ends = [((1.5, 1.02, 0.0), (6.98, 6.5, 0.0))]
    return Traffic("corner", grid, drives(omni(ELL), ends))


@dataclass(frozen=True)
class Case:
    """A tight place, and the bodies for which it makes sense."""

    build: Callable[[Body], Traffic]
    bodies: tuple[str, ...] = ("omni", "car", "differential")


CASES: dict[str, Case] = {
    "pocket": Case(pocket),
    "lay-by": Case(lay_by),
    "ring of three": Case(lambda body: ring(body, 3)),
    "ring of four": Case(lambda body: ring(body, 4)),
    "door both ways": Case(lambda body: door(body, 6)),
    "full ring of three": Case(full_ring),
    "full ring, three speeds": Case(lambda body: full_ring(body, 3, (1.0, 0.5, 0.8))),
    "full ring of six": Case(lambda body: full_ring(body, 6), ("omni", "car")),
    "carousel of four": Case(lambda body: carousel(omni(DISC)), ("omni",)),
    "square of six": Case(lambda body: square(body, 6)),
    "square of ten": Case(square),
    "room of nine, four": Case(puzzle, ("omni",)),
    "room of nine, four small": Case(lambda body: puzzle(differential(SMALL)), ("differential",)),
    "room of nine, seven": Case(full_puzzle, ("omni",)),
    "corner": Case(lambda body: corner(), ("omni",)),
}
