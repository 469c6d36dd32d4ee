"""When a search is to stop, apart from its deadline: criteria that compose.

They are asked before every round, as PyVRP does (Wouda, Lan & Kool, 2024): ``FirstPlan() |
MaxRounds(50)``. A search also stops where nothing is left to be found.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from up_samp.model.errors import ProblemError, short
from up_samp.search.events import State

StopCriterion = Callable[[State], bool]
"""A stopping criterion: tells of a search's state whether it is to stop."""


def runtime_of(stop: StopCriterion | None) -> float:
    """Return the longest that a search may take (s) by a criterion."""
    return stop.runtime if isinstance(stop, Criterion) else math.inf


def _check(name: str, value: object, *, whole: bool = False, least: float = 0.0) -> None:
    kinds: tuple[type, ...] = (int,) if whole else (int, float)
    good = isinstance(value, kinds) and not isinstance(value, bool)
    if not good or not value >= least:  # type: ignore[operator]  # NaN is not
        kind = "a whole number" if whole else "a number"
        raise ProblemError(f"{name} needs {kind} of {least:g} or more, not {short(value)}")


class Criterion:
    """Base of the criteria here: ``a | b`` stops as soon as one of them does."""

    @property
    def runtime(self) -> float:
        """The longest that a search may take (s): it also ends what is under way."""
        return math.inf

    def __call__(self, state: State) -> bool:
        """Return whether the search is to stop."""
        raise NotImplementedError

    def __or__(self, other: StopCriterion) -> AnyOf:
        return AnyOf((self, other))


@dataclass(frozen=True)
class AnyOf(Criterion):
    """Stops as soon as one of several criteria does."""

    criteria: tuple[StopCriterion, ...]

    @property
    def runtime(self) -> float:
        """The least of all."""
        return min(map(runtime_of, self.criteria), default=math.inf)

    def __call__(self, state: State) -> bool:
        """Return whether one is met."""
        return any(c(state) for c in self.criteria)

    def __or__(self, other: StopCriterion) -> AnyOf:
        return AnyOf((*self.criteria, other))


@dataclass(frozen=True)
class MaxRuntime(Criterion):
    """Stops ``seconds`` after the start, like an engine's ``timeout``."""

    seconds: float

    def __post_init__(self) -> None:
        _check("MaxRuntime", self.seconds)

    @property
    def runtime(self) -> float:
        """The longest that a search may take (s)."""
        return self.seconds

    def __call__(self, state: State) -> bool:
        """Return whether the time is over."""
        return state.elapsed >= self.seconds


@dataclass(frozen=True)
class MaxRounds(Criterion):
    """Stops after so many candidate schedules."""

    rounds: int

    def __post_init__(self) -> None:
        _check("MaxRounds", self.rounds, whole=True, least=1)

    def __call__(self, state: State) -> bool:
        """Return whether so many were checked."""
        return state.rounds >= self.rounds


@dataclass(frozen=True)
class Gap(Criterion):
    """Stops when the best plan is at most this share worse than what is proven: with 0.1, a
    makespan of 100 where 90 is a lower bound.
    """

    share: float

    def __post_init__(self) -> None:
        _check("Gap", self.share)

    def __call__(self, state: State) -> bool:
        """Return whether the gap is small enough."""
        upper, lower = state.upper_bound, state.lower_bound
        if upper is None or lower is None:
            return False
        return float(upper - lower) <= self.share * abs(float(upper))


@dataclass(frozen=True)
class NoImprovement(Criterion):
    """Stops when there is a plan and none better came for so many rounds, or so many seconds."""

    rounds: int | None = None
    seconds: float = math.inf

    def __post_init__(self) -> None:
        _check("NoImprovement", self.seconds)
        if self.rounds is not None:
            _check("NoImprovement", self.rounds, whole=True, least=1)

    def __call__(self, state: State) -> bool:
        """Return whether it has been that long."""
        if state.last_plan_at is None or state.last_plan_round is None:
            return False
        stale = state.rounds - state.last_plan_round
        long = state.elapsed - state.last_plan_at >= self.seconds
        return long or (self.rounds is not None and stale >= self.rounds)


@dataclass(frozen=True)
class FirstPlan(Criterion):
    """Stops with the first plan."""

    def __call__(self, state: State) -> bool:
        """Return whether there is a plan."""
        return state.upper_bound is not None
