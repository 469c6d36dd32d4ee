"""Dependencies of made-up plans of many robots, and somebody who drives them: for timing."""

from __future__ import annotations

import random
import time

import numpy as np

from up_samp.execution import At, Dependencies, Do, Edge, Event, Go, Graph, PlannedTask
from up_samp.execution.graph import ORIGIN
from up_samp.execution.lives import DriveCells, Life
from up_samp.model import Body, Kinematics, MotionModel, Trajectory
from up_samp.motion.fleet.paths import path_of


def fleet(robots, tasks, seed=0):
    """Dependencies of a made-up plan: robots on straight lanes, half of the tasks drives, with
    gates that wait for other robots' points of the same stage.
    """
    rng = random.Random(seed)
    each = tasks // robots
    body = Body(((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)),
                Kinematics(MotionModel.REEDSSHEPP, v_max=2.0, a_max=0.5))  # fmt: skip
    times, s = travel_samples(30.0, 2.0, 0.5)
    all_tasks, lives, events, edges = {}, {}, {ORIGIN: 0.0}, []
    for r in range(robots):
        poses = np.column_stack([s, np.full(len(s), 2.0 * r), np.zeros(len(s))])
        path = path_of(Trajectory(times, poses), body)
        pieces = []
        for k in range(each):
            name, start = f"t{r}_{k}", 25.0 * k
            drives = k % 2 == 0
            all_tasks[name] = PlannedTask(
                name, (start, start + 20.0), 20.0, (f"r{r}",), (f"r{r}",) if drives else ()
            )
            events[Event(At.START, name)], events[Event(At.END, name)] = start, start + 20.0
            if drives:
                pieces.append(DriveCells(name, f"r{r}", path, start, None))
            if k:
                edges.append((Event(At.END, f"t{r}_{k - 1}"), Event(At.START, name)))
        lives[f"r{r}"] = Life(f"r{r}", body, tuple(pieces))
    for k in range(0, each, 2):
        for r in range(1, robots):
            for _ in range(8):
                other = rng.randrange(r)
                progress = round(rng.uniform(1.0, 29.0), 3)
                first = Event(At.REACH, f"t{other}_{k}", f"r{other}", progress)
                then = Event(At.LEAVE, f"t{r}_{k}", f"r{r}", round(0.8 * progress, 3))
                events[first] = events[then] = 25.0 * k + progress / 2
                edges.append((first, then))
    made = tuple(Edge(a, b, 0.0, "meeting", "made up") for a, b in set(edges))
    lengths = {d.key: d.path.length for life in lives.values() for d in life.drives}
    graph = Graph(
        all_tasks, tuple(events), tuple(events.values()), made, (), len(made), 0.0, lengths
    )
    return Dependencies(graph, lives, ())


def travel_samples(length, v, a):
    """Times and progress of a rest-to-rest drive."""
    times = np.linspace(0.0, length / v + v / a, 400)
    speed = np.minimum(np.minimum(a * times, v), a * (times[-1] - times))
    s = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(times))])
    return times, s * length / s[-1]


def drive_all(executor, seconds, forecasts=True):
    """Drive everybody for so long; return CPU times (s) of updates, commands and forecasts."""
    spent = {"update": [], "commands": [], "forecast": []}

    def clocked(what, call, *args, **kwargs):
        began = time.process_time()
        found = call(*args, **kwargs)
        spent[what].append(time.process_time() - began)
        return found

    now, at, since = 0.0, {}, {}
    while now < seconds and not executor.finished:
        for who, command in clocked("commands", executor.commands, now).items():
            if isinstance(command, Go):
                key = (who, command.motion)
                at[key] = min(at.get(key, -1.0) + 1.0, command.until)
                clocked("update", executor.update, who, progress=at[key], now=now,
                        motion=command.motion)  # fmt: skip
            elif isinstance(command, Do):
                since.setdefault(command.activity, now)
                if now >= since[command.activity] + 20.0 and command.may_end:
                    clocked("update", executor.done, command.activity, now)
        if forecasts:
            clocked("forecast", executor.predicted_makespan)
        now += 1.0
    return spent
