"""What a robot has to end before it begins anything else: it carries one thing at a time.

A Boolean fluent says that the robot is free. Whoever takes something asks for that and ends it,
whoever gives it away brings it back. So between taking a thing and giving it away nothing else is
taken or given.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import Activity

from up_samp.search.gaps import Gaps


def carried(
    problem: SchedulingMotionProblem, needs: Mapping[str, frozenset[str]], gaps: Gaps
) -> dict[str, tuple[str, FNode]]:
    """Return by activity that gives something away which one takes it, and the fluent that says
    that nothing else is taken or given in between (by those who set that fluent, if they are done
    one after the other).
    """
    takers, givers = defaultdict[FNode, set[str]](set), defaultdict[FNode, set[str]](set)
    wild = {effect.fluent.fluent().name for _, effect in problem.base_effects}
    asked = {a.name: set(_asked(a)) for a in problem.activities}
    for activity in problem.activities:
        for fluent, value in _set(activity):
            name = activity.name
            if value is None or (value is False and fluent not in asked[name]):
                wild.add(fluent.fluent().name)
            (givers if value else takers)[fluent].add(name)
    found: dict[str, tuple[str, FNode]] = {}
    for fluent, giving in givers.items():
        pairs = {
            giver: taker
            for giver in giving
            for taker in needs.get(giver, frozenset()) & takers[fluent]
            if giver in needs.get(taker, frozenset()) and (taker, giver) in gaps
        }
        each = len(pairs) == len(giving) == len(takers[fluent]) == len(set(pairs.values()))
        if each and not giving & takers[fluent] and fluent.fluent().name not in wild:
            found |= {giver: (taker, fluent) for giver, taker in pairs.items()}
    return found


def _asked(activity: Activity) -> Iterator[FNode]:
    """Yield the fluents that have to be true when an activity starts."""
    for interval, conditions in activity.conditions.items():
        lower = interval.lower
        if not interval.is_left_open() and lower.is_from_start() and not lower.delay:
            yield from (c for c in conditions if c.is_fluent_exp())


def _set(activity: Activity) -> Iterator[tuple[FNode, bool | None]]:
    """Yield the Boolean fluents that an activity sets at its end (or a unit before), and to what;
    None: to something else, or otherwise.
    """
    for timing, effects in activity.effects.items():
        at_end = timing.is_from_end() and timing.delay in (0, -1)
        for effect in effects:
            if not effect.fluent.type.is_bool_type():
                continue
            plain = at_end and effect.is_assignment() and effect.condition.is_true()
            plain &= effect.value.is_bool_constant()
            plain &= all(a.is_object_exp() for a in effect.fluent.args)
            yield effect.fluent, effect.value.bool_constant_value() if plain else None
