"""Conditions over intervals that may be empty, for engines that do not take those as asking
nothing.

Where the duration decides whether the interval holds an instant, the condition moves to an
auxiliary optional activity that spans just the interval and is present if that is not empty.
"""

from __future__ import annotations

from dataclasses import replace

from up_samp.model import CandidateSchedule
from up_samp.scheduling.compilers.expressions import (
    TRUE,
    Expr,
    conjunction,
    disjunction,
    end,
    implies,
    integer,
    negation,
    start,
    subexpressions,
)
from up_samp.scheduling.compilers.fresh import fresh, names_in_use
from up_samp.scheduling.compilers.ground import least, never_empty
from up_samp.scheduling.compilers.limits import LIMITS
from up_samp.scheduling.compilers.plain import Activity, Compiled, Condition, PlainProblem


def compile_intervals(problem: PlainProblem) -> Compiled:
    """Make every interval hold an instant.

    The result is not exact (``Compiled.exact``) where the condition's activity changes the same
    fluent itself: there the interval is just demanded not to be empty. Nor is it where an
    interval may begin before time 0, or be empty towards the plan's end.
    """
    compiler = _Compiler(problem)
    for condition in problem.conditions:
        compiler.add(condition)
    return compiler.result()


class _Compiler:
    def __init__(self, problem: PlainProblem):
        self.problem = problem
        self.taken = names_in_use(problem)
        self.activities = list(problem.activities)
        self.conditions: list[Condition] = []
        self.constraints = list(problem.constraints)
        self.added: set[str] = set()
        self.exact = True

    def add(self, condition: Condition) -> None:
        """Add a condition, moved to a host where it has to be."""
        if condition.low[3] < 0 and condition.low[1] in ("start", "end"):
            self.exact = False  # before 0 the initial value counts; engines refuse such times
        if never_empty(self.problem, condition):
            self.conditions.append(condition)
        elif "horizon" in (condition.low[1], condition.high[1]):
            self.exact = False  # there engines look at an end of an empty interval
            self.conditions.append(condition)
        elif not self._always_empty(condition):
            if self._changes_itself(condition):
                self.exact = False
                self._demand(condition)
                self.conditions.append(condition)
            else:
                self._host(condition)

    def result(self) -> Compiled:
        """Return the compiled problem."""
        problem = replace(
            self.problem,
            activities=tuple(self.activities),
            conditions=tuple(self.conditions),
            constraints=tuple(self.constraints),
        )

        def map_back(schedule: CandidateSchedule) -> CandidateSchedule:
            times = {a: t for a, t in schedule.times.items() if a not in self.added}
            return CandidateSchedule(times, schedule.parameters)

        return Compiled(problem, map_back, exact=self.exact)

    def _always_empty(self, condition: Condition) -> bool:
        gap = least(self.problem, condition.high, condition.low)
        return gap is not None and gap >= 1

    def _changes_itself(self, condition: Condition) -> bool:
        read = {e[1] for e in subexpressions(condition.expression) if e[0] == "flu"}
        return any(e.owner == condition.owner and e.fluent[1] in read for e in self.problem.effects)

    def _present(self, condition: Condition) -> Expr:
        optional = self.problem.optional_names()
        return ("pres", condition.owner) if condition.owner in optional else TRUE

    def _demand(self, condition: Condition) -> None:
        not_empty = ("le", condition.low, condition.high)
        self.constraints.append(implies(self._present(condition), not_empty))

    def _host(self, condition: Condition) -> None:
        name = fresh(f"span_{condition.owner or 'base'}", self.taken)
        self.added.add(name)
        upper = self.problem.activity(condition.owner).upper if condition.owner else None
        # an open end: no longer than the owner plus what the delays add
        most = abs(condition.low[3]) + abs(condition.high[3])
        length = upper[1] + most if upper is not None and upper[0] == "int" else LIMITS.span
        self.activities.append(Activity(name, True, integer(0), integer(length)))
        here, owner = ("pres", name), self._present(condition)
        empty = ("lt", condition.high, condition.low)
        self.constraints += [
            disjunction([here, negation(owner), empty]),
            implies(here, conjunction([owner, ("le", condition.low, condition.high)])),
            implies(
                here,
                conjunction(
                    [
                        ("le", start(name), condition.low),
                        ("le", condition.low, start(name)),
                        ("le", end(name), condition.high),
                        ("le", condition.high, end(name)),
                    ]
                ),
            ),
        ]
        self.conditions.append(Condition(start(name), end(name), condition.expression, name))
