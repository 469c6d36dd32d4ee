"""State variables that are said with precedences: what the last of some activities has left.

Helpers and rivals that never overlap are in some order. Then "a helper comes before A, and no rival
between" says that the last of them before A is a helper: the condition of A on a state variable
that each of them assigns. Activities that leave the same have the same value.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.store import constant
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.normal.precedences import Precondition

Gap = Callable[[int, int], int]
"""How far apart two activities (indices) are in every schedule; negative if they may overlap."""

START = -1
"""In place of an activity: what holds at first."""


@dataclass
class Histories:
    """``states`` say all of the preconditions that are not in ``left``; those in ``milestones`` are
    implied by what is left: something that is done once and for all.
    """

    states: list[StateVar] = field(default_factory=list)
    milestones: list[StateVar] = field(default_factory=list)
    left: list[Precondition] = field(default_factory=list)
    reads: list[tuple[StateVar, list[Read]]] = field(default_factory=list)
    """Conditions on state variables that are there already, and tell the same."""


def find_histories(
    preconditions: Iterable[Precondition],
    activities: dict[str, ActivityVars],
    gap: Gap,
    states: Iterable[StateVar] = (),
) -> Histories:
    """Return the state variables that the preconditions speak of.

    :param states: those of the problem; where one of them tells the same, it is read.
    """
    found = Histories()
    known = _last_effects(states, activities)
    disturbed = []
    by_helpers: dict[frozenset[str], list[Precondition]] = {}
    for precondition in preconditions:
        if precondition.initially is None and not any(precondition.helpers.values()):
            by_helpers.setdefault(frozenset(precondition.helpers), []).append(precondition)
            found.left.append(precondition)
        else:
            disturbed.append(precondition)
    for number, some in enumerate(by_helpers.values()):
        found.milestones.append(_milestone(("#milestone", number), some, activities))
    for number, (writers, some) in enumerate(_by_writers(disturbed).items()):
        if not _said_by_order(writers, some, activities, gap):
            found.left += some
            continue
        reads = _told(known.get(frozenset(activities[w].index for w in writers)), some, activities)
        if reads is not None:
            found.reads.append(reads)
        else:
            found.states.append(_history(("#history", number), writers, some, activities))
    return found


def _last_effects(
    states: Iterable[StateVar], activities: dict[str, ActivityVars]
) -> dict[frozenset[int], StateVar]:
    """Return the state variables that each of some activities sets once, a unit before its end."""
    index = {a.index: a for a in activities.values()}
    found: dict[frozenset[int], StateVar] = {}
    for state in states:
        plain = state.initial is not None and all(
            w.owner is not None
            and not w.add
            and not w.value.terms
            and w.active == index[w.owner].present
            and w.time == index[w.owner].end.shift(-1)._replace(needs=())
            for w in state.writes
        )
        owners = frozenset(w.owner for w in state.writes if w.owner is not None)
        if plain and len(owners) == len(state.writes):
            found.setdefault(owners, state)
    return found


def _told(
    state: StateVar | None, preconditions: list[Precondition], activities: dict[str, ActivityVars]
) -> tuple[StateVar, list[Read]] | None:
    """Return what the preconditions ask of a state variable, if they ask just for values of it."""
    if state is None:
        return None
    values = {w.owner: w.value.const for w in state.writes}
    reads = []
    for precondition in preconditions:
        mine = activities[precondition.activity].index
        helpers = {activities[h].index for h in precondition.helpers}
        allowed = {values[h] for h in helpers}
        if precondition.initially is not None and state.initial is not None:
            allowed.add(state.initial)
        for owner, value in values.items():
            if owner != mine and (value in allowed) != (owner in helpers):
                return None
        if (state.initial in allowed) != (precondition.initially is not None):
            return None
        reads.append(_read(activities[precondition.activity], frozenset(allowed)))
    return state, reads


def _writers(precondition: Precondition) -> frozenset[str]:
    rivals = [*precondition.helpers.values(), precondition.initially or frozenset()]
    return frozenset(precondition.helpers).union(*rivals)


def _by_writers(
    preconditions: list[Precondition],
) -> dict[frozenset[str], list[Precondition]]:
    """Return preconditions by who changes what they speak of: all that they name, and who needs
    them, too, where others name that as well.
    """
    written = [(p, _writers(p)) for p in preconditions]
    counts = Counter(w for p, names in written for w in {names, names | {p.activity}})
    found: dict[frozenset[str], list[Precondition]] = {}
    for precondition, names in written:
        whole = names | {precondition.activity}
        key = whole if counts[whole] > 1 and counts[whole] >= counts[names] else names
        found.setdefault(key, []).append(precondition)
    return found


def _said_by_order(
    writers: frozenset[str],
    preconditions: list[Precondition],
    activities: dict[str, ActivityVars],
    gap: Gap,
) -> bool:
    """Return whether the order of the writers says all that the preconditions say."""
    if not {*writers, *(p.activity for p in preconditions)} <= activities.keys():
        return False
    most = max(p.gap for p in preconditions)
    order = sorted(activities[name].index for name in writers)
    if any(activities[name].least < 1 for name in writers):
        return False
    if any(gap(a, b) < most for i, a in enumerate(order) for b in order[i + 1 :]):
        return False
    for precondition in preconditions:
        one = activities[precondition.activity]
        if one.least < 1 or any(gap(one.index, b) < most for b in order if b != one.index):
            return False
        undo = writers - precondition.helpers.keys() - {one.name}
        options = [(h, rivals) for h, rivals in precondition.helpers.items()]
        if any(not undo - {h} <= rivals for h, rivals in options):
            return False
        if precondition.initially is not None and not undo <= precondition.initially:
            return False
    return True


def _history(
    key: Key,
    writers: frozenset[str],
    preconditions: list[Precondition],
    activities: dict[str, ActivityVars],
) -> StateVar:
    order = sorted(activities[name].index for name in writers)
    index = {a.index: a for a in activities.values()}
    allowed = []
    for precondition in preconditions:
        helpers = frozenset(activities[h].index for h in precondition.helpers)
        initially = {START} if precondition.initially is not None else set[int]()
        allowed.append(helpers | initially)
    codes: dict[frozenset[int], int] = {}
    values = {}
    numbers = {some: i for i, some in enumerate(dict.fromkeys(allowed))}
    for writer in (START, *order):
        leaves = frozenset(number for some, number in numbers.items() if writer in some)
        values[writer] = codes.setdefault(leaves, len(codes))
    state = StateVar(key, (0, len(codes) - 1), list(range(len(codes))), values[START])
    for i in order:
        state.writes.append(_write(index[i], values[i], 0))
    for precondition, some in zip(preconditions, allowed, strict=True):
        mine = frozenset(values[w] for w in some)
        state.reads.append(_read(activities[precondition.activity], mine))
    return state


def _milestone(
    key: Key, preconditions: list[Precondition], activities: dict[str, ActivityVars]
) -> StateVar:
    state = StateVar(key, (0, 1), [0, 1], 0)
    gap = min(p.gap for p in preconditions)
    for name in sorted(preconditions[0].helpers, key=lambda n: activities[n].index):
        state.writes.append(_write(activities[name], 1, gap))
    for precondition in preconditions:
        state.reads.append(_read(activities[precondition.activity], frozenset({1})))
    return state


def _write(activity: ActivityVars, value: int, gap: int) -> Write:
    time = activity.end.shift(gap - 1)._replace(needs=())
    return Write(activity.index, activity.present, time, constant(value))


def _read(activity: ActivityVars, allowed: frozenset[int]) -> Read:
    start = activity.start._replace(needs=())
    return Read(activity.index, activity.present, start, start, allowed=allowed)
