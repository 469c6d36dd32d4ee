"""Job shops as published: moves between all places, also to the other robots' starts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from unified_planning.model.motion import ConfigurationObject, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, And, Implies

from up_samp.benchmarks.places import Shop
from up_samp.benchmarks.published.form import Form, Manner, Published


def published_job_shop(
    name: str, shop: Shop, encoding: Published, metric: bool
) -> SchedulingMotionProblem:
    """Build a job shop in a published form (what it asks: ``job_shop``)."""
    form = Form(name, Manner(shop.floor, guess=1.0), encoding, metric)
    starts = [form.place(f"robot{r}_start", pose) for r, pose in enumerate(shop.starts)]
    for start in starts:
        form.robot(start)
    machines = [form.place(f"machine{m}", pose) for m, pose in enumerate(shop.machines)]
    buttons = [form.door(door).button for door in shop.floor.doors]
    for robot in form.robots:
        for origin, to in itertools.permutations([*machines, *starts, *buttons], 2):
            form.move(robot, origin, to)
    form.openings()
    _operations(form, shop, machines)
    return form.finish()


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
