"""What moves a traveller, in whatever form: what each activity does to one object-valued state.

A *move* leads from what it needs the place to be at its start (else from anywhere) to one place, or
to that which a parameter names. What may do so or not is odd, but if it is one of the things that
the traveller does one at a time, it takes its time, and leads to no place that it does not name.
What is not among these, or changes the place after its end, may put the traveller there at any
time, and in no time. So a few odd activities loosen a route, and leave the rest of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.forms import Lin
from up_samp.scheduling.cpsat.encode.statevars import Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.encode.timeline import Timeline

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel

Cliques = list[tuple[int, set[int]]]
"""Sets of activities that are done one at a time, each with its gap."""


@dataclass(frozen=True)
class Change:
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


def changes_of(model: ScheduleModel, timeline: Timeline, members: set[int]) -> list[Change]:
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
) -> Change:
    state = timeline.state
    writes = [state.writes[i] for i in numbers]
    everything = frozenset(state.values or ())
    anywhere = frozenset[int]().union(*(_values(model, w.value, everything) for w in writes))
    if owner is None:
        return Change(None, everything, anywhere, odd="sets it", free=True)
    activity = model.states.activity(owner)
    delays = [model.states.difference(w.time, activity.end) for w in writes]
    since = [model.states.difference(w.time, activity.start)[0] for w in writes]
    if owner not in members:
        why = "is not kept apart from all else that changes it"
        return Change(activity, everything, anywhere, odd=why, free=True)
    if max(high for _, high in delays) > 0 or min(since) < 0:
        why = "changes it before its start or after its end"
        return Change(activity, everything, anywhere, odd=why, free=True)
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
        return Change(activity, origins, anywhere, delay, origin, odd=why, touches=touches)
    delay = model.states.difference(last.time, activity.end)[0]
    targets, target = _values(model, last.value, everything), _variable(last.value)
    odd = "sets it to what is computed" if last.value.terms and target is None else ""
    return Change(activity, origins, targets, delay, origin, target, odd, touches=touches)


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
