"""Why there is no schedule: which few facts leave none, and what of the problem they meet.

Facts are left out as long as there is still no schedule (QuickXplain, Junker 2004). Our own
scheduler judges, whatever engine is wrapped: its "infeasible" is a proof.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from unified_planning.model import FNode, TimeInterval
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import (
    CandidateSchedule,
    Deadline,
    ScheduleReport,
    ScheduleStatus,
    UnsupportedError,
)
from up_samp.model.refinement import (
    Layer,
    Refinement,
)
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.budget import Budget
from up_samp.tuning import Tuning
from up_samp.upio import Relaxation, write_refinement
from up_samp.upio.expressions import walk
from up_samp.upio.objective import Number


@dataclass(frozen=True)
class Demand:
    """A constraint, a condition or a longest duration of the problem. ``owner`` is its activity
    (``None``: the problem itself), ``place`` where it stands there; ``text`` says it.
    """

    owner: str | None
    place: int | tuple[TimeInterval, int] | None
    """A constraint's index, a condition's interval and index, or None for a longest duration."""
    text: str

    def lift(self, relaxation: Relaxation) -> None:
        """Take the demand out of a fresh relaxation."""
        true = relaxation.problem.environment.expression_manager.TRUE()
        if self.place is None:
            assert self.owner is not None
            activity = relaxation.activities[self.owner]
            upper = max(1_000_000, activity.duration.upper.constant_value())
            activity.set_duration_bounds(activity.duration.lower, upper)
        elif isinstance(self.place, int):
            _chronicle(relaxation, self.owner)._constraints[self.place] = (true, [])
        else:
            span, index = self.place
            _chronicle(relaxation, self.owner).conditions[span][index] = true


def demands(relaxation: Relaxation) -> Iterator[Demand]:
    """Yield all that a problem demands.

    Assumes: a demand is a part of the problem as it is written; to lift it only adds schedules.
    """
    yield from _conditions(relaxation)
    yield from _longest(relaxation, set(relaxation.activities))
    yield from (demand for demand, _ in _constraints(relaxation))


def limits_on(relaxation: Relaxation, names: set[str]) -> Iterator[Demand]:
    """Yield the longest durations of activities and the constraints on their times."""
    yield from _longest(relaxation, names)
    yield from (demand for demand, node in _constraints(relaxation) if names & _mentioned(node))


def _constraints(relaxation: Relaxation) -> Iterator[tuple[Demand, FNode]]:
    for owner in (None, *sorted(relaxation.activities)):
        for index, (constraint, _) in enumerate(_chronicle(relaxation, owner)._constraints):
            yield Demand(owner, index, f"{constraint} is asked for"), constraint


def _longest(relaxation: Relaxation, names: set[str]) -> Iterator[Demand]:
    for name in sorted(names & set(relaxation.activities)):
        upper = relaxation.activities[name].duration.upper
        if upper.is_int_constant():
            yield Demand(name, None, f"{name} may last {upper} at most")


def _conditions(relaxation: Relaxation) -> Iterator[Demand]:
    objects = {fluent.fluent().name: name for name, fluent in relaxation.state.items()}
    for owner in (None, *sorted(relaxation.activities)):
        for span, conditions in _chronicle(relaxation, owner).conditions.items():
            for index, condition in enumerate(conditions):
                said = _place(condition, objects, relaxation.snapshot.initial) or str(condition)
                who = "the problem" if owner is None else owner
                yield Demand(owner, (span, index), f"{who} needs {said}")


def _place(condition: FNode, objects: dict[str, str], initial: Any) -> str | None:
    """Return "r0 at dock" for a condition on where an object is."""
    if not condition.is_equals():
        return None
    left, right = condition.args
    name = objects.get(left.fluent().name) if left.is_fluent_exp() else None
    if name is None:
        return None
    return f"{name} at {right} ({name} begins at {initial[name]})"


def _chronicle(relaxation: Relaxation, owner: str | None) -> Any:
    return relaxation.problem._base if owner is None else relaxation.activities[owner]


def _mentioned(expression: FNode) -> set[str]:
    """Return the activities whose start or end an expression speaks of."""
    times = (node.timing().timepoint for node in walk(expression) if node.is_timing_exp())
    return {point.container for point in times if point.container is not None}


SHOWN = 5
"""So many facts are listed in a message."""
_LIMITS = 40
"""Constraints of the problem that are looked at to tell what the facts run into."""
_DEMANDS = 300
"""Demands of the problem that are looked at where no motion is to blame."""

T = TypeVar("T")


@dataclass(frozen=True)
class Prover:
    """Asks our own scheduler about the relaxation with some facts and nothing else."""

    relax: Callable[[], Relaxation]
    budget: Budget
    seed: int
    tuning: Tuning = field(default_factory=Tuning)
    plain: bool = False
    """Nothing is recognised in the problem."""

    def leaves_nothing(self, facts: Sequence[Refinement]) -> bool | None:
        """Return whether the facts alone leave no schedule (None: not known)."""
        report = self._schedule(facts, (), self.budget.part("proof"))
        if report is None or (report.schedule is None and not _none_left(report)):
            return None
        return _none_left(report)

    def sooner_than(self, facts: Sequence[Refinement], makespan: int) -> bool:
        """Return whether there is a schedule that ends before ``makespan``, with all that is in
        play, in little time: an engine that says there is none was told another problem, or is
        wrong.
        """
        deadline = self.budget.part("doubt")
        report = self._schedule(facts, (), deadline, before=makespan)
        return report is not None and report.schedule is not None

    def bound_by(self, facts: Sequence[Refinement], best: CandidateSchedule) -> Number | None:
        """Return a lower bound on what a schedule costs with these facts alone (None: not found);
        ``best`` is one of them.
        """
        deadline = self.budget.part("bound by proven facts")
        if deadline.expired():
            return None
        session = self._session(self.problem_with(facts))
        try:
            return session.solve(deadline, hint=best).bound
        except UnsupportedError:
            return None

    def few_of(
        self, facts: Sequence[Refinement], given: Sequence[Refinement] = ()
    ) -> list[Refinement]:
        """Return few of the ``facts`` that leave no schedule (with those ``given``), as all of them
        do: as few as can be where time allows.
        """
        deadline = self.budget.part("why there is no schedule")
        # those first that one would rather be told
        ordered = sorted(facts, key=lambda r: (r.layer is Layer.BOUND, r.layer is Layer.GROUP))

        def fails(some: Sequence[Refinement]) -> bool:
            return self._infeasible([*given, *some], (), deadline)

        # of thousands of facts, it is one place that nobody can reach most often
        alone = [r for r in ordered if r.layer is Layer.GEOMETRIC]
        return _fewest(alone if len(alone) < len(ordered) and fails(alone) else ordered, fails)

    def because(self, facts: Sequence[Refinement]) -> str:
        """Return few of the proven ``facts`` that leave no schedule, with what they run into, as
        text. All of them together leave none.
        """
        few = self.few_of(facts)
        if not few:
            met = self._met((), list(demands(self.relax())), _DEMANDS)
            text = "the activities cannot be scheduled, whatever the motions"
            return f"{text}: {' and '.join(met)}" if met else text
        text = "these proven facts leave no schedule: " + listed(few)
        names = {a for fact in few for a in fact.statement.activities}
        limits = self._met(few, list(limits_on(self.relax(), names)), _LIMITS)
        return f"{text}; but {' and '.join(limits)}" if limits else text

    def _met(self, facts: Sequence[Refinement], asked: Sequence[Demand], most: int) -> list[str]:
        """Return those of the demands without which there would be a schedule in spite of the
        facts, if there are no more than ``most`` to look at.
        """
        if not asked or len(asked) > most:
            return []
        deadline = self.budget.part("why there is no schedule")
        places = range(len(asked))

        def fails(kept: Sequence[int]) -> bool:  # to compare demands takes longer than all else
            lifted = [asked[place] for place in sorted({*places} - {*kept})]
            return self._infeasible(facts, lifted, deadline)

        met = _fewest(places, fails)
        return [] if deadline.expired() else [asked[place].text for place in met]

    def _infeasible(
        self, facts: Sequence[Refinement], lifted: Sequence[Demand], deadline: Deadline
    ) -> bool:
        """Return whether it is proven that nothing is left; ``lifted`` demands do not count."""
        report = self._schedule(facts, lifted, deadline)
        return report is not None and _none_left(report)

    def _schedule(
        self,
        facts: Sequence[Refinement],
        lifted: Sequence[Demand],
        deadline: Deadline,
        *,
        before: int | None = None,
    ) -> ScheduleReport | None:
        """Return what our own scheduler says of the problem with these facts; None if it cannot."""
        if deadline.expired():
            return None
        problem = self.problem_with(facts, lifted)
        if before is not None:
            manager = problem.environment.expression_manager
            for activity in problem.activities:
                activity.add_constraint(manager.LT(activity.end, before))
        session = self._session(problem)
        try:
            return session.solve(deadline, optimal=False)
        except UnsupportedError:  # another engine may do what ours does not: no proof then
            return None

    def _session(self, problem: SchedulingProblem) -> CpsatSession:
        return CpsatSession(
            problem, seed=self.seed, workers=1, tuning=self.tuning, plain=self.plain
        )

    def problem_with(
        self, facts: Sequence[Refinement], lifted: Sequence[Demand] = ()
    ) -> SchedulingProblem:
        """Return the relaxation's problem with the facts, and without the ``lifted`` demands."""
        relaxation = self.relax()
        for demand in lifted:
            demand.lift(relaxation)
        for fact in facts:
            write_refinement(relaxation, fact)
        return relaxation.problem


