"""What clauses say of who comes first: someone who needs one of some others to have ended before.

``Or(not A.present, another value, And(H.present, H.end + k <= A.end), ...)`` asks no more than a
condition of A on a state that each H sets once and for all. Where a state variable tells just that
(a door that nobody shuts), it is that one; else there is a *milestone* for it. The clauses stay as
they are: what is found here constrains nothing, but routes are read off it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Cmp,
    Form,
    Lin,
    Literal,
    constant,
    value_told,
)
from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.encode.states import States

Value = tuple[int, int]
"""A variable (a parameter) and its value."""


@dataclass(frozen=True)
class Precedence:
    """``activity``, if it is there with these ``values``, needs one of ``helpers`` (by index) to
    have ended: ``helpers[h]`` before ``point``, a time of the activity.
    """

    activity: ActivityVars
    values: tuple[Value, ...]
    point: Lin
    helpers: Mapping[int, int]


def find_milestones(
    forms: Iterable[Form], states: States
) -> tuple[list[StateVar], dict[Key, list[Read]]]:
    """Return the milestones, and by state variable (of the problem, or a milestone) what clauses
    ask of it for those who move something.

    Assumes: what a helper has set nobody sets back, and the clause is about one activity at one of
    its times.
    """
    reader = _Reader(states)
    known = _set_for_good(states)
    made: dict[frozenset[int], StateVar] = {}
    reads: dict[Key, list[Read]] = {}
    for form in forms:
        found = reader.precedence(form)
        if found is None:
            continue
        helpers = frozenset(found.helpers)
        state = known.get(helpers) or made.get(helpers)
        if state is None:
            state = made[helpers] = _milestone(len(made), sorted(helpers), states)
        reads.setdefault(state.key, []).append(_read(found, state, states))
    return list(made.values()), reads


class _Reader:
    """Reads precedences off clauses."""

    def __init__(self, states: States) -> None:
        self._states = states
        self._movers = states.movers()
        self._by_time: dict[int, list[ActivityVars]] = {}
        for activity in states.activities:
            for var in {v for lin in (activity.start, activity.end) for v, _ in lin.terms}:
                self._by_time.setdefault(var, []).append(activity)

    def precedence(self, form: Form) -> Precedence | None:
        """Return what a clause says, if it is of that kind about who moves something."""
        if form.__class__ is not tuple or form[0] != "|":
            return None
        absent: list[Literal] = []
        values: list[Value] = []
        activity: ActivityVars | None = None
        point = constant(0)
        helpers: dict[int, int] = {}
        for part in form[1:]:
            if part.__class__ is int:
                absent.append(~part)
                continue
            value = value_told(part, "!=")
            if value is not None:
                values.append(value)
                continue
            found = self._after(part)
            if found is None or (activity is not None and found[1:] != (activity, point)):
                return None
            helper, activity, point = found
            if helper[0] in helpers:
                return None
            helpers[helper[0]] = helper[1]
        if activity is None or absent != ([] if activity.present == TRUE else [activity.present]):
            return None
        return Precedence(activity, tuple(sorted(values)), point, helpers)

    def _after(self, part: Form) -> tuple[tuple[int, int], ActivityVars, Lin] | None:
        """Return ((helper, gap), activity, its time) of "the helper is there and has ended"."""
        parts = part[1:] if part.__class__ is tuple and part[0] == "&" else (part,)
        present = {p for p in parts if p.__class__ is int}
        order = [p for p in parts if p.__class__ is Cmp]
        if len(order) != 1 or len(present) + 1 < len(parts):
            return None
        cmp = order[0]
        if cmp.op != "<=" or sorted(c for _, c in cmp.terms) != [-1, 1]:
            return None
        first, then = sorted(cmp.terms, key=lambda t: -t[1])
        activity = self._whose(then[0], cmp.needs)
        if activity is None or activity.index not in self._movers:
            return None
        helper = self._whose(first[0], cmp.needs)
        if helper is None or helper is activity:
            return None
        if not {helper.present} - {TRUE} <= present <= {helper.present, activity.present}:
            return None
        # first + const <= then, and the helper's end is at most ``late`` after ``first``
        late = self._states.difference(helper.end, Lin(((first[0], 1),)))[1]
        gap, point = cmp.const - late, Lin(((then[0], 1),))
        ended = gap + self._states.difference(activity.end, point)[0] >= 0
        return ((helper.index, gap), activity, point) if ended else None

    def _whose(self, var: int, needs: tuple[Literal, ...]) -> ActivityVars | None:
        """Return whose time a variable is (alternatives may share one)."""
        some = [a for a in self._by_time.get(var, ()) if a.present == TRUE or a.present in needs]
        return some[0] if len(some) == 1 else None


def _set_for_good(states: States) -> dict[frozenset[int], StateVar]:
    """Return the state variables that are never set back, by who sets them (whenever it is there,
    and at a known time before its end or at it).
    """
    found: dict[frozenset[int], StateVar] = {}
    for key, state in states.vars.items():
        if state.initial is None or not state.writes or key[0] not in states.dynamic:
            continue
        if all(_sets(state, write, states) for write in state.writes):
            found.setdefault(frozenset(w.owner or 0 for w in state.writes), state)
    return found


def _sets(state: StateVar, write: Write, states: States) -> bool:
    """Return whether a write brings a state somewhere else, whenever its owner is there."""
    if write.owner is None or write.add or write.value.terms or write.value.const == state.initial:
        return False
    owner = states.activity(write.owner)
    low, high = states.difference(write.time, owner.end)
    return write.active == owner.present and low == high <= 0


def _milestone(number: int, helpers: list[int], states: States) -> StateVar:
    state = StateVar(("#milestone", number), (0, 1), [0, 1], 0)
    for index in helpers:
        activity = states.activity(index)
        time = activity.end.shift(-1)._replace(needs=())
        state.writes.append(Write(index, activity.present, time, constant(1)))
    return state


def _read(found: Precedence, state: StateVar, states: States) -> Read:
    """Return what a precedence asks of a state: at an instant by which it is seen to be set."""
    activity = found.activity
    delays = {
        w.owner: states.difference(w.time, states.activity(w.owner or 0).end)[1]
        for w in state.writes
    }
    seen = max(delays[helper] + 1 - gap for helper, gap in found.helpers.items())
    at = found.point.shift(seen)
    store = states.store
    chosen = [store.is_value(var, value) for var, value in found.values]
    allowed = frozenset(w.value.const for w in state.writes)
    active = store.all_of([activity.present, *chosen])
    return Read(activity.index, active, at, at, allowed=allowed)
