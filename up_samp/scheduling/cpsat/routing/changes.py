"""What moves a traveller, in whatever form: what each activity does to one object-valued state.

A *move* leads from what it needs the place to be at its start (else from anywhere) to one place, or
to that which a parameter names. What may do so or not is odd, but if it is one of the things that
the traveller does one at a time, it takes its time, and leads to no place that it does not name.
What is not among these, or changes the place after its end, may put the traveller there at any
time, and in no time. So a few odd activities loosen a route, and leave the rest of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.scheduling.cpsat.encode.forms import Cmp, Form, Lin, value_told, variables_in
from up_samp.scheduling.cpsat.encode.states import Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.encode.timeline import Timeline
from up_samp.scheduling.cpsat.encode.variables import Values, implied_length

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel


Cliques = list[tuple[int, set[int]]]
"""Sets of activities that are done one at a time, each with its gap."""


@dataclass(frozen=True)
class Mover:
    """What ``activity`` (``None``: the problem itself) does to a place: it leads from one of
    ``origins`` to one of ``targets``, by an effect ``delay`` (0 or less) after its end.

    ``touches``: it needs its origin right after its start only, so it may start at the instant at
    which another one ends. ``origin`` and ``target`` are the variables (parameters) that tell
    which, if there are any. ``odd`` says why it is no plain move (nothing: it is one). ``free``: it
    may happen at any time, beside all else.
    """

    activity: ActivityVars | None
    origins: frozenset[int]
    targets: frozenset[int]
    delay: int = 0
    origin: int | None = None
    target: int | None = None
    odd: str = ""
    free: bool = False
    touches: bool = False


def changes_of(model: ScheduleModel, timeline: Timeline, members: set[int]) -> list[Mover]:
    """Return what changes a state, if ``members`` are done one at a time.

    What is stated never to happen is not among it.

    Assumes: nothing but effects changes a place; what is not sure of them is odd, or free.
    """
    state = timeline.state
    writes: dict[int | None, list[int]] = {}
    for i, write in enumerate(state.writes):
        if not model.store.never(write.active):
            writes.setdefault(write.owner, []).append(i)
    return [_change(model, timeline, owner, some, members) for owner, some in writes.items()]


def _change(
    model: ScheduleModel,
    timeline: Timeline,
    owner: int | None,
    numbers: list[int],
    members: set[int],
) -> Mover:
    state = timeline.state
    writes = [state.writes[i] for i in numbers]
    everything = frozenset(state.values or ())
    anywhere = frozenset[int]().union(*(_values(model, w.value, everything) for w in writes))
    if owner is None:
        return Mover(None, everything, anywhere, odd="sets it", free=True)
    activity = model.states.activity(owner)
    delays = [model.states.difference(w.time, activity.end) for w in writes]
    since = [model.states.difference(w.time, activity.start)[0] for w in writes]
    if owner not in members:
        why = "is not kept apart from all else that changes it"
        return Mover(activity, everything, anywhere, odd=why, free=True)
    if max(high for _, high in delays) > 0 or min(since) < 0:
        why = "changes it before its start or after its end"
        return Mover(activity, everything, anywhere, odd=why, free=True)
    # right after its start it sees what it sets then itself
    instants = [(0, 0), (1, 1)] if min(since) >= 1 else [(0, 0)]
    read = _at_start(model, activity, state, instants)
    origins, origin, touches = everything, None, False
    if read is not None and read.allowed is not None:
        origins, origin = read.allowed, _variable(read.value)
        touches = model.states.difference(read.lo, activity.start) != (0, 0)
    last = _last(timeline, numbers)
    if last is None or last.active != activity.present:
        delay = min(low for low, _ in delays)
        why = "may change it, or to what, is not certain"
        return Mover(activity, origins, anywhere, delay, origin, odd=why, touches=touches)
    delay = model.states.difference(last.time, activity.end)[0]
    targets, target = _values(model, last.value, everything), _variable(last.value)
    odd = "sets it to what is computed" if last.value.terms and target is None else ""
    return Mover(activity, origins, targets, delay, origin, target, odd, touches=touches)


def _at_start(
    model: ScheduleModel,
    activity: ActivityVars,
    state: StateVar,
    instants: list[tuple[int, int]],
) -> Read | None:
    """Return what an activity needs of a state at its start, or at one of other ``instants``,
    counted from there.
    """
    found = [
        read
        for read in state.reads
        if read.owner == activity.index
        and read.allowed is not None
        and read.active == activity.present
        and model.states.difference(read.lo, activity.start) in instants
    ]

    def worth(read: Read) -> tuple[bool, int, int]:
        """What a variable tells is worth more than a list, a short list more than a long one, and
        what is needed from the start on more than what is needed later.
        """
        later = model.states.difference(read.lo, activity.start)[0]
        return read.value is None, len(read.allowed or ()), later

    return min(found, key=worth, default=None)


def _last(timeline: Timeline, numbers: list[int]) -> Write | None:
    """Return the last of an activity's effects on a state, if it is known which one that is."""
    writes = timeline.state.writes
    for i in numbers:
        others = [writes[j] for j in numbers if j != i]
        if all(timeline.states.difference(writes[i].time, w.time)[0] > 0 for w in others):
            return writes[i]
    return None


def _values(model: ScheduleModel, value: Lin, everything: frozenset[int]) -> frozenset[int]:
    """Return what an effect may set a state to."""
    if not value.terms:
        return frozenset((value.const,))
    low, high = model.store.range(value)
    return frozenset(v for v in everything if low <= v <= high)


def _variable(value: Lin | None) -> int | None:
    """Return the variable that a value is."""
    if value is None or value.const or len(value.terms) != 1 or value.terms[0][1] != 1:
        return None
    return value.terms[0][0]


# ------------------ How long a move lasts at least


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
            found = asked & variables_in(form) if owners.at_most_one(form) else None
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
        return max([least, *(implied_length(form, activity, values) for form in forms)])

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


def _unless(form: Form) -> Iterable[tuple[int, int]]:
    """Yield (variable, value) of which a clause says nothing if the variable is another one."""
    parts = form[1:] if form.__class__ is tuple and form[0] == "|" else ()
    told = (value_told(part, "!=") for part in parts)
    yield from (item for item in told if item is not None)
