"""Preconditions that are said with precedences alone: by helpers, and rivals that may undo them.

``Or`` over each helper H: ``And(H.present, H.end <= A.start, and for each rival R:
Implies(R.present, Or(R.end <= H.start, R.start >= A.end)))``; and, where it holds at first, one
more alternative: ``And for each R: Implies(R.present, R.start >= A.end)`` (Tosello et al., ICAPS
2026). Here they are only read; whether they amount to a state variable depends on who never
overlaps, see :mod:`up_samp.scheduling.cpsat.encode.recognition`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model import check_time
from up_samp.scheduling.cpsat.normal.clauses import Constraint
from up_samp.upio.expressions import conjuncts, end_before_start

Before = tuple[str, str, int]
"""(a, b, gap): ``a.end + gap <= b.start``; gap 1 is written ``a.end < b.start``."""


@dataclass(frozen=True)
class Precondition:
    """``activity`` needs the last of its ``rivals`` and helpers before it to be a helper.

    ``helpers[h]`` are the rivals that must not come between h and the activity; ``initially`` are
    those that must not come before it if no helper does (``None``: a helper has to). ``gap`` is
    the greatest one written anywhere.
    """

    activity: str
    helpers: dict[str, frozenset[str]]
    initially: frozenset[str] | None
    gap: int
    constraint: Constraint


@dataclass(frozen=True)
class FollowUp:
    """After ``activity``, one of ``helpers`` has to come."""

    activity: str
    helpers: frozenset[str]
    gap: int


class PrecedenceReader:
    """Reads preconditions and follow-ups among constraints."""

    def __init__(self) -> None:
        self._befores: dict[int, Before | None] = {}
        self._presences: dict[int, str | None] = {}

    def read(
        self, constraints: Iterable[Constraint]
    ) -> tuple[list[Precondition], list[FollowUp], list[Constraint]]:
        """Return preconditions, follow-ups, and all constraints but the preconditions."""
        preconditions, follow_ups, others = [], [], []
        for constraint in constraints:
            check_time()
            found = self._read(constraint)
            if isinstance(found, Precondition):
                preconditions.append(found)
                continue
            if found is not None:
                follow_ups.append(found)
            others.append(constraint)
        return preconditions, follow_ups, others

    def _read(self, constraint: Constraint) -> Precondition | FollowUp | None:
        node, scope, _ = constraint
        if node.node_type is Op.IMPLIES and not scope:
            node, scope = node.arg(1), [node.arg(0)]
        if len(scope) != 1 or scope[0].node_type is not Op.PRESENT_EXP:
            return None
        activity = str(scope[0].presence().container)
        options = list(node.args) if node.node_type is Op.OR else [node]
        if any(o.node_type not in (Op.AND, Op.OR, Op.IMPLIES) for o in options):
            return None
        helpers: dict[str, frozenset[str]] = {}
        follow_ups: dict[str, int] = {}
        initially = None
        gap = 0
        for option in options:
            parts = conjuncts(option)
            helper = self._helper(parts)
            rest = [p for p in parts if p.node_type in (Op.OR, Op.IMPLIES)]
            order = [b for b in map(self._before, parts) if b is not None]
            if helper is None:
                rivals = self._rivals(rest, activity, None)
                if rivals is None or len(rest) < len(parts) or initially is not None:
                    return None
                initially, more = rivals
                gap = max(gap, more)
                continue
            if len(order) != 1 or len(rest) + 2 != len(parts):
                return None
            if order[0][:2] == (activity, helper) and not rest:
                follow_ups[helper] = order[0][2]
                continue
            rivals = self._rivals(rest, activity, helper)
            if order[0][:2] != (helper, activity) or rivals is None or helper in helpers:
                return None
            helpers[helper] = rivals[0]
            gap = max(gap, order[0][2], rivals[1])
        if follow_ups and not helpers and initially is None:
            return FollowUp(activity, frozenset(follow_ups), min(follow_ups.values()))
        if follow_ups or (not helpers and not initially):
            return None
        return Precondition(activity, helpers, initially, gap, constraint)

    def _helper(self, parts: list[FNode]) -> str | None:
        names = [str(self._present(p)) for p in parts if p.node_type is Op.PRESENT_EXP]
        return names[0] if len(names) == 1 else None

    def _rivals(
        self, parts: list[FNode], activity: str, helper: str | None
    ) -> tuple[frozenset[str], int] | None:
        """Return the rivals that keep away from helper and activity, and the greatest gap."""
        names, gap = set(), 0
        for part in parts:
            found = self._order(part)
            if found is None:
                return None
            absent, order = found
            after = [b[1] for b in order if b[0] == activity]
            if len(after) != 1 or (absent is not None and absent != after[0]):
                return None
            rival = after[0]
            for first, then, more in order:
                if first != activity and (first, then) != (rival, helper):
                    return None
                gap = max(gap, more)
            if len(order) != (1 if helper is None else 2):
                return None
            names.add(rival)
        return frozenset(names), gap

    def _order(self, part: FNode) -> tuple[str | None, list[Before]] | None:
        """Read "if it is there, one of these comes before the other"; there may be millions."""
        absent: set[str] = set()
        options = [part]
        if part.node_type is Op.IMPLIES:
            head, body = part.args
            name = self._present(head)
            if name is None:
                return None
            absent.add(name)
            options = body.args if body.node_type is Op.OR else [body]
        elif part.node_type is Op.OR:
            options = part.args
        order = []
        for option in options:
            before = self._before(option)
            if before is not None:
                order.append(before)
            elif option.node_type is Op.NOT and self._present(option.arg(0)) is not None:
                absent.add(str(self._present(option.arg(0))))
            elif option.node_type in (Op.OR, Op.IMPLIES):
                inner = self._order(option)
                if inner is None:
                    return None
                absent |= set() if inner[0] is None else {inner[0]}
                order += inner[1]
            else:
                return None
        return (next(iter(absent), None), order) if len(absent) <= 1 else None

    def _present(self, node: FNode) -> str | None:
        """Return whose presence ``node`` is."""
        key = node.node_id
        if key not in self._presences:
            known = node.node_type is Op.PRESENT_EXP
            self._presences[key] = str(node.presence().container) if known else None
        return self._presences[key]

    def _before(self, node: FNode) -> Before | None:
        key = node.node_id
        if key not in self._befores:
            found = end_before_start(node)
            self._befores[key] = found if found is not None and found[2] in (0, 1) else None
        return self._befores[key]
