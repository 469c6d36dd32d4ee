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
from up_samp.execution.state import TaskPhase
from up_samp.fleet.batteries import first_level, level_fluent, usable
from up_samp.fleet.meanings import Meaning, Written
from up_samp.fleet.records import Battery, Charger, FleetRecords, Order, Robot, Task
from up_samp.io.plan_dict import PlanDict
from up_samp.model import ProblemError
from up_samp.operate.choice import Day

CHARGE, BREAK = "charge.", "break."
"""What the names of tasks begin with in which a robot charges, or rests."""
OFF = "off its shift"
"""Why such a robot does nothing."""
MUTE = "it tells no level of its battery: it counts as at first, and does not charge by itself"


def is_charge(job: str) -> bool:
    """Return whether an order, by its id, is that a robot charges."""
    return job.startswith(CHARGE)


def charges(job: Order | Task) -> bool:
    """Return whether an order is one of :func:`charge_task`, and not only called so."""
    who = job.id.removeprefix(CHARGE).rpartition(".")[0]
    return isinstance(job, Task) and is_charge(job.id) and job.robots == (who,)


def action_of(plan: PlanDict, name: str) -> tuple[str, str]:
    """Return what a robot does at a place in an activity of a plan, in a word (``charge``, or what
    it is called in plans), and of which order.
    """
    kind, what, _ = plan["meanings"][name]
    return "charge" if is_charge(what) else kind, what


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


def charge_task(site: FleetRecords, robot: str, name: str, now: float) -> Task:
    """Return the task of charging a robot until it is full, at any charger, for as long as it takes
    from the reserve on by the slowest of them: what it is to do next.
    """
    battery, chargers = battery_of(site, robot), charger_of(site)
    seconds = seconds_to_fill(site, battery, battery.capacity - battery.reserve)
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
        if _level(site, levels, robot) - battery.reserve
        < share * (battery.capacity - battery.reserve)
    ]


def mute(day: Day, levels: Mapping[str, float]) -> set[tuple[str, str]]:
    """Return the robots with a battery that have done something of the plan, and told no level:
    what is wrong then, in words.
    """
    silent = batteries_of(day.site).keys() - levels.keys()
    over = (day.meanings[name].robot for name in day.executor.state.those(TaskPhase.DONE))
    return {(robot, MUTE) for robot in silent.intersection(over)}


def _level(site: FleetRecords, levels: Mapping[str, float], robot: str) -> float:
    """Return a robot's level (the user's units): what it told, and before that, what the site says
    that it has at first.
    """
    if robot in levels:
        return levels[robot] * battery_of(site, robot).capacity
    return first_level(site, robot)


def start_levels(
    site: FleetRecords,
    levels: Mapping[str, float],
    drives: Mapping[tuple[str, str], DriveCells],
    meanings: Mapping[str, Meaning],
    kept: Iterable[str],
) -> dict[str, float]:
    """Return with what level (the user's units) each robot begins a plan that follows what is
    ``kept``, in its order: what it told last less what its drives take; full after it charges.
    """
    batteries = batteries_of(site)
    found = {robot: _level(site, levels, robot) for robot in batteries}
    for name in kept:
        robot = meanings[name].robot
        if robot not in batteries:
            continue
        battery, drive = batteries[robot], drives.get((name, robot))
        if is_charge(meanings[name].what):
            found[robot] = battery.capacity
        elif drive is not None:
            found[robot] -= battery.per_metre * drive.path.length
            found[robot] -= battery.per_second * float(drive.path.natural.times[-1])
    return {robot: max(batteries[robot].reserve, level) for robot, level in found.items()}


def with_levels(site: FleetRecords, levels: Mapping[str, float]) -> FleetRecords:
    """Return a site in which robots begin with some levels, and nobody charges by itself."""
    robots = {n: replace(r, level=levels.get(n)) for n, r in site.robots.items()}
    places = {n: replace(p, charger=None) for n, p in site.places.items()}
    return replace(site, robots=robots, places=places)


def state_charges(site: FleetRecords, written: Written) -> None:
    """State in a day's problem that robots are full once their tasks of charging are done."""
    for activity in written.problem.activities:
        meaning = written.meanings[activity.name]
        if is_charge(meaning.what):
            level = written.problem.fluent(level_fluent(meaning.robot))
            full = usable(battery_of(site, meaning.robot))
            activity.add_effect(activity.end - 1, level(), full)


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
