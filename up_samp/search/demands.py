"""What a problem demands, part by part: what an explanation may take out to see what it is for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from unified_planning.model import FNode, TimeInterval

from up_samp.upio import Relaxation


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
            activity.set_duration_bounds(activity.duration.lower, 1_000_000)
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
    for owner in (None, *sorted(relaxation.activities)):
        for index, (constraint, _) in enumerate(_chronicle(relaxation, owner)._constraints):
            yield Demand(owner, index, f"{constraint} is asked for")


def limits_on(relaxation: Relaxation, names: set[str]) -> Iterator[Demand]:
    """Yield the longest durations of activities and the constraints on their times."""
    yield from _longest(relaxation, names)
    for owner in (None, *sorted(relaxation.activities)):
        for index, (constraint, _) in enumerate(_chronicle(relaxation, owner)._constraints):
            if names & _mentioned(constraint):
                yield Demand(owner, index, f"{constraint} is asked for")


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
    found: set[str] = set()
    stack = [expression]
    while stack:
        node = stack.pop()
        stack.extend(node.args)
        if node.is_timing_exp() and node.timing().timepoint.container is not None:
            found.add(node.timing().timepoint.container)
    return found
