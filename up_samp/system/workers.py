"""Tasks done by workers behind any ``concurrent.futures.Executor``: threads, processes, a cluster.

Answers come in the order of the questions: it does not matter which worker was first. A lost worker
costs its tasks only: what it was to do is done by another one (Dask hands it on by itself) or here,
and the log says so. A ``ProcessPoolExecutor`` is lost with any of its processes, and refuses
whatever comes later; then all is done here.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Executor, Future
from concurrent.futures import TimeoutError as NotYet
from dataclasses import dataclass
from typing import Generic, TypeVar

Answer = TypeVar("Answer")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class WorkItem(Generic[Answer]):
    """``do(*given, seconds)`` for a worker, ``here(seconds)`` for this process, with the same
    answer; ``remaining()`` are the seconds that are left for it.
    """

    do: Callable[..., Answer]
    given: tuple[object, ...]
    here: Callable[[float], Answer]
    remaining: Callable[[], float]


@dataclass
class Workers:
    """``lost``: tasks whose worker did not come back with an answer (they were done here). An
    answer is waited for ``leave`` s at least: it may be there already.
    """

    executor: Executor
    leave: float = 0.05
    lost: int = 0

    def answers(
        self, tasks: Sequence[WorkItem[Answer]], until: Callable[[], float]
    ) -> list[Answer | None]:
        """Return the tasks' answers in their order; None for what is not there in time.

        :param until: the seconds that are left to wait for all of them.
        """
        futures = [self._submit(task) for task in tasks]
        return [self._taken(f, t, until()) for f, t in zip(futures, tasks, strict=True)]

    def _submit(self, task: WorkItem[Answer]) -> Future[Answer] | None:
        try:
            return self.executor.submit(task.do, *task.given, task.remaining())
        except Exception as error:  # a broken pool refuses tasks
            log.debug("the executor takes no task: %r", error)
            return None

    def _taken(
        self, future: Future[Answer] | None, task: WorkItem[Answer], seconds: float
    ) -> Answer | None:
        """Return a worker's answer, or this process's own where the worker is lost."""
        why: object = "the executor takes no more tasks"
        if future is not None:
            try:
                return future.result(None if seconds == float("inf") else max(self.leave, seconds))
            except NotYet:
                future.cancel()
                return None
            except (Exception, CancelledError) as error:
                why = error  # whatever ended the worker: a fault of the task comes up again here
        self.lost += 1
        level = logging.WARNING if self.lost == 1 else logging.DEBUG
        log.log(level, "a worker is lost (%r): what it was to do is done here", why)
        left = task.remaining()
        return None if left <= 0 else task.here(left)