def listed(facts: Sequence[Refinement]) -> str:
    """Return refinements as text: what is stated, and why (once for all of which it is said)."""
    stated: dict[str, set[str]] = {}
    for fact in facts:
        stated.setdefault(fact.why, set()).add(str(fact.statement))
    lines = []
    for why, some in stated.items():
        others = f", as {len(some) - 1} more" if len(some) > 1 else ""
        lines.append(f"{min(some)} ({why}{others})")
    lines.sort()
    more = f" (and {len(lines) - SHOWN} more)" if len(lines) > SHOWN else ""
    return "; ".join(lines[:SHOWN]) + more


def _none_left(report: ScheduleReport) -> bool:
    return report.status is ScheduleStatus.INFEASIBLE


def _fewest(items: Sequence[T], fails: Callable[[Sequence[T]], bool]) -> list[T]:
    """Return a smallest (not least) part of ``items`` that fails, as all of them do; an answer
    "no" that is only a lack of time makes it larger, not wrong. Earlier ones are kept rather.
    """

    def search(held: list[T], grown: bool, rest: list[T]) -> list[T]:
        if grown and fails(held):
            return []
        if len(rest) <= 1:
            return rest
        half = len(rest) // 2
        second = search(held + rest[:half], True, rest[half:])
        first = search(held + second, bool(second), rest[:half])
        return first + second

    return search([], True, list(items))
