"""When robots do no orders: batteries, breaks and shifts over a day.

Charging is a task at a charger that only its robot may do, and a break one where it ends its day,
so they are planned, kept and killed like any other. Plans themselves charge nobody: they only keep
levels above the reserve. Who is off its shift stands where it is, as any robot that does nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from up_samp.execution.lives import DriveCells
from up_samp.fleet.records import Battery, Charger, FleetRecords, Robot, Task
from up_samp.fleet.statements import Meaning
from up_samp.model import ProblemError
from up_samp.operate.choice import Day

CHARGE, BREAK = "charge.", "break."
"""What the names of tasks begin with in which a robot charges, or rests."""
OFF = "off its shift"
"""Why such a robot does nothing."""


def is_charge(job: str) -> bool:
    """Return whether an order, by its id, is that a robot charges."""
    return job.startswith(CHARGE)


def action_of(kind: str, what: str) -> str:
    """Return what a robot does at a place, in a word: ``charge``, or what it is called in plans."""
    return "charge" if is_charge(what) else kind


def charger_of(site: FleetRecords) -> dict[str, Charger]:
    """Return a site's chargers by their places."""
    return {n: p.charger for n, p in site.places.items() if p.charger is not None}


def batteries_of(site: FleetRecords) -> dict[str, Battery]:
    """Return the batteries of a site's robots that have one, by robot."""
    found = {n: site.robot_types[r.type].battery for n, r in site.robots.items()}
    return {n: battery for n, battery in found.items() if battery is not None}


def battery_of(site: FleetRecords, robot: str) -> Battery:
    """Return a robot's battery.

    :raises ProblemError: where its type has none, or nobody can charge on this site.
    """
    battery = batteries_of(site).get(robot)
    if battery is None or not charger_of(site):
        raise ProblemError(f"'{robot}' has no battery, or no place has a charger")
    return battery


def seconds_to_fill(site: FleetRecords, battery: Battery, amount: float) -> float:
    """Return how long (s) it takes to give an amount at the slowest charger, as slowly as it gives
    when the battery is fullest; at least 1 s.
    """
    slow = min((share for _, share in battery.curve), default=1.0)
    found = [1.0]
    for charger in charger_of(site).values():
        given = (charger.per_second or battery.capacity) * slow
        found.append(amount / given if charger.swap is None else charger.swap)
    return max(found)


def charge_task(site: FleetRecords, robot: str, level: float, name: str, now: float) -> Task:
    """Return the task of charging a robot until it is full, from a ``level`` (share of a full
    battery) on, at any charger, by the slowest of them: what it is to do next.
    """
    battery, chargers = battery_of(site, robot), charger_of(site)
    seconds = seconds_to_fill(site, battery, (1.0 - level) * battery.capacity)
    return Task(
        id=name,
        at=tuple(chargers),
        duration=math.ceil(seconds),
        robots=(robot,),
        due=now,
        weight=50.0,
    )


def low(site: FleetRecords, levels: Mapping[str, float], share: float) -> list[str]:
    """Return the robots that have less than a ``share`` of what a full battery has above its
    reserve, by the levels (shares of a full one) that they told.
    """
    return [
        robot
        for robot, battery in batteries_of(site).items()
        if levels.get(robot, 1.0) * battery.capacity - battery.reserve
        < share * (battery.capacity - battery.reserve)
    ]


def start_levels(
    site: FleetRecords,
    levels: Mapping[str, float],
    drives: Mapping[tuple[str, str], DriveCells],
    meanings: Mapping[str, Meaning],
    kept: Iterable[str],
) -> dict[str, float]:
    """Return with what level (the user's units) each robot begins a plan that follows what is
    ``kept``: what it told last less what its drives until then take; full where it charges.
    """
    names = set(kept)
    ahead = [drive for (name, _), drive in drives.items() if name in names]
    charged = {m.robot for n, m in meanings.items() if n in names and is_charge(m.what)}
    found = {}
    for robot, battery in batteries_of(site).items():
        mine = [drive.path for drive in ahead if drive.object == robot]
        level = levels.get(robot, 1.0) * battery.capacity
        level -= battery.per_metre * sum(path.length for path in mine)
        level -= battery.per_second * sum(float(path.natural.times[-1]) for path in mine)
        least = battery.reserve + 1e-3 * battery.capacity
        found[robot] = battery.capacity if robot in charged else max(least, level)
    return found


def with_levels(
    site: FleetRecords, levels: Mapping[str, float], charging: Iterable[str]
) -> FleetRecords:
    """Return a site in which robots begin with some levels, those that are to charge first as if
    they had, and nobody charges by itself.
    """
    full = {robot: battery_of(site, robot).capacity for robot in charging}
    begins = {**levels, **full}
    robots = {n: replace(r, level=begins.get(n)) for n, r in site.robots.items()}
    places = {n: replace(p, charger=None) for n, p in site.places.items()}
    return replace(site, robots=robots, places=places)


# ------------------ Breaks and shifts


def breaks_of(site: FleetRecords) -> Iterator[Task]:
    """Yield the breaks of a site's robots as tasks of the day: as soon as they may begin, and late
    rather than never.
    """
    for name, robot in site.robots.items():
        for number, rest in enumerate(robot.breaks, 1):
            opens, closes = rest.window
            yield Task(
                id=f"{BREAK}{name}.{number}",
                at=(robot.end or robot.start,),
                duration=rest.duration,
                robots=(name,),
                release=opens,
                due=closes,
                weight=50.0,
            )


def shift_changes(day: Day) -> dict[str, bool]:
    """Return the robots whose shift has begun by now (``True``), or is over, of whom that is not
    told yet. Who is still to do something, or to go home, ends its shift after that.
    """
    now, robots = day.clock.now(), day.site.robots
    off = {n for n, robot in robots.items() if not robot.hours[0] <= now < robot.hours[1]}
    over = off - day.away.keys()
    busy = {*day.stranded(), *day.busy(day.cut())} if over else set()
    away = {name for name, why in day.away.items() if why == OFF}
    return dict.fromkeys(sorted(away - off), True) | dict.fromkeys(sorted(over - busy), False)


def from_now(site: FleetRecords, now: float) -> FleetRecords:
    """Return a site whose robots' shifts are on the clock of a plan that begins ``now``; breaks are
    none of it.
    """

    def moved(robot: Robot) -> Robot:
        shift = robot.shift and (max(0.0, robot.shift[0] - now), robot.shift[1] - now)
        return replace(robot, shift=shift, breaks=())

    return replace(site, robots={name: moved(robot) for name, robot in site.robots.items()})
