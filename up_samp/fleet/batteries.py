"""Batteries as numeric fluents: what drives take, and what chargers give, step by step.

What a drive takes is known before any schedule: that of the way which the robot takes when nobody
is in it. Levels are whole numbers above the reserve: what is taken is rounded up, what is
given down.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from up_samp.fleet.floors import FloorMaps, floor_of, way_between
from up_samp.fleet.loads import load_of, ridden, with_load
from up_samp.fleet.meanings import Kind, Written
from up_samp.fleet.outlines import kept_out, ruled
from up_samp.fleet.records import Battery, Charger, FleetRecords
from up_samp.io.sampling import rows_trajectory
from up_samp.model import Body, Configuration, Deadline, PathQuery, Placed, Trajectory
from up_samp.motion import MotionService
from up_samp.motion.curves.slowing import chooses, reverses_at_a_cost, seconds_of
from up_samp.motion.fleet.workspace import workspace_of
from up_samp.upio.expressions import effects_of

MOST_STEPS, WAY_SECONDS, PATIENCE = 60, 10.0, 60.0
"""Steps of a charger's activity, at most; time for one drive whose way is asked for, and for all of
those for which none is found: the others then get a tenth each (s).
"""


class Meter:
    """How long the drives of a fleet are, and what they take from its robots' batteries."""

    def __init__(self, records: FleetRecords, folder: Path) -> None:
        self._records = records
        self._floors = FloorMaps(records, folder)
        self._ways = cache(self._way)
        self._in_vain = 0.0

    def drive(self, robot: str, origin: str, to: str) -> int:
        """Return what a drive takes, in grains (0 for robots without batteries)."""
        kind = self._records.robots[robot].type
        battery = self._records.robot_types[kind].battery
        if battery is None:
            return 0
        metres, seconds = self.length(robot, origin, to)
        needed = battery.per_metre * metres + battery.per_second * seconds
        return math.ceil(grains(battery, needed) - 1e-9)

    def length(self, robot: str, origin: str, to: str) -> tuple[float, float]:
        """Return a drive's metres and seconds; where no way was found, what no way has less of, so
        that nothing is ruled out that can be driven.
        """
        kind = self._records.robots[robot].type
        way = self._ways(kind, origin, to)
        if way is not None:
            return metres_of(way), way.duration
        poses = way_between(self._records, origin, to)
        least = sum(math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(poses))
        return least, least / self._records.robot_types[kind].v_max

    def clears(self, robot: str, origin: str, to: str, areas: Iterable[Placed]) -> bool:
        """Return whether the way that a drive takes keeps clear of all ``areas``; not where no way
        was found.
        """
        kind = self._records.robots[robot].type
        way = self._ways(kind, origin, to)
        legs, body = self._floors.at(origin).legs, self._body(kind, origin, to)
        return way is not None and all(legs.clears(way, body, area) for area in areas)

    def _way(self, kind: str, origin: str, to: str) -> Trajectory | None:
        """Return how a robot drives when nobody is in its way.

        Where no zone or lane makes it choose between ways, a quick search will do: a fifth of the
        work for a way that is hardly ever longer.
        """
        zones = kept_out(self._records, kind, floor_of(self._records, origin))
        poses = way_between(self._records, origin, to)
        service, body = self._floors.at(origin), self._body(kind, origin, to)
        share = 1.0 if self._in_vain < PATIENCE else 0.1
        deadline = Deadline.after(share * WAY_SECONDS)
        quick = None if chooses(body) else quick_way(service, body, poses, zones, deadline)
        battery = self._records.robot_types[kind].battery
        if quick is not None and (
            battery is None or grains(battery, taken(battery, quick)) <= usable(battery)
        ):
            return quick  # of one that takes more than a battery holds there may be a shorter one
        way = service.plan(PathQuery(body, poses, zones), deadline).trajectory
        self._in_vain += deadline.elapsed() if way is None else 0.0
        return way

    def _body(self, kind: str, origin: str, to: str) -> Body:
        """Return a robot with the load that rides with it."""
        order = ridden(self._records, origin, to)
        load = None if order is None else load_of(self._records, order)
        body = with_load(self._records.robot_types[kind], load)
        return ruled(self._records, kind, floor_of(self._records, origin), body)


def quick_way(
    service: MotionService,
    body: Body,
    poses: tuple[Configuration, ...],
    zones: Sequence[Placed],
    deadline: Deadline,
) -> Trajectory | None:
    """Return a way that is found with little work: where it leads backwards, and the body would
    rather not, the better one of it and one ahead only (None: one of them is not found so soon).
    """
    workspace = workspace_of(service)
    found = workspace.detour(body, poses, zones, (), deadline)
    if found is None:
        return None
    if not reverses_at_a_cost(found.natural, body):
        return found.natural
    ahead = replace(body, kinematics=replace(body.kinematics, reverse=False))
    other = workspace.detour(ahead, poses, zones, (), deadline)
    if other is None:
        return None
    return min(found.natural, other.natural, key=lambda way: seconds_of(way, body))


