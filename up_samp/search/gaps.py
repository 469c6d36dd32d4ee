"""Units that a robot surely does nothing, between one activity and the next.

Where all that a robot does holds one resource for one, its activities come one after the other,
each with one direct predecessor and one direct successor. If each that it may have has to keep some
units away, so much time passes in which the robot does nothing. Constraints ask for that, and
effects that are seen a unit later.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import Timing

Gaps = Mapping[tuple[str, str], int]
"""(a, b) -> units that are between the end of a and the start of b at least, if both are there."""
Gap = Callable[[str, str], int]


def gaps_told(problem: SchedulingMotionProblem) -> dict[tuple[str, str], int]:
    """Return what constraints say of the end of one activity and the start of another one.

    Assumes: a comparison is conditional on the two activities alone, or on nothing.
    """
    found: dict[tuple[str, str], int] = {}
    for owner in (problem._base, *problem.activities):
        for constraint, scope in owner._constraints:
            told = _told(constraint)
            if told is None:
                continue
            first, then, units = told
            needed = {s.presence().container if _is_presence(s) else None for s in scope}
            needed |= {owner.name} if owner is not problem._base else set()
            if needed <= {first, then} and units >= 0:
                found[first, then] = max(units, found.get((first, then), 0))
    return found


def orders_told(
    problem: SchedulingMotionProblem, *, strictly: bool = False
) -> set[tuple[str, str]]:
    """Return pairs of activities of which one ends before the other starts, as constraints say
    (``strictly``: and not when the other one starts).
    """
    return {pair for pair, units in gaps_told(problem).items() if units >= int(strictly)}


def _is_presence(node: FNode) -> bool:
    return bool(node.node_type is Op.PRESENT_EXP)


def _told(constraint: FNode) -> tuple[str, str, int] | None:
    if constraint.node_type not in (Op.LE, Op.LT):
        return None
    if not all(argument.is_timing_exp() for argument in constraint.args):
        return None
    end, start = (argument.timing() for argument in constraint.args)
    first, then = end.timepoint.container, start.timepoint.container
    if not (first and then and end.is_from_end() and start.is_from_start()):
        return None
    delays = _delay(end), _delay(start)
    if None in delays:
        return None
    assert delays[0] is not None
    assert delays[1] is not None
    return first, then, delays[0] - delays[1] + (constraint.node_type is Op.LT)


def _delay(timing: Timing) -> int | None:
    return timing.delay if isinstance(timing.delay, int) else None


def held_by(problem: SchedulingMotionProblem) -> dict[str, frozenset[FNode]]:
    """Return by activity the resources of one unit that it alone holds from its start to its end.

    Nobody else may give or take them otherwise.

    Assumes: nobody gives or takes a resource but by a pair of effects from a start to an end.
    """
    held = {a.name: _held(a) for a in problem.activities}
    other = {effect.fluent.fluent() for _, effect in problem.base_effects}
    for activity in problem.activities:
        for effects in activity.effects.values():
            other |= {e.fluent.fluent() for e in effects if e.fluent not in held[activity.name]}
    return {
        name: frozenset(resource for resource in some if resource.fluent() not in other)
        for name, some in held.items()
    }


def _held(activity: Activity) -> list[FNode]:
    """Return the resources that an activity takes first and gives back."""
    taken: dict[FNode, list[bool]] = defaultdict(list)
    for timing, effects in activity.effects.items():
        for effect in effects:
            tpe = effect.fluent.type
            one = tpe.is_int_type() and (tpe.lower_bound, tpe.upper_bound) == (0, 1)
            plain = one and not timing.delay and effect.condition.is_true()
            plain = plain and effect.value.is_int_constant() and effect.value.constant_value() == 1
            # a parameter of its own would be another object elsewhere
            plain = plain and all(argument.is_object_exp() for argument in effect.fluent.args)
            takes = plain and effect.is_decrease() and timing.is_from_start()
            gives = plain and effect.is_increase() and timing.is_from_end()
            # what is neither is no pair
            taken[effect.fluent] += [takes] if takes or gives else [True, True]
    return [resource for resource, some in taken.items() if sorted(some) == [False, True]]


def idle_between(
    name: str, others: Iterable[str], needs: frozenset[str], gaps: Gaps, gap: Gap, *, after: bool
) -> int:
    """Return units in which a robot does nothing, right before it begins an activity, or right
    ``after`` it.

    Assumes: all that may come right before or after is named, and the robot does one thing at a
    time.

    :param others: all that may come right before it (or after it), as far as places tell.
    :param needs: what has to be present with the activity.
    :param gaps: of all that is told between these.
    :param gap: what is between two activities at least, of which the second comes right after.
    """
    along = {n for n in needs if ((name, n) if after else (n, name)) in gaps}
    if not along:
        return 0  # it may be the first, or the last, of all
    least: int | None = None
    for other in others:
        pair = (name, other) if after else (other, name)
        if other == name or pair[::-1] in gaps:
            continue
        if any(((n, other) if after else (other, n)) in gaps for n in along):
            continue  # something has to be between the two
        units = gap(*pair)
        least = units if least is None else min(least, units)
        if not least:
            break
    return least or 0


def closed(gaps: Gaps, names: Collection[str]) -> dict[tuple[str, str], int]:
    """Return the gaps between a few activities that are all there if one of them is, with those
    that follow over what lies between.
    """
    pairs = itertools.permutations(sorted(names), 2)
    found = {pair: gaps[pair] for pair in pairs if pair in gaps}
    for between, first, then in itertools.product(sorted(names), repeat=3):
        if (first, between) in found and (between, then) in found:
            found.setdefault((first, then), 0)
    return found
