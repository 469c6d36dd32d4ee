"""Any UP scheduling engine behind one protocol: compile, run in a worker, map back, check."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Protocol

from up_samp.model import (
    CandidateSchedule,
    Deadline,
    ProblemError,
    ScheduleReport,
    UnsupportedError,
)
from up_samp.scheduling.quirks import is_compatible, known_engines, no_engine

if TYPE_CHECKING:
    from unified_planning.model.scheduling import SchedulingProblem

    from up_samp.scheduling.engine_scheduler import Check


class Scheduler(Protocol):
    """What the search asks for schedules."""

    def solve(
        self,
        deadline: Deadline,
        *,
        optimal: bool = True,
        hint: CandidateSchedule | None = None,
        lower_bound: int | Fraction | None = None,
    ) -> ScheduleReport:
        """Schedule the problem as it is now (it may have grown since the last call)."""
        ...

    def close(self) -> None:
        """End whatever processes the scheduler keeps."""
        ...


def open_scheduler(
    engine: Any,
    problem: SchedulingProblem,
    *,
    params: Mapping[str, Any] | None = None,
    seed: int = 0,
    check: Check | None = None,
    environment: Any = None,
) -> Scheduler:
    """Return a scheduler for ``problem`` that runs ``engine`` (a UP engine class, or the name of
    one that is registered in ``environment``, by default the problem's).

    ``check`` judges every schedule against the problem as given and returns violations; a
    schedule that fails is reported as an error, never returned. ``params`` go to the engine.
    ``seed`` is for engines that take one.

    Raises:
        ProblemError: no such engine.
        UnsupportedError: the engine cannot schedule, or not be started in another process.
    """
    if engine == "cpsat" or getattr(engine, "has_sessions", False):
        from up_samp.scheduling.cpsat import CpsatSession

        session: Any = CpsatSession(problem, seed=seed, **(params or {}))
        return session
    from up_samp.scheduling.engine_scheduler import EngineScheduler  # and all compilers

    cls = _engine_class(engine, environment or problem.environment)
    return EngineScheduler(cls, problem, params or {}, check)


def _engine_class(engine: Any, environment: Any) -> Any:
    if isinstance(engine, str):
        name = engine
        if name in environment.factory.engines:
            engine = environment.factory.engine(name)
        else:
            known = {n: (module, cls) for n, module, cls in known_engines()}
            if name not in known:
                raise ProblemError(no_engine(name, {*known, *environment.factory.engines}))
            engine = getattr(importlib.import_module(known[name][0]), known[name][1])
    reason = is_compatible(engine)
    if reason is not True:
        raise UnsupportedError(f"engine {engine.__name__} cannot be a scheduler: {reason}")
    if engine.__module__ == "__main__" or "<locals>" in engine.__qualname__:
        raise UnsupportedError(
            f"engine {engine.__qualname__} runs in a process of its own: move it to a module "
            "that can be imported"
        )
    return engine
