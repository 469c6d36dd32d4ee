"""Logistics as published: one pick per robot and item, whatever the number of poses."""

from __future__ import annotations

from collections.abc import Sequence

from unified_planning.model import Fluent
from unified_planning.model.motion import ConfigurationObject, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import FALSE, LE, TRUE, And, BoolType, Or

from up_samp.benchmarks.places import Layout
from up_samp.benchmarks.published.form import (
    HANDLING,
    Form,
    Manner,
    Published,
    PublishedRobot,
)

Shelves = list[list[ConfigurationObject]]
"""The poses from which each item can be picked."""


def published_logistics(
    name: str,
    spots: Layout,
    both_sides: bool,
    encoding: Published,
    metric: bool,
) -> SchedulingMotionProblem:
    """Build a logistics problem in a published form (what it asks: ``logistics``)."""
    form = Form(name, Manner(spots.floor, guess=0.5), encoding, metric)
    depots = [form.place(f"robot{r}_depot", pose) for r, pose in enumerate(spots.depots)]
    for depot in depots:
        form.robot(depot)
    shelves: Shelves = []
    for i, pose in enumerate(spots.inner):
        shelves.append([form.place(f"item{i}_in", pose)])
        if both_sides:
            shelves[-1].append(form.place(f"item{i}_out", spots.outer[i]))
    buttons = [form.door(door).button for door in spots.floor.doors]
    picks: list[list[Activity]] = [[] for _ in shelves]
    for robot in form.robots:
        _moves(form, robot, [p for poses in shelves for p in poses], buttons)
        for i, pick in enumerate(_picks(form, robot, shelves)):
            picks[i].append(pick)
    form.openings()
    for choices in picks:
        form.exactly_one(choices)
    form.end_at(dict(enumerate(depots)))
    return form.finish()


def _moves(
    form: Form,
    robot: PublishedRobot,
    poses: Sequence[ConfigurationObject],
    buttons: Sequence[ConfigurationObject],
) -> None:
    for place in (*poses, *buttons):
        form.move(robot, robot.start, place)
    for button in buttons:
        for place in poses:
            form.move(robot, button, place)
    for place in (*poses, *buttons):
        form.move(robot, place, robot.start)


def _picks(form: Form, robot: PublishedRobot, shelves: Shelves) -> list[Activity]:
    """Add the robot's picks; its hands must be free, and are so again when it comes home."""
    picks = [
        form.work(robot, f"pick_{robot.name}_item{i}", poses, HANDLING)
        for i, poses in enumerate(shelves)
    ]
    homeward = robot.moves_to([robot.start])
    if form.with_fluents:
        free = Fluent(f"{robot.name}_is_free", BoolType())
        form.problem.add_fluent(free, default_initial_value=True)
        for pick in picks:
            form.needs_at_start(pick, free)
            pick.add_effect(form.done(pick), free, FALSE())
        for move in homeward:
            move.add_effect(form.done(move), free, TRUE())
        return picks
    leaving = robot.moves_from(robot.start)
    for pick in picks:
        form.needs.append((pick, leaving, picks, False))
        home = Or([And(m.present, LE(pick.end, m.start)) for m in homeward])
        form.problem.add_constraint(home, scope=[pick.present])
    return picks
