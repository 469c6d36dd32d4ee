"""A UP engine as a scheduler: the compilers that it needs, in order; run in a worker process,
mapped back, checked.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from up_samp.model import (
    CandidateSchedule,
    Deadline,
    EngineError,
    ScheduleReport,
    ScheduleStatus,
    UnsupportedError,
    check_time,
)
from up_samp.scheduling.compilers.constraints import (
    compile_differences,
    compile_products,
    compile_resources,
    compile_rules,
)
from up_samp.scheduling.compilers.fluents import (
    compile_flat_types,
    compile_greatest,
    compile_ground,
    compile_instances,
    compile_least,
    compile_precedences,
    compile_unused,
)
from up_samp.scheduling.compilers.intervals import (
    compile_dense,
    compile_intervals,
    compile_stillness,
    compile_support,
    refuse_numbers,
    refuse_times,
)
from up_samp.scheduling.compilers.optional import (
    compile_anchor,
    compile_optional,
)
from up_samp.scheduling.compilers.plain import Compiled, PlainProblem, some_value
from up_samp.scheduling.compilers.translate import read_plain
from up_samp.scheduling.process import OverrunError, WorkerProcess
from up_samp.scheduling.quirks import Quirks, quirks_of
from up_samp.scheduling.worker import WorkerAnswer, WorkerTask
from up_samp.upio.plan import build_schedule

if TYPE_CHECKING:
    from unified_planning.model.scheduling import SchedulingProblem
    from unified_planning.plans import Schedule


Compiler = Callable[[PlainProblem], Compiled]


_PASSES: tuple[tuple[Compiler, str], ...] = (
    (compile_rules, ""),
    (compile_ground, ""),
    (refuse_times, "times_of_others"),
    (compile_dense, ""),
    (compile_stillness, ""),
    (compile_support, ""),
    (compile_flat_types, "hierarchical_types"),
    (compile_instances, "assignments"),
    (compile_precedences, "assignments"),
    (refuse_numbers, "intervals_of_numbers"),
    (compile_resources, "resources_with_variable_durations"),
    (compile_intervals, "empty_intervals"),
    (compile_differences, ""),
    (compile_products, "products"),
    (compile_optional, "optional"),
    (compile_least, "without_least"),
    (compile_greatest, "without_greatest"),
    (compile_anchor, ""),
    (compile_unused, ""),
)
"""All passes, in order, each with what of ``Quirks`` makes it needless."""


def compilers_for(quirks: Quirks) -> list[Compiler]:
    """Return the passes, in order, that make a problem fit an engine."""
    return [run for run, able in _PASSES if not (able and getattr(quirks, able))]


def chain(problem: PlainProblem, passes: Sequence[Compiler]) -> Compiled:
    """Run the passes one after the other."""
    presence: dict[str, str] = {}
    floor, exact = 0, True
    for compiler in passes:
        check_time()
        compiled = compiler(problem)
        problem, floor = compiled.problem, max(floor, compiled.floor)
        exact = exact and compiled.exact
        presence |= compiled.presence
    return Compiled(problem, presence, floor, exact)


def restored(
    original: PlainProblem, compiled: Compiled, schedule: CandidateSchedule
) -> CandidateSchedule:
    """Return a schedule of a compiled problem as one of the original, with some value for each
    variable that has none: engines leave out those that nothing constrains.

    Raises:
        LookupError: an activity that has to be there, or what says whether it is, is missing.
    """
    absent = {a for a, p in compiled.presence.items() if not schedule.parameters[p]}
    absent |= original.optional_names - schedule.times.keys()
    here = [a for a in original.activities if a.name not in absent]
    variables = [*original.variables.items(), *(p for a in here for p in a.parameters)]
    given = schedule.parameters
    return CandidateSchedule(
        {a.name: schedule.times[a.name] for a in here},
        {n: given[n] if n in given else some_value(original, t)[1] for n, t in variables},
    )


# ------------------ An engine as a scheduler


Check = Callable[["SchedulingProblem", "Schedule"], list[str]]


_STATUSES = {
    "SOLVED_OPTIMALLY": ScheduleStatus.OPTIMAL,
    "SOLVED_SATISFICING": ScheduleStatus.FOUND,
    "INTERMEDIATE": ScheduleStatus.FOUND,
    "UNSOLVABLE_PROVEN": ScheduleStatus.INFEASIBLE,
    "UNSOLVABLE_INCOMPLETELY": ScheduleStatus.NOT_FOUND,
    "TIMEOUT": ScheduleStatus.OUT_OF_TIME,
}


class EngineScheduler:
    """Runs a UP engine on the compiled problem, in a worker process.

    The worker lives until :meth:`close`. ``hint`` is not used: the engines at hand either take
    none or were not faster with one.
    """

    def __init__(
        self,
        engine: Any,
        problem: SchedulingProblem,
        params: Mapping[str, Any],
        check: Check | None,
    ):
        self._engine = engine
        self._problem = problem
        self._params = dict(params)
        self._check = check
        self._quirks = quirks_of(engine)
        self._worker: WorkerProcess | None = WorkerProcess()  # starts while we compile

    @property
    def name(self) -> str:
        """The engine's class name."""
        return str(self._engine.__name__)

    def solve(
        self,
        deadline: Deadline,
        *,
        optimal: bool = True,
        hint: CandidateSchedule | None = None,
        lower_bound: int | Fraction | None = None,
        part: SchedulingProblem | None = None,
    ) -> ScheduleReport:
        """Schedule the problem as it is now, or a ``part`` of it instead.

        Raises:
            UnsupportedError: the problem cannot be compiled to what the engine can do.
        """
        started, problem = time.monotonic(), part or self._problem
        runner = self._engine if optimal else _satisficing(self._engine)
        try:
            original = read_plain(problem)
            compiled = chain(original, compilers_for(self._quirks))
        except UnsupportedError as error:
            raise UnsupportedError(f"engine {self.name}: {error}") from error
        if deadline.expired():
            return _report(ScheduleStatus.OUT_OF_TIME, lower_bound, started)
        # a prover that breaks down has a class beside it that seeks no proof
        for engine in dict.fromkeys((runner, _satisficing(runner))):
            task = self._task(engine, compiled.problem, deadline)
            try:
                answer = self._ready_worker().ask(task, deadline)
            except OverrunError:
                message = f"engine {self.name} did not stop at its deadline and was ended"
                return _report(ScheduleStatus.OUT_OF_TIME, lower_bound, started, message)
            except EngineError as error:
                message = f"engine {self.name}: {error}"
                return _report(ScheduleStatus.ERROR, lower_bound, started, message)
            if answer.status != "exception":
                break
        report = self._judge(answer, problem, original, compiled, lower_bound, started)
        late = task.until is not None and time.monotonic() > task.until
        if report.status is ScheduleStatus.NOT_FOUND and late:  # cpse calls a timeout so
            return replace(report, status=ScheduleStatus.OUT_OF_TIME)
        if report.status is ScheduleStatus.FOUND and (late or answer.status == "TIMEOUT"):
            return replace(report, late=True)  # aries-opt calls it satisficing
        return report

    def _task(self, runner: Any, problem: PlainProblem, deadline: Deadline) -> WorkerTask:
        quirks = quirks_of(runner)
        return WorkerTask(
            runner.__module__,
            runner.__qualname__,
            self._params,
            problem,
            _engine_stops(deadline),
            quirks.message_limit,
            dict(quirks.environment),
        )

    def _ready_worker(self) -> WorkerProcess:
        if self._worker is None or not self._worker.alive:
            if self._worker is not None:
                self._worker.close()
            self._worker = WorkerProcess()
        return self._worker

    def _judge(
        self,
        answer: WorkerAnswer,
        problem: SchedulingProblem,
        original: PlainProblem,
        compiled: Compiled,
        lower_bound: int | Fraction | None,
        started: float,
    ) -> ScheduleReport:
        """Turn the worker's answer into a report that can be believed."""
        if answer.status == "unsupported":
            raise UnsupportedError(f"engine {self.name}: {answer.message}")
        status = _STATUSES.get(answer.status, ScheduleStatus.ERROR)
        proven = self._quirks.proves_unsolvable and compiled.exact
        if status is ScheduleStatus.INFEASIBLE and not proven:
            status = ScheduleStatus.NOT_FOUND
        solved = status in (ScheduleStatus.OPTIMAL, ScheduleStatus.FOUND)
        if solved and answer.times is None:
            status = ScheduleStatus.ERROR
        if answer.status == "TIMEOUT" and answer.times is not None:
            status, solved = ScheduleStatus.FOUND, True  # the best until then
        if answer.times is None or not solved:
            message = f"engine {self.name}: {answer.status}. {answer.message}".strip()
            if answer.status == "exception":
                message = _broke_down(self.name, answer.message)
            return _report(status, lower_bound, started, message)
        try:
            found = CandidateSchedule(answer.times, answer.parameters)
            schedule = restored(original, compiled, found)
            wrong = self._violations(problem, schedule)
        except LookupError as error:
            wrong = [f"{error} is missing in it, or not in the problem"]
        if wrong:
            message = f"engine {self.name} returned a wrong schedule: {'; '.join(wrong)}"
            return _report(ScheduleStatus.ERROR, lower_bound, started, message)
        if status is ScheduleStatus.OPTIMAL:
            if self._proven(schedule, compiled):
                lower_bound = max(lower_bound or 0, schedule.makespan)
            else:
                status = ScheduleStatus.FOUND
        if compiled.problem.minimize_makespan and lower_bound == schedule.makespan:
            status = ScheduleStatus.OPTIMAL
        return ScheduleReport(
            status, schedule, lower_bound, answer.message, time.monotonic() - started
        )

    def _proven(self, schedule: CandidateSchedule, compiled: Compiled) -> bool:
        return (
            compiled.exact
            and compiled.problem.minimize_makespan
            and schedule.makespan > compiled.floor
        )

    def _violations(self, problem: SchedulingProblem, schedule: CandidateSchedule) -> list[str]:
        if self._check is None:
            return []
        return self._check(problem, build_schedule(problem, schedule))[:5]

    def close(self) -> None:
        """End the worker process."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def __enter__(self) -> EngineScheduler:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _satisficing(engine: Any) -> Any:
    """Return the engine class that finds a first schedule sooner, if there is one."""
    name = quirks_of(engine).satisficing
    # an engine derived from a known one lives elsewhere, and is asked itself
    return engine if name is None else getattr(sys.modules[engine.__module__], name, engine)


def _broke_down(engine: str, told: str) -> str:
    """Return an engine's breakdown for people: the fault is the engine's, the rest goes on."""
    what, _, where = told.partition("\n")
    place = where.strip().rpartition("File ")[2].replace("\n", " ")
    return (
        f"engine {engine} broke down on this problem ({what}; "
        f"{place.strip()}); another engine may solve it, such as cpsat"
    )


def _engine_stops(deadline: Deadline) -> float | None:
    """Return when the engine has to stop itself: early enough to read its answer in time."""
    if deadline.at == float("inf"):
        return None
    return deadline.moment - min(0.3, 0.1 * deadline.remaining()) - 0.02 * deadline.remaining()


def _report(
    status: ScheduleStatus, bound: int | Fraction | None, started: float, message: str = ""
) -> ScheduleReport:
    return ScheduleReport(status, None, bound, message, time.monotonic() - started)
