"""Which activities that move objects surely last a unit or more."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

from unified_planning.model import FNode

from up_samp.model.snapshot import MotionTask, Snapshot, TermKind

if TYPE_CHECKING:
    from up_samp.upio.relaxation import Relaxation


def find_lasting(relaxation: Relaxation) -> frozenset[str]:
    """Return the activities that last a unit or more, of those that move objects: their durations
    say so, or they drive something to another pose, which takes time. Where only the latter is
    the case, it is stated, too.
    """
    snapshot = relaxation.snapshot
    movers = {t.activity for t in snapshot.tasks} | {c.activity for c in snapshot.changes}
    long = {name for name in movers if _lasts(relaxation, name)}
    drives = {t.activity for t in snapshot.tasks if _leads_away(snapshot, t)} - long
    manager = relaxation.problem.environment.expression_manager
    for name in sorted(drives):
        activity = relaxation.activities[name]
        activity.add_constraint(manager.LE(manager.Plus(activity.start, 1), activity.end))
    return frozenset(long | drives)


def _lasts(relaxation: Relaxation, name: str) -> bool:
    duration = relaxation.activities[name].duration
    return _least(relaxation, duration.lower) + duration.is_left_open() >= 1


def _least(relaxation: Relaxation, node: FNode) -> int:
    """Return a whole number that an expression for a duration is never below (0: not known)."""
    if node.is_int_constant() or node.is_real_constant():
        return max(0, math.ceil(node.constant_value()))
    if node.is_plus():
        return sum(_least(relaxation, part) for part in node.args)
    if node.is_parameter_exp():
        bound = node.parameter().type.lower_bound
        return 0 if bound is None else max(0, int(bound))
    if node.is_fluent_exp() and node.fluent() not in relaxation.given_effects:
        values = [v for f, v in relaxation.given_values.items() if f.fluent() == node.fluent()]
        return min((_least(relaxation, v) for v in values), default=0)
    return 0


def _leads_away(snapshot: Snapshot, task: MotionTask) -> bool:
    """Return whether a drive surely comes to another pose than that from which it starts."""
    return any(
        a.kind is b.kind is TermKind.CONSTANT
        and snapshot.configurations[a.name] != snapshot.configurations[b.name]
        for a, b in itertools.pairwise(task.terms)
    )