def metres_of(way: Trajectory) -> float:
    """Return how long a drive's way is (m)."""
    return float(np.hypot(*np.diff(way.poses[:, :2], axis=0).T).sum())


def taken(battery: Battery, way: Trajectory) -> float:
    """Return what a drive takes, in the user's units."""
    return battery.per_metre * metres_of(way) + battery.per_second * way.duration


def grains(battery: Battery, amount: float) -> float:
    """Return an amount in the whole numbers that are counted in (not yet rounded)."""
    return amount * battery.grains / battery.capacity


def first_level(records: FleetRecords, robot: str) -> float:
    """Return the level of a robot's battery at first, in the user's units."""
    mine = records.robots[robot]
    battery = records.robot_types[mine.type].battery
    assert battery is not None
    return battery.first if mine.level is None else mine.level


def above_reserve(battery: Battery, level: float) -> int:
    """Return what a level is in grains above the reserve."""
    return max(0, math.floor(grains(battery, level) + 1e-9) - _reserve(battery))


def usable(battery: Battery) -> int:
    """Return the grains that a full battery has above its reserve."""
    return battery.grains - _reserve(battery)


def _reserve(battery: Battery) -> int:
    return math.ceil(grains(battery, battery.reserve) - 1e-9)


@dataclass(frozen=True)
class ChargePiece:
    """Steps of charging that give as much each: ``times`` of them at most, ``gives`` grains each,
    to no more than ``top`` (grains above the reserve).
    """

    gives: int
    top: int
    times: int


def pieces_of(battery: Battery, charger: Charger) -> list[ChargePiece]:
    """Return how a charger fills an empty battery: quick steps first, until it is full."""
    if charger.per_second is None:
        return []
    pieces: list[ChargePiece] = []
    bottom, left = 0, MOST_STEPS
    tops = [*(level for level, _ in battery.curve), battery.capacity]
    for top, share in zip(tops, (1.0, *(share for _, share in battery.curve)), strict=True):
        gives = math.floor(grains(battery, charger.per_second * share * charger.step) + 1e-9)
        high = above_reserve(battery, top)
        times = min(left, max(0, high - bottom) // gives if gives else 0)
        if times:
            pieces.append(ChargePiece(gives, high, times))
        bottom, left = max(bottom, high), left - times
    return pieces


def levels(
    records: FleetRecords, written: Written, plan: Mapping[str, Any]
) -> dict[str, list[tuple[float, float]]]:
    """Return each battery's level (s, the user's units) after each drive and charge of a plan
    dictionary, by what is really driven in it; ``written`` is the problem that it solves.
    """
    unit = float(plan["seconds_per_unit"])
    done = written.happening(plan["activities"])
    charges = [(m.robot, a) for m, a in done if m.kind is Kind.CHARGE]
    by_name = {a.name: a for a in written.problem.activities} if charges else {}
    found = {}
    for robot, mine in records.robots.items():
        battery = records.robot_types[mine.type].battery
        if battery is None:
            continue
        changes = [
            (row[-1][0], -taken(battery, rows_trajectory(row)))
            for row in (m["samples"] for m in plan["motions"] if m["object"] == robot)
        ]
        for who, a in charges:
            if who == robot:
                effects, level_of = effects_of(by_name[a["name"]]), level_fluent(robot)
                effect = next(e for _, e in effects if e.fluent.fluent().name == level_of)
                given = float(effect.value.constant_value()) * battery.capacity / battery.grains
                given = math.inf if effect.is_assignment() else given
                changes.append((float(a["end"]) * unit, given))
        level = first_level(records, robot)
        found[robot] = [(0.0, level)]
        for time, change in sorted(changes):
            level = min(level + change, battery.capacity)
            found[robot].append((time, level))
    return found


def level_fluent(robot: str) -> str:
    """Return the name of the fluent that tells a robot's level."""
    return f"{robot}_battery"


def tell_levels(records: FleetRecords, written: Written, plan: Mapping[str, Any]) -> list[str]:
    """Return in words how low batteries get, by what is really driven."""
    lines = []
    for robot, course in levels(records, written, plan).items():
        battery = records.kind_of(robot).battery
        assert battery is not None
        least = min(level for _, level in course)
        text = f"the battery of {robot} falls to {least:.3g} of {battery.capacity:g} at its lowest"
        if least < battery.reserve:
            text += f": below the reserve of {battery.reserve:g}, by detours among the others"
        lines.append(text)
    return lines
