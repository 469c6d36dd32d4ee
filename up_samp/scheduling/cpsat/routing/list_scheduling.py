"""Schedules of travellers by list scheduling: one task after the other, as early as it fits.

A plan is a sequence of tasks with who does each; :class:`Decoder` gives every task and move its
time (a serial schedule generation scheme, Kolisch 1996): doors are opened where nobody has done so
before, moves wait until nothing changes in their midst, and robots leave a unary place when
somebody else needs it. :func:`improve` anneals the sequence (Kirkpatrick et al. 1983).
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.routing.decoder import DeadEnd, Decoder, Step
from up_samp.scheduling.cpsat.routing.dispatch import Work

_GREEDY = (4, 20)
"""Greedy sequences that are tried, without annealing and before it."""


@dataclass
class Tour:
    """A sequence with its schedule; ``cost`` orders tours."""

    sequence: list[Step]
    schedule: CandidateSchedule
    cost: float


def decode(work: Work, sequence: list[Step]) -> Tour | None:
    """Return the tour of a sequence, ``None`` at a dead end."""
    decoder = Decoder(work)
    try:
        schedule = decoder.run(sequence)
    except DeadEnd:
        return None
    busy = sum(robot.free for robot in decoder.robots) / max(1, len(decoder.robots))
    ends = sum(end for _, end in decoder.done.values()) / max(1, len(decoder.done))
    cost = schedule.makespan + 0.02 * busy + 0.05 * ends
    return Tour([(t, decoder.ways[t]) for t in decoder.order], schedule, cost)


def sequence_of(work: Work, schedule: CandidateSchedule) -> list[Step]:
    """Return who does which task, in the order of a schedule."""
    found = []
    for number, task in enumerate(work.tasks):
        for way, (_, name, _) in enumerate(task.ways):
            if name in schedule.times:
                found.append((*schedule.times[name], number, way))
    first: dict[int, int] = {}
    for _, _, number, way in sorted(found):
        first.setdefault(number, way)  # who opens a door again changes nothing
    return list(first.items())


def improve(
    work: Work,
    rounds: int,
    seed: int,
    over: Callable[[], bool],
    *,
    start: list[Step] | None = None,
    enough: int = 0,
) -> Tour | None:
    """Return the best tour found by simulated annealing over sequences, from a few greedy ones and
    ``start``; a makespan of ``enough`` ends it.
    """
    rng = random.Random(seed)
    tours = (decode(work, start) if start else None, _greedy(work, rng, _GREEDY[rounds > 0]))
    best = current = min((t for t in tours if t is not None), key=lambda t: t.cost, default=None)
    if best is None or current is None:
        return None
    heat = 0.08 * max(1.0, best.cost)
    cooling = 0.05 ** (1 / max(1, rounds))
    for _ in range(rounds):
        if over() or best.schedule.makespan <= enough:
            break
        new = decode(work, _neighbour(work, current.sequence, rng))
        heat *= cooling
        if new is None:
            continue
        if new.cost <= current.cost or rng.random() < math.exp((current.cost - new.cost) / heat):
            current = new
            if new.cost < best.cost:
                best = new
    return best


def _greedy(work: Work, rng: random.Random, attempts: int) -> Tour | None:
    wanted = [i for i, task in enumerate(work.tasks) if task.wanted]
    if not wanted:
        return None
    tails = _tails(work)
    found = []
    for attempt in range(attempts):
        noise = {i: rng.random() * attempt for i in wanted}
        order = sorted(wanted, key=lambda i: (-tails[i] - noise[i] * work.tasks[i].length, i))
        tour = decode(work, [(i, -1) for i in order])
        if tour is not None:
            found.append(tour)
    return min(found, key=lambda tour: tour.cost, default=None)


def _tails(work: Work) -> list[int]:
    """Return the length of the longest chain from each task's start on."""
    tails = [task.length for task in work.tasks]
    for _ in work.tasks:
        changed = False
        for i, task in enumerate(work.tasks):
            for before, gap in task.after:
                if tails[before] < gap + tails[i]:
                    tails[before], changed = gap + tails[i], True
        if not changed:
            break
    return tails


def _neighbour(work: Work, sequence: list[Step], rng: random.Random) -> list[Step]:
    """Return a sequence with a task done by another, at another time, or not on purpose."""
    new = list(sequence)
    if not new:
        return new
    at = rng.randrange(len(new))
    task, way = new[at]
    kind = rng.random()
    if not work.tasks[task].wanted and kind < 0.3:
        del new[at]  # whoever needs it first does it
    elif kind < 0.5 and len(work.tasks[task].ways) > 1:
        new[at] = (task, rng.choice([w for w in range(len(work.tasks[task].ways)) if w != way]))
    else:
        step = new.pop(at)
        near = max(0, min(len(new), at + rng.randint(-6, 6)))
        new.insert(near if kind < 0.85 else rng.randint(0, len(new)), step)
        if kind > 0.9:
            new[at if at < len(new) else -1] = (new[at if at < len(new) else -1][0], -1)
    return new
