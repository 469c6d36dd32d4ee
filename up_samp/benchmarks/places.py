"""What all families share: floor plans, robots and doors (the paper's figures), and a problem under
construction on one map.

Maps are ROS ``map_server`` files of 0.1 m per pixel; the world frame's origin is the map's
lower-left corner, x points right and y up, lengths are metres. Free cells are white, occupied cells
black. The plans that the paper's instances use lie beside this module in ``data/``; any other one
is drawn on request into the cache folder.
"""

from __future__ import annotations

import math
import random
import tempfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from unified_planning.model import Type
from unified_planning.model.motion import (
    SE2,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import ConfigurationType, MinimizeMakespan

from up_samp.geometry.maps import write_map
from up_samp.model import ProblemError
from up_samp.model.frames import Frame
from up_samp.system.files import cache_folder

RESOLUTION, WALL = 0.1, 0.5
"""Metres per pixel, and thickness of an outer wall (m)."""

DATA = Path(__file__).parent / "data"
"""Folder of the files that are frozen with the package."""

Rectangle = tuple[float, float, float, float]
"""``(x_min, y_min, x_max, y_max)`` in m."""


def draw(size: tuple[float, float], walls: Sequence[Rectangle]) -> npt.NDArray[np.bool_]:
    """Return the occupancy grid of ``walls``: shape (rows, columns), row 0 lowest y."""
    columns, rows = (round(v / RESOLUTION) for v in size)
    occupied = np.zeros((rows, columns), dtype=np.bool_)
    for x0, y0, x1, y1 in walls:
        c0, c1, r0, r1 = (round(v / RESOLUTION) for v in (x0, x1, y0, y1))
        occupied[r0:r1, c0:c1] = True
    return occupied


def drawn_map(name: str, size: tuple[float, float], walls: Sequence[Rectangle]) -> Path:
    """Return the YAML file of a map of that size (m) with ``walls``: the one that is frozen with
    the package under that name, else one that is drawn once per machine.
    """
    frozen = DATA / f"{name}.yaml"
    if frozen.exists():
        return frozen
    told = zlib.crc32(repr((size, *walls)).encode())  # who draws something else reads nothing old
    folder = (cache_folder() or Path(tempfile.gettempdir()) / "up-samp") / "maps"
    cached = folder / f"{name}-{told:08x}.yaml"
    if not cached.exists():
        write_map(folder, cached.stem, draw(size, walls), RESOLUTION)
    return cached


def outer_wall(width: float, height: float) -> list[Rectangle]:
    """Return the four sides of the wall around a map of that size (m)."""
    return [
        (0.0, 0.0, width, WALL),
        (0.0, height - WALL, width, height),
        (0.0, 0.0, WALL, height),
        (width - WALL, 0.0, width, height),
    ]


Pose = tuple[float, float, float]
"""``(x, y, theta)``: m, m, rad, world frame."""

ROBOT_FOOTPRINT = ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))
"""Of the paper's robots, and of all that are not drawn from a seed."""

UP, DOWN = math.pi / 2, -math.pi / 2
"""Headings."""


@dataclass(frozen=True)
class FamilyDoor:
    """A door: its footprint (m, body frame), where it is closed and open, and its button."""

    name: str
    footprint: tuple[tuple[float, float], ...]
    closed: Pose
    open: Pose
    button: Pose


def check_sizes(family: str, most: Mapping[str, int], *sizes: int) -> None:
    """Raise :class:`ProblemError` where there is nothing, or more than ``most``, of something."""
    for (what, limit), n in zip(most.items(), sizes, strict=True):
        if not 1 <= n <= limit:
            raise ProblemError(f"{family} takes 1 to {limit} {what}, not {n}")


