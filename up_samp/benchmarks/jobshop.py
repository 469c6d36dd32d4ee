"""Job shop with robots: every operation needs a robot at its machine, behind a closed door.

``machines`` rooms stand side by side above one hall; room i holds machine i and is closed by door
i, whose button is in the hall. Geometry and figures are the paper's (Tosello et al., Experimental
Evaluation), after the job shop with transportation (Nouri, Driss and Ghedira 2016); what the text
leaves open is drawn from a seed and frozen in ``data/jobshop.json`` for the paper's 36 instances.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import random
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from unified_planning.model.motion import ConfigurationObject, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.benchmarks.builder import Encoding, Family, is_published
from up_samp.benchmarks.maps import DATA, SHOP, job_shop_map, job_shop_size, job_shop_walls
from up_samp.benchmarks.places import FamilyDoor, Pose, Shop, box, check_poses
from up_samp.benchmarks.published.jobshop import published_job_shop
from up_samp.model import ProblemError

MOST = {"robots": 5, "jobs": 6, "machines": 6}
"""How large a job shop may be."""
ACCELERATION, APART = 1.0, 4.0
"""What the robots can do at most (m/s^2), and how far apart they start at least (m)."""

_UP = math.pi / 2


def shop_door(i: int) -> FamilyDoor:
    """Return door ``i``, in the gap of room ``i``."""
    x = SHOP.room_width * i
    return FamilyDoor(
        f"door{i}", box(1, 6), (25 + x, 32.0, _UP), (21 + x, 32.0, _UP), (25 + x, 29.0, _UP)
    )


def draw_shop(robots: int, jobs: int, machines: int, seed: int) -> Shop:
    """Draw a job shop; the same arguments always give the same one.

    Machine i stands uniformly in [22, 30] + 50 i by [35, 47], heading up or down. Each job visits
    all machines once in a random order, for 1 to 10 units each. Robots start in the hall on the
    rows y = 25 or y = 20, at least 4 m apart.
    """
    for (what, most), n in zip(MOST.items(), (robots, jobs, machines), strict=True):
        if not 1 <= n <= most:
            raise ProblemError(f"a job shop takes 1 to {most} {what}, not {n}")
    rng = random.Random(f"jobshop-{robots}-{jobs}-{machines}-{seed}")
    routes = []
    for _ in range(jobs):
        order = list(range(machines))
        rng.shuffle(order)
        routes.append(tuple((m, rng.randint(1, 10)) for m in order))
    places = tuple(
        (
            round(rng.uniform(22, 30) + SHOP.room_width * i, 2),
            round(rng.uniform(35, 47), 2),
            rng.choice((_UP, -_UP)),
        )
        for i in range(machines)
    )
    starts: list[Pose] = []
    while len(starts) < robots:
        x = round(rng.uniform(4, job_shop_size(machines)[0] - 4), 2)
        pose = (x, rng.choice((20.0, 25.0)), rng.choice((_UP, -_UP)))
        if all(math.dist(pose[:2], other[:2]) >= APART for other in starts):
            starts.append(pose)
    return Shop(tuple(routes), places, tuple(starts))


@functools.cache
def frozen_shops() -> dict[str, Shop]:
    """Return the shops that are frozen with the package, by instance name."""
    data = json.loads((DATA / "jobshop.json").read_text(encoding="utf-8"))
    return {name: shop_from_json(entry) for name, entry in data.items()}


def shop_from_json(entry: dict[str, Any]) -> Shop:
    """Return the shop that ``data/jobshop.json`` has."""

    def poses(key: str) -> tuple[Pose, ...]:
        return tuple((float(x), float(y), float(theta)) for x, y, theta in entry[key])

    jobs = tuple(tuple((int(m), int(d)) for m, d in route) for route in entry["jobs"])
    return Shop(jobs, poses("machines"), poses("starts"))


def instance_name(robots: int, jobs: int, machines: int) -> str:
    """Return the name of an instance, such as ``jobshop-r2-j2-m4``."""
    return f"jobshop-r{robots}-j{jobs}-m{machines}"


def shop(robots: int, jobs: int, machines: int, seed: int = 0) -> Shop:
    """Return the frozen shop if there is one (seed 0, paper's sizes), else draw it."""
    frozen = frozen_shops().get(instance_name(robots, jobs, machines)) if seed == 0 else None
    return frozen or draw_shop(robots, jobs, machines, seed)


def job_shop(
    robots: int = 2,
    jobs: int = 2,
    machines: int = 2,
    *,
    encoding: Encoding = "lean",
    metric: bool = True,
    seed: int = 0,
    name: str | None = None,
) -> SchedulingMotionProblem:
    """Build a job shop with robots.

    Each operation is attended by exactly one robot, which stands at the machine's pose for the
    whole of it. The operations of a job follow their order, a machine does one operation at a
    time. Moves are optional, between every ordered pair of the robot's own start, all machines and
    all buttons, each at most once (as published: the other robots' starts, too). Doors are opened
    from their buttons in 1 unit of time. What a schedule means is told in
    :mod:`up_samp.benchmarks.builder`; for the other encodings see ``logistics``.
    """
    data = shop(robots, jobs, machines, seed)
    doors = [shop_door(i) for i in range(machines)]
    check(data, doors)
    title = name or instance_name(robots, jobs, machines) + (f"-s{seed}" if seed else "")
    if is_published(encoding):
        return published_job_shop(title, data, doors, encoding, metric)
    yaml = str(job_shop_map(machines))
    family = Family(title, yaml, a_max=ACCELERATION, encoding=encoding, metric=metric)
    starts = [family.place(f"start{r}", pose) for r, pose in enumerate(data.starts)]
    for r, start in enumerate(starts):
        family.robot(f"r{r}", start)
    stands = [family.place(f"machine{m}", pose) for m, pose in enumerate(data.machines)]
    buttons = add_doors(family, doors)
    for robot, start in zip(family.robots, starts, strict=True):
        for origin, to in itertools.permutations([start, *stands, *buttons], 2):
            family.move(robot, origin, to)
    _operations(family, data, stands)
    return family.finish()


def add_doors(family: Family, doors: list[FamilyDoor]) -> list[ConfigurationObject]:
    """Add closed ``doors`` that any robot may open; return the places of their buttons."""
    buttons = []
    for i, door in enumerate(doors):
        leaf, closed, opened = family.door(door, prefix=door.name)
        button = family.place(f"button{i}", door.button)
        family.open_door(f"open_{door.name}", leaf, closed, opened, button)
        buttons.append(button)
    return buttons


def _operations(family: Family, data: Shop, stands: list[ConfigurationObject]) -> None:
    """Add the operations, one alternative per robot, in job order and one per machine."""
    by_machine: list[list[list[Activity]]] = [[] for _ in stands]
    for j, route in enumerate(data.jobs):
        previous: list[Activity] = []
        for m, duration in route:
            choices: list[Activity] = [
                family.work(robot, f"op_j{j}_m{m}_{robot.name}", stands[m], duration)
                for robot in family.robots
            ]
            family.exactly_one(choices)
            family.in_order(previous, choices)
            by_machine[m].append(choices)
            previous = choices
    for operations in by_machine:
        for some, others in itertools.combinations(operations, 2):
            for a, b in itertools.product(some, others):
                family.one_at_a_time((a, b))


def check(
    data: Shop,
    doors: list[FamilyDoor],
    others: Mapping[str, Pose] = MappingProxyType({}),
    *,
    closed: bool = True,
) -> None:
    """Check where robots stand: at first, at machines, at buttons, and at ``others``. ``closed``:
    there are doors that they could stand in.
    """
    poses = dict(others) | {f"start{r}": pose for r, pose in enumerate(data.starts)}
    poses |= {f"machine{m}": pose for m, pose in enumerate(data.machines)}
    poses |= {f"button{i}": door.button for i, door in enumerate(doors)}
    size = job_shop_size(len(doors))
    walls = job_shop_walls(len(doors))
    check_poses(size, walls, poses, doors=doors if closed else ())
