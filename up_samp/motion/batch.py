"""Planning many legs ahead, in parallel processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor

from up_samp.geometry import OccupancyGrid
from up_samp.model import Body, Configuration, Deadline, Outcome, PathQuery, Placed
from up_samp.motion.protocol import Leg, LegQuery
from up_samp.motion.service import MotionService

Pair = tuple[Body, Configuration, Configuration]

_worker: MotionService | None = None


def precompute(
    service: MotionService,
    pairs: Iterable[Pair],
    processes: int = 1,
    obstacles: tuple[Placed, ...] = (),
    deadline: Deadline | None = None,
) -> int:
    """Plan all pairs (once per pair and its reverse) and put the legs into the service's cache.

    Return how many are known then.
    """
    deadline = deadline or Deadline.never()
    todo = _distinct(service, pairs)
    if processes <= 1 or len(todo) < 2:
        done = 0
        for body, start, goal in todo:
            if deadline.expired():
                break
            report = service.plan(PathQuery(body, (start, goal), obstacles), deadline)
            done += report.outcome is Outcome.FOUND
        return done
    # spawned workers share no locks or threads with this process
    with ProcessPoolExecutor(
        processes,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start,
        initargs=(service.grid, service.planner, service.scene.margin, service.seed),
    ) as pool:
        limits = [deadline.remaining()] * len(todo)
        found = pool.map(_plan, todo, [obstacles] * len(todo), limits, chunksize=4)
        return sum(
            _store(service, pair, obstacles, legs) for pair, legs in zip(todo, found, strict=True)
        )


def _distinct(service: MotionService, pairs: Iterable[Pair]) -> list[Pair]:
    seen, todo = set(), []
    for body, start, goal in pairs:
        ends = frozenset((tuple(start), tuple(goal)))
        if len(ends) == 2 and (body, ends) not in seen:
            seen.add((body, ends))
            todo.append((body, start, goal))
    return todo


def _start(grid: OccupancyGrid | None, planner: str, margin: float, seed: int) -> None:
    global _worker
    _worker = MotionService(grid, planner=planner, margin=margin, seed=seed)


def _plan(pair: Pair, obstacles: tuple[Placed, ...], seconds: float) -> tuple[str, Leg] | None:
    assert _worker is not None
    limit = None if seconds == float("inf") else seconds
    body, start, goal = pair
    if _worker.certificate(body, (start, goal), obstacles) is not None:
        return None
    found = _worker.legs.find(LegQuery(body, start, goal, obstacles), Deadline.after(limit))
    return None if found.leg is None else (found.planner, found.leg)


def _store(
    service: MotionService,
    pair: Pair,
    obstacles: tuple[Placed, ...],
    found: tuple[str, Leg] | None,
) -> int:
    if found is None:
        return 0
    name, leg = found
    service.remember(name, LegQuery(*pair, obstacles), leg)
    return 1
