"""Job shop with robots: every operation needs a robot at its machine, behind a closed door.

``machines`` rooms stand side by side above one hall; room i holds machine i and is closed by door
i, whose button is in the hall. Geometry and figures are the paper's (Tosello et al., Experimental
Evaluation), after the job shop with transportation (Nouri, Driss and Ghedira 2016); what the text
leaves open is drawn from a seed and frozen in ``data/jobshop.json`` for the paper's 36 instances.
Seeds other than 0 draw the floor, too: gaps, doors, buttons and machines anywhere, blocks in the
hall, robots of other shapes.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import random
from collections.abc import Sequence
from typing import Any

from unified_planning.model.motion import ConfigurationObject, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, And, Implies

from up_samp.benchmarks.instances import Encoding
from up_samp.benchmarks.places import (
    DATA,
    DOWN,
    UP,
    WALL,
    FamilyDoor,
    FamilyFloor,
    Pose,
    Shop,
    box,
    check_sizes,
    drawing,
    drawn_name,
    outer_wall,
)
from up_samp.benchmarks.published import Form, Manner

MOST = {"robots": 5, "jobs": 6, "machines": 6}
"""How large a job shop may be."""
APART = 4.0
"""How far apart robots start at least (m)."""
ROOM, HEIGHT = 50.0, 50.0
"""Width of a machine room, and height of the whole (m)."""
HALL, THICK, GAP = 31.5, 1.0, 5.0
"""Where the hall ends (y), thickness of the wall above it, and width of the gaps in it (m)."""


def shop_floor(cells: int, rng: random.Random | None = None, name: str = "") -> FamilyFloor:
    """Return the floor with ``cells`` machine rooms above one hall: the paper's, or one drawn from
    ``rng``. Robots can drive from anywhere to anywhere, with all doors open.
    """
    lefts = [ROOM * i for i in range(cells)]
    middles, hall, slide, blocks = [x + ROOM / 2 for x in lefts], HALL, [-4.0] * cells, []
    buttons = [(x, hall - 2.5, UP) for x in middles]
    if rng is not None:
        middles = [round(x + rng.uniform(12, ROOM - 12), 1) for x in lefts]
        hall += rng.choice((-3.0, 0.0, 3.0))
        slide = [rng.choice((-4.0, 4.0)) for _ in lefts]
        for x in lefts:
            left, low = round(x + rng.uniform(5, 35), 1), round(rng.uniform(2.5, 4), 1)
            blocks.append((left, low, left + rng.choice((4, 7, 10)), low + 2.0))
        buttons = [
            (
                round(x + rng.uniform(-9, 9), 1),
                round(hall - rng.uniform(2.5, 6), 1),
                rng.choice((UP, DOWN)),
            )
            for x in middles
        ]
    walls = outer_wall(ROOM * cells, HEIGHT)
    for a, b in itertools.pairwise([-GAP / 2, *middles, ROOM * cells + GAP / 2]):
        walls.append((a + GAP / 2, hall, b - GAP / 2, hall + THICK))
    walls += [(x - WALL, hall + THICK, x + WALL, HEIGHT) for x in lefts[1:]]
    line = hall + THICK / 2
    doors = [
        FamilyDoor(f"door{i}", box(1, 6), (x, line, UP), (x + to, line, UP), button)
        for i, (x, to, button) in enumerate(zip(middles, slide, buttons, strict=True))
    ]
    floor = FamilyFloor(name or f"jobshop-{cells}", (ROOM * cells, HEIGHT), walls + blocks, doors)
    return floor.reshaped(rng)


def draw_shop(robots: int, jobs: int, machines: int, seed: int) -> Shop:
    """Draw a job shop; the same arguments always give the same one.

    Each job visits all machines once in a random order, for 1 to 10 units each. Machine i stands
    uniformly in [22, 30] + 50 i by [35, 47], heading up or down (anywhere in its room, if the floor
    is drawn, too). Robots start on two rows in the hall, at least 4 m apart.
    """
    check_sizes("a job shop", MOST, robots, jobs, machines)
    rng = random.Random(f"jobshop-{robots}-{jobs}-{machines}-{seed}")
    routes = []
    for _ in range(jobs):
        order = list(range(machines))
        rng.shuffle(order)
        routes.append(tuple((m, rng.randint(1, 10)) for m in order))
    own = f"{instance_name(robots, jobs, machines)}-s{seed}"
    floor = shop_floor(machines, drawing(f"{own}-floor", seed), own if seed else "")
    taken = [door.button for door in floor.doors]
    low, high = floor.doors[0].closed[1], floor.size[1]
    room = (22, low + 3, 30, high - 3) if seed == 0 else (4, low + 4, ROOM - 4, high - 4)
    places = tuple(
        floor.spot(
            rng, (room[0] + ROOM * i, room[1], room[2] + ROOM * i, room[3]), (UP, DOWN), taken
        )
        for i in range(machines)
    )
    rows = (low - 12.0, low - 7.0)
    starts: list[Pose] = []
    while len(starts) < robots:
        x = round(rng.uniform(4, floor.size[0] - 4), 2)
        pose = (x, rng.choice(rows), rng.choice((UP, DOWN)))
        near = any(math.dist(pose[:2], other[:2]) < APART for other in taken)
        if not near and not floor.fault(pose):
            taken.append(pose)
            starts.append(pose)
    return Shop(floor, tuple(routes), places, tuple(starts))


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
    return Shop(shop_floor(len(entry["machines"])), jobs, poses("machines"), poses("starts"))


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
    encoding: Encoding = "fluents",
    metric: bool = True,
    seed: int = 0,
) -> SchedulingMotionProblem:
    """Build a job shop with robots.

    Each operation is attended by exactly one robot, which stands at the machine's pose for the
    whole of it. The operations of a job follow their order, a machine does one operation at a
    time. Moves are optional, between every ordered pair of all robots' starts, all machines and
    all buttons, each at most once. Doors are opened from their buttons in 1 unit of time. For the
    encodings see ``logistics``.
    """
    data = shop(robots, jobs, machines, seed)
    data.floor.check(shop_poses(data))
    title = drawn_name(instance_name(robots, jobs, machines), seed)
    form = Form(title, Manner(data.floor, guess=1.0), encoding, metric)
    starts = [form.place(f"robot{r}_start", pose) for r, pose in enumerate(data.starts)]
    for start in starts:
        form.robot(start)
    stands = [form.place(f"machine{m}", pose) for m, pose in enumerate(data.machines)]
    buttons = [form.door(door).button for door in data.floor.doors]
    ways = itertools.permutations([*stands, *starts, *buttons], 2)
    for robot, (origin, to) in itertools.product(form.robots, ways):
        form.move(robot, origin, to)
    form.openings()
    _operations(form, data, stands)
    return form.finish()


def shop_poses(data: Shop) -> dict[str, Pose]:
    """Return where robots stand, by name."""
    poses = {f"start{r}": pose for r, pose in enumerate(data.starts)}
    poses |= {f"machine{m}": pose for m, pose in enumerate(data.machines)}
    return poses | {f"button{i}": door.button for i, door in enumerate(data.floor.doors)}


def _operations(form: Form, shop: Shop, machines: Sequence[ConfigurationObject]) -> None:
    by_machine: list[list[Activity]] = [[] for _ in machines]
    owner: dict[int, int] = {}
    free = [
        form.problem.add_resource(f"machine{m}_free", 1) if form.with_resources else None
        for m in range(len(machines))
    ]
    for j, route in enumerate(shop.jobs):
        earlier: list[Activity] = []
        for t, (m, duration) in enumerate(route):
            choices = []
            for r, robot in enumerate(form.robots):
                a = form.work(robot, f"r{r}_j{j}_t{t}_m{m}", [machines[m]], duration)
                if free[m] is not None:
                    a.uses(free[m])
                owner[id(a)] = r
                choices.append(a)
            form.exactly_one(choices, inside=False)
            if earlier:
                for later in choices:
                    later.add_constraint(
                        And([Implies(e.present, GE(later.start, e.end)) for e in earlier])
                    )
            earlier = choices
            by_machine[m] += choices
    if not form.with_resources:
        for activities in by_machine:
            for a, b in itertools.combinations(activities, 2):
                if owner[id(a)] != owner[id(b)]:  # one robot's are apart anyhow
                    form.one_at_a_time((a, b))
