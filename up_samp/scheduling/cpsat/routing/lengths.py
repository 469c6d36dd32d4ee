"""How long a move lasts at least, if its parameters have certain values; or that they cannot."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.scheduling.cpsat.encode.forms import FALSE, Cmp, Form, value_told
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.routing.route import INFINITE

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel

Values = Mapping[int, int]
"""Variable (a parameter) -> value."""


class Lengths:
    """What is stated about the durations of activities and the values of parameters.

    :param variables: the parameters that are asked for.
    """

    def __init__(self, model: ScheduleModel, variables: Iterable[int]) -> None:
        self._model = model
        self._names = {var: name for name, (var, _, _) in model.parameters.items()}
        self._with: dict[frozenset[tuple[int, int]], list[Form]] = {}
        self._others: dict[int, list[Form]] = {}
        asked = frozenset(variables)
        owners = _Owners(model)
        for form in model.stated if asked else ():
            # of one activity, a clause says nothing that may hold for the sake of another
            found = asked & _variables(form) if owners.at_most_one(form) else None
            if not found:
                continue
            # what says nothing but of some values is looked at for these only
            items = frozenset(_unless(form))
            if items:
                self._with.setdefault(items, []).append(form)
                continue
            for var in found:
                self._others.setdefault(var, []).append(form)

    def least(self, activity: ActivityVars, values: Values) -> int:
        """Return how long an activity lasts at least with ``values``; INFINITE if it cannot.

        Assumes: a clause of one activity holds for the values that it names, whoever else is there.
        """
        least = max(activity.least, self._by_fluents(activity, values))
        some = [*values.items()]
        parts = (p for n in range(len(some)) for p in itertools.combinations(some, n + 1))
        forms = [form for part in parts for form in self._with.get(frozenset(part), ())]
        forms += [form for var in values for form in self._others.get(var, ())]
        return max([least, *(_implied(form, activity, values) for form in forms)])

    def _by_fluents(self, activity: ActivityVars, values: Values) -> int:
        """Return the duration's lower bound where it is told by fluents that never change."""
        duration = self._model.variables.told.get(activity.name)
        if duration is None:
            return 0
        known = {self._names[var]: value for var, value in values.items() if var in self._names}
        least = self._worth(duration.lower, known)
        return 0 if least is None else least + duration.is_left_open()

    def _worth(self, node: FNode, known: Mapping[str, int]) -> int | None:
        """Return what an expression is worth; ``None`` if that is not known."""
        kind, model = node.node_type, self._model
        if kind is Op.INT_CONSTANT:
            return int(node.constant_value())
        if kind is Op.OBJECT_EXP:
            return model.world.objects[node.object().name]
        if kind is Op.PARAM_EXP:
            return known.get(node.parameter().name)
        parts = [self._worth(a, known) for a in node.args]
        numbers = [p for p in parts if p is not None]
        if len(numbers) < len(parts):
            return None
        if kind is Op.PLUS:
            return sum(numbers)
        if kind is Op.FLUENT_EXP and node.fluent().name not in model.states.dynamic:
            return model.states.var(node.fluent(), tuple(numbers)).initial
        return None


class _Owners:
    """Whose variables and presences are whose."""

    def __init__(self, model: ScheduleModel) -> None:
        self._of: dict[int, str] = {}
        self._absent: dict[int, str] = {}
        for name, (var, _, _) in model.parameters.items():
            self._of[var] = name.rpartition(".")[0]  # nothing for those of the problem
        for activity in model.states.activities:
            self._absent[~activity.present] = activity.name
            for time in (activity.start, activity.end):
                self._of.update((var, activity.name) for var, _ in time.terms)

    def at_most_one(self, form: Form) -> bool:
        """Return whether a form is no clause of parts that speak of several activities."""
        if form.__class__ is not tuple or form[0] != "|":
            return True
        known = set[str]()
        for part in form[1:]:
            if part.__class__ is int:
                known.add(self._absent.get(part, ""))
            elif part.__class__ is Cmp:
                known.update(self._of.get(var, "") for var, _ in part.terms)
        return len(known - {""}) < 2


def _variables(form: Form) -> frozenset[int]:
    if form.__class__ is tuple:
        return frozenset[int]().union(*map(_variables, form[1:]))
    return frozenset(v for v, _ in form.terms) if form.__class__ is Cmp else frozenset()


def _unless(form: Form) -> Iterable[tuple[int, int]]:
    """Yield (variable, value) of which a clause says nothing if the variable is another one."""
    parts = form[1:] if form.__class__ is tuple and form[0] == "|" else ()
    told = (value_told(part, "!=") for part in parts)
    yield from (item for item in told if item is not None)


def _implied(form: Form, activity: ActivityVars, values: Values) -> int:
    """Return how long an activity that is there lasts at least for a form to hold."""
    if form.__class__ is tuple:
        enough, better = (0, min) if form[0] == "|" else (INFINITE, max)
        least = INFINITE - enough
        for part in form[1:]:
            least = better(least, _implied(part, activity, values))
            if least == enough:
                break
        return least
    if form.__class__ is int:
        return INFINITE if form in (FALSE, ~activity.present) else 0
    if form.needs and any(need != activity.present for need in form.needs):
        return 0
    if all(var in values for var, _ in form.terms):
        worth = form.const + sum(factor * values[var] for var, factor in form.terms)
        holds = {"<=": worth <= 0, "==": worth == 0, "!=": worth != 0}[form.op]
        return 0 if holds else INFINITE
    terms = dict(form.terms)
    start, end = activity.start.terms[0][0], activity.end.terms[0][0]
    if len(terms) == 2 and terms.keys() == {start, end} and form.op in ("<=", "=="):
        if terms[start] == 1 and terms[end] == -1:
            return max(0, form.const)
        if form.op == "==" and terms[start] == -1 and terms[end] == 1:
            return max(0, -form.const)
    return 0
