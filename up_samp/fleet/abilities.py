"""Which robots can do which jobs."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from up_samp.fleet.records import FleetRecords, Order, RobotType, Task


def carries(kind: RobotType, order: Order) -> bool:
    """Return whether a robot of this type can carry the order's load."""
    return all(kind.capacity.get(k, 0) >= n for k, n in order.load.items())


def needs_robot(job: Order | Task) -> bool:
    """Return whether a robot does it."""
    return not isinstance(job, Task) or bool(job.at)


def able(records: FleetRecords, job: Order | Task) -> list[str]:
    """Return the robots that have the skills and are among those named."""
    return with_skills(records, job.skills, job.robots)


def with_skills(records: FleetRecords, skills: Iterable[str], robots: Collection[str]) -> list[str]:
    """Return the robots that have all ``skills``, among ``robots`` if any are named."""
    needed = set(skills)
    return [
        name
        for name, robot in records.robots.items()
        if (not robots or name in robots) and needed <= set(robot.skills)
    ]
