"""Motion queries done by workers: other processes, or other machines, behind one executor.

A :class:`Crew` hands queries to the workers (:mod:`up_samp.system.workers`) and takes the answers
in the order of the questions. Each query is answered as the service itself would answer it; what a
search came to the end of is the same on any machine. In one process queries run one at a time, also
on an executor of threads: the planners' random numbers belong to one of them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

from up_samp.geometry import OccupancyGrid
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    GroupReport,
    PathQuery,
    PathReport,
)
from up_samp.motion.protocol import Leg, LegQuery
from up_samp.motion.service import MotionService
from up_samp.motion.tuning import MotionTuning
from up_samp.system.workers import Workers, WorkItem

CHUNK = 6
"""Paths that are asked for in one task."""
MOST_SERVICES = 4
"""Maps (with settings) that a worker remembers."""
Answer = TypeVar("Answer")
Found = tuple[str, Leg] | None
_ONE_AT_A_TIME = threading.RLock()
_services: dict[object, MotionService] = {}


@dataclass(frozen=True)
class Scope:
    """What a worker needs to answer as the service does."""

    grid: OccupancyGrid | None
    planner: str
    margin: float
    seed: int
    digest: str
    tuning: MotionTuning
    proofs: bool

    @staticmethod
    def of(service: MotionService) -> Scope:
        """Return the scope of a service."""
        scene = service.scene
        settings = (service.grid, service.planner, scene.margin, service.seed)
        return Scope(*settings, scene.digest, service.tuning, service.proofs)

    def service(self) -> MotionService:
        """Return this process's own service of this scope."""
        key = (self.digest, self.planner, self.margin, self.seed, self.tuning, self.proofs)
        if key not in _services:
            while len(_services) >= MOST_SERVICES:
                del _services[next(iter(_services))]
            _services[key] = MotionService(
                self.grid,
                planner=self.planner,
                margin=self.margin,
                seed=self.seed,
                tuning=self.tuning,
                proofs=self.proofs,
            )
        return _services[key]


def find_legs(service: MotionService, queries: Sequence[LegQuery], seconds: float) -> list[Found]:
    """Return the legs for some queries, and whose they are."""
    deadline = Deadline.after(seconds)
    found: list[Found] = []
    for query in queries:
        ends = (query.start, query.goal)
        if deadline.expired() or service.certificate(query.body, ends, query.obstacles):
            found.append(None)
            continue
        leg = service.legs.find(query, deadline)
        found.append(None if isinstance(leg, PathReport) else leg)
    return found


def store_legs(service: MotionService, queries: Sequence[LegQuery], found: Sequence[Found]) -> int:
    """Put legs that were found elsewhere into a service's cache; return how many there are."""
    known = 0
    for query, leg in zip(queries, found, strict=True):
        if leg is not None:
            service.legs.remember(leg[0], query, leg[1])
            known += 1
    return known


def coordinate_group(
    service: MotionService, query: GroupQuery, seed: int, seconds: float
) -> tuple[GroupReport, bool]:
    """Return the report on a group, and whether its time was up."""
    deadline = Deadline.after(seconds)
    report = service.coordinate(query, deadline, seed=seed)
    return report, deadline.expired()


def work(scope: Scope, do: Callable[..., Answer], *given: object) -> Answer:
    """Return what ``do`` returns for this process's own service (what a worker does)."""
    with _ONE_AT_A_TIME:
        return do(scope.service(), *given)


@dataclass
class Crew:
    """Workers for the queries of one motion service."""

    workers: Workers
    service: MotionService
    scope: Scope = field(init=False)

    def __post_init__(self) -> None:
        self.scope = Scope.of(self.service)

    def _legs_of(self, queries: Sequence[PathQuery]) -> list[LegQuery]:
        """Return the legs of queries that any worker can plan, each once."""
        found: dict[object, LegQuery] = {}
        for query in queries:
            if can_be_sent(query.body):
                met = self.service.met_by(query.body, query.obstacles)
                for start, goal in zip(query.poses, query.poses[1:], strict=False):
                    leg = LegQuery(query.body, start, goal, met)
                    found.setdefault((query.body, start, goal, met), leg)
        return list(found.values())

    def plan_ahead(self, queries: Sequence[PathQuery], deadline: Deadline) -> int:
        """Find the legs of queries and put them into the service's cache, as far as time allows.
        Return how many were found.
        """
        todo = self._legs_of(queries)
        chunks = [todo[i : i + CHUNK] for i in range(0, len(todo), CHUNK)]
        answers = self._answers(find_legs, [(c,) for c in chunks], [deadline] * len(chunks))
        return sum(
            store_legs(self.service, chunk, found)
            for chunk, found in zip(chunks, answers, strict=True)
            if found is not None
        )

    def coordinate(
        self,
        queries: Sequence[GroupQuery],
        deadlines: Sequence[Deadline],
        *,
        seed: int,
    ) -> list[tuple[GroupReport, bool] | None]:
        """Return the report on each group, and whether its time was up; None where there is none
        in time.
        """
        return self._answers(coordinate_group, [(q, seed) for q in queries], deadlines)

    def _answers(
        self,
        do: Callable[..., Answer],
        given: Sequence[tuple[object, ...]],
        deadlines: Sequence[Deadline],
    ) -> list[Answer | None]:
        """Return what ``do`` returns for each of ``given``, in this order."""
        tasks: list[WorkItem[Answer]] = [
            WorkItem(work, (self.scope, do, *one), partial(self._here, do, one), deadline.remaining)
            for one, deadline in zip(given, deadlines, strict=True)
        ]
        last = max((d.at for d in deadlines), default=0.0)
        return self.workers.answers(tasks, Deadline(last).remaining)

    def _here(self, do: Callable[..., Answer], given: tuple[object, ...], seconds: float) -> Answer:
        with _ONE_AT_A_TIME:  # this process may have workers on threads
            return do(self.service, *given, seconds)


def can_be_sent(body: Body) -> bool:
    """Return whether a body's motions can be planned by any worker: its shape is no file of this
    machine, its control law no function of this process.
    """
    return not (body.flies or body.mobility.own_law)
