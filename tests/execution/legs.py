"""Plans carried out leg by leg: what is left is planned anew, and gone on with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from up_samp.execution import Executor, Surprise, solve_remaining
from up_samp.execution.simulate import Floor, broken_where_they_stand, simulation_of

LAST_METRES = 30.0
"""Seconds that robots may be late in coming to a stand, beside those in which they are held up."""


@dataclass(frozen=True)
class Incident:
    """At ``time`` (s since the first plan's start) this becomes known. Robots ``broken_down`` are
    out of order from then on, wherever they stand.
    """

    time: float
    surprise: Surprise = field(default_factory=Surprise)
    broken_down: tuple[str, ...] = ()


def carried_out(problem, plan, delays, seed=0, *, incident=None, late=None, solve=solve_remaining):
    """Execute a plan; plan the rest anew at an incident, or once when it is forecast to end
    ``late`` s later than planned (with the same choices).

    The new plan begins when all robots under way have come to a stand where they can. Returns for
    each leg when it began (s) and what happened.
    """
    legs: list[tuple[float, Any]] = []
    since = 0.0
    while True:
        floor = Floor(Executor(plan, problem), delays, seed + len(legs))
        told = _until(floor, *(None, None) if legs else (incident, late))
        if told is None:
            return [*legs, (since, simulation_of(floor, plan, "replan", seed))]
        executor = floor.executive
        broken = executor.remaining_problem().stops if told.broken_down else {}
        left = executor.remaining_problem(
            broken_where_they_stand(executor, told.surprise, told.broken_down)
        )
        start = left.since * float(plan["seconds_per_unit"])
        start = _come_to_a_stand(floor, {**broken, **left.stops}, start)
        legs.append((since, simulation_of(floor, plan, "replan", seed)))
        plan, problem = solve(left), left.problem
        since += start


def _until(floor, incident, late):
    """Execute until something happens; ``None``: until the end."""
    planned, looked = floor.executive.dependencies.graph.planned, 0.0
    while floor.goes_on:
        if incident is not None and floor.now >= incident.time:
            return incident
        if late is not None and floor.now >= looked + 1.0:
            looked = floor.now
            if floor.executive.predicted_makespan() > planned + late:
                return Incident(floor.now, Surprise(same_choices=True))
        floor.step()
    return None


def _come_to_a_stand(floor, stops, until):
    """Let robots under way drive on to where they stop; nothing new begins. Return when (s) all
    stand: at ``until``, or later where one is held up on these last metres.
    """
    late = 0.0
    while True:
        left = [
            r
            for r in floor.robots.values()
            if r.motion is not None and max(r.s, r.believed) < stops.get(r.name, 0)
        ]
        if not left and floor.now >= until - 1e-9:
            return floor.now
        held = any(floor.now < r.held_until for r in left)
        late += floor.tick if floor.now >= until and not held else 0.0
        if late > LAST_METRES:
            names = ", ".join(f"'{r.name}'" for r in left)
            raise AssertionError(f"{names} did not come to a stand")
        for robot in left:
            robot.until, robot.hold = stops[robot.name], False
            robot.step(floor.now, floor.tick)
        floor.now = round(floor.now + floor.tick, 9)