def box(length: float, width: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of a ``length`` x ``width`` rectangle around the origin."""
    x, y = length / 2, width / 2
    return ((-x, -y), (x, -y), (x, y), (-x, y))


def drawn_name(name: str, seed: int) -> str:
    """Return what an instance is called that is drawn from a seed; 0: it is as it is published."""
    return f"{name}-s{seed}" if seed else name


def drawing(name: str, seed: int) -> random.Random | None:
    """Return what draws an instance's floor (None: nothing does, it is as it is published)."""
    return random.Random(name) if seed else None


def least_duration(a: Pose, b: Pose, a_max: float) -> int:
    """Return the lower bound, s, that a user who knows no motion would set for a move from a to b:
    rest to rest over the Euclidean distance with a symmetric trapezoidal speed profile of
    acceleration ``a_max`` (m/s^2) and top speed 20 m/s, rounded down, at least 1.
    """
    distance, fastest = math.dist(a[:2], b[:2]), 20.0
    ramp = fastest**2 / a_max
    if distance < ramp:
        seconds = 2 * math.sqrt(distance / a_max)
    else:
        seconds = distance / fastest + fastest / a_max
    return max(1, math.floor(seconds))


def outline(footprint: Sequence[tuple[float, float]], pose: Pose) -> shapely.Polygon:
    """Return the region that a body with ``footprint`` covers at ``pose``, world frame, m."""
    return shapely.Polygon(Frame(*pose).points(footprint))


@dataclass(frozen=True)
class FamilyFloor:
    """Where a problem happens: the name of its map, ``size`` and ``walls`` (m), its doors, and the
    footprint of the robots that drive there (m, body frame).
    """

    name: str
    size: tuple[float, float]
    walls: Sequence[Rectangle]
    doors: Sequence[FamilyDoor] = ()
    footprint: tuple[tuple[float, float], ...] = ROBOT_FOOTPRINT

    @property
    def yaml(self) -> str:
        """The map's YAML file."""
        return str(drawn_map(self.name, self.size, self.walls))

    @cached_property
    def _solid(self) -> shapely.Geometry:
        return shapely.union_all(list(starmap(shapely.box, self.walls)))

    def fault(self, pose: Pose) -> str:
        """Return why no robot can stand at a pose ("": it can): it has to be inside the map, out
        of the walls, and clear of every door, be it open or closed.
        """
        robot = outline(self.footprint, pose)
        if not shapely.box(0, 0, *self.size).contains(robot) or robot.intersects(self._solid):
            return "it is in a wall"
        leaves = ((d, outline(d.footprint, at)) for d in self.doors for at in (d.closed, d.open))
        return next((f"door {d.name} is there" for d, leaf in leaves if robot.intersects(leaf)), "")

    def check(self, poses: dict[str, Pose]) -> None:
        """Check that robots may stand at all ``poses`` at the same time, 0.5 m apart.

        :raises ProblemError: naming the pose that is wrong and what it touches.
        """
        for name, pose in poses.items():
            if fault := self.fault(pose):
                raise ProblemError(f"a robot cannot stand at {name} {pose}: {fault}")
        names, standing = list(poses), [outline(self.footprint, p) for p in poses.values()]
        pairs = shapely.STRtree(standing).query(standing, predicate="dwithin", distance=0.5)
        for i, j in pairs[:, pairs[0] < pairs[1]].T:
            raise ProblemError(f"{names[i]} and {names[j]} are less than 0.5 m apart")

    def spot(
        self,
        rng: random.Random,
        region: Rectangle,
        headings: Sequence[float],
        taken: list[Pose],
        apart: float = 4.0,
    ) -> Pose:
        """Draw a pose in ``region`` where a robot can stand, ``apart`` (m) from those that are
        ``taken``, which it joins.
        """
        for _ in range(10_000):
            x, y = (round(rng.uniform(region[i], region[i + 2]), 2) for i in (0, 1))
            if all(math.dist((x, y), other[:2]) >= apart for other in taken):
                pose = (x, y, rng.choice(headings))
                if not self.fault(pose):
                    taken.append(pose)
                    return pose
        raise ProblemError(f"there is no room for one more robot in {region} of {self.name}")

    def reshaped(self, rng: random.Random | None) -> FamilyFloor:
        """Return the floor for robots of a shape that is drawn, if there is what draws."""
        if rng is None:
            return self
        return replace(
            self, footprint=box(rng.choice((1.2, 1.6, 2.0, 2.4)), rng.choice((0.8, 1.0, 1.2)))
        )


@dataclass(frozen=True)
class Shop:
    """One drawn job shop.

    ``jobs[j]`` is job j's route: (machine, processing time) pairs in order. ``machines[m]`` and
    ``starts[r]`` are poses (x, y, theta; m, rad).
    """

    floor: FamilyFloor
    jobs: tuple[tuple[tuple[int, int], ...], ...]
    machines: tuple[Pose, ...]
    starts: tuple[Pose, ...]


# ------------------ A problem under construction on one map: what every family begins with


class ProblemOnMap:
    """A problem with a map and named places on it; ``metric``: the makespan is minimised."""

    def __init__(self, name: str, map_yaml: str, *, metric: bool) -> None:
        self.problem = SchedulingMotionProblem(name)
        occupancy = OccupancyMap(map_yaml, SE2(0.0, 0.0, 0.0))
        self.pose_type = ConfigurationType("pose", occupancy, ConfigurationKind.SE2)
        self.poses: dict[str, Pose] = {}
        if metric:
            self.problem.add_quality_metric(MinimizeMakespan())

    def place(self, name: str, pose: Pose) -> ConfigurationObject:
        """Add a named configuration at ``pose`` (x, y, theta; m, rad; world frame)."""
        place = ConfigurationObject(name, self.pose_type, SE2(*pose))
        self.problem.add_object(place)
        self.poses[name] = pose
        return place

    def body(
        self,
        name: str,
        kind: Type,
        footprint: Sequence[tuple[float, float]],
        start: ConfigurationObject,
        model: MotionModels = MotionModels.SE2,
        **given: Any,
    ) -> MovableObject:
        """Add an object that moves, at ``start``; ``given``: what else UP's object takes."""
        body = MovableObject(name, kind, footprint=list(footprint), motion_model=model, **given)
        self.problem.add_object(body)
        self.problem.set_initial_configuration(body, start)
        return body
