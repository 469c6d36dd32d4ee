"""Doors that the routing relaxation may open once: a constraint that loses none of its optima.

What opens a door again, where nothing shuts it, changes nothing. Take it out of a schedule: its
traveller goes on from the stop before to the stop after, which takes no longer (travel times obey
the triangle inequality, and whoever may not go directly is charged for a detour that the way by
the button was, too); what reads the door reads what the first opening set. Only something else that
an opening is good for could be missing, so there must be nothing of that kind.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator

from unified_planning.model import Effect, FNode, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import TimepointKind

from up_samp.scheduling.cpsat.normal.clauses import Constraint, split
from up_samp.scheduling.cpsat.problem import Additions
from up_samp.scheduling.cpsat.routing.openings import RoutedTask


def opened_once(parts: Additions, tasks: Iterable[RoutedTask]) -> list[Constraint]:
    """Return constraints on the presences of what opens doors; of each one, where that is needed,
    exactly one is there, else at most one.

    Assumes: an opening is good for nothing but its one door.
    """
    doors = [task for task in tasks if task.opens is not None]
    names = {name for task in doors for _, name, _ in task.ways}
    good = names & {a.name for a in parts.activities if a.optional}
    good -= _good_for_more(parts, good)
    activities = {a.name: a for a in parts.activities}
    found: list[Constraint] = []
    for task in doors:
        mine = [name for _, name, _ in task.ways]
        if good.issuperset(mine):
            found += _once([activities[name] for name in mine], needed=task.needed)
    return found


def _once(some: list[Activity], *, needed: bool) -> Iterator[Constraint]:
    manager = some[0].present.environment.expression_manager
    if needed:
        yield manager.Or([a.present for a in some]), [], None
    for a, b in itertools.combinations(some, 2):
        yield manager.Or(manager.Not(a.present), manager.Not(b.present)), [], None


def _good_for_more(parts: Additions, names: set[str]) -> set[str]:
    """Return which of ``names`` do more than change a fluent, or are wanted by a constraint."""
    more = {a.name for a, _ in parts.parameters}
    for constraint, _, _ in split(parts.constraints):
        more |= names & set(_asked_for(constraint))
    effects: dict[str, list[tuple[Timing, Effect]]] = {name: [] for name in names}
    for timing, effect, owner in parts.effects:
        if owner is not None and owner.name in names:
            effects[owner.name].append((timing, effect))
    for name, some in effects.items():
        if sum(effect.is_assignment() for _, effect in some) != 1 or not _gives_back(some):
            more.add(name)
    return more


def _asked_for(node: FNode) -> Iterator[str]:
    """Yield whose presence might make a constraint (in negation normal form) true."""
    if node.node_type is Op.PRESENT_EXP:
        yield str(node.presence().container)
    elif node.node_type is not Op.NOT or node.arg(0).node_type is not Op.PRESENT_EXP:
        for arg in node.args:
            yield from _asked_for(arg)


def _gives_back(effects: list[tuple[Timing, Effect]]) -> bool:
    """Return whether what is not assigned is taken at the start and given back in the end."""
    balance: Counter[FNode] = Counter()
    for timing, effect in effects:
        if effect.is_assignment():
            continue
        at_start = timing.timepoint.kind is TimepointKind.START
        if timing.delay != 0 or not effect.value.is_constant() or not effect.condition.is_true():
            return False
        if at_start != effect.is_decrease():
            return False
        amount = effect.value.constant_value()
        balance[effect.fluent] += -amount if at_start else amount
    return not any(balance.values())
