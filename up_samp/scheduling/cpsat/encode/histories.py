"""State variables that are said with precedences: what the last of some activities has left.

Helpers and rivals that never overlap are in some order. Then "a helper comes before A, and no rival
between" says that the last of them before A is a helper: the condition of A on a state variable
that each of them assigns. Activities that leave the same have the same value.

Authors may name fewer rivals: of who needs to be at a place, those only that leave it. Where every
other activity needs something itself that the helpers do not leave, it cannot be the next one
after them, so it need not be named: by induction over time, the conditions on all places together
say the same as one state variable.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from up_samp.scheduling.cpsat.encode.forms import constant
from up_samp.scheduling.cpsat.encode.statevars import Key, Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.normal.precedences import Precondition

Gap = Callable[[int, int], int]
"""How far apart two activities (indices) are in every schedule; negative if they may overlap."""

START = -1
"""In place of an activity: what holds at first."""


@dataclass
class Histories:
    """``states`` say all of the preconditions that are not in ``left``."""

    states: list[StateVar] = field(default_factory=list)
    left: list[Precondition] = field(default_factory=list)
    reads: list[tuple[StateVar, list[Read]]] = field(default_factory=list)
    """Conditions on state variables that are there already, and tell the same."""


def find_histories(
    preconditions: list[Precondition],
    activities: dict[str, ActivityVars],
    gap: Gap,
    states: Iterable[StateVar] = (),
) -> Histories:
    """Return the state variables that the preconditions speak of.

    Assumes: helpers, rivals and who needs them never overlap, and all are named who may undo what
    is needed.

    :param states: those of the problem; where one of them tells the same, it is read.
    """
    found = Histories()
    known = _last_effects(states, activities)
    lasting = [p for p in preconditions if _lasts(p)]
    groups = list(_by_writers([p for p in preconditions if not _lasts(p)]).items())
    said: list[Group] = []
    for cluster in _clusters(groups):
        said += _together(cluster, lasting, activities, gap)
    told = {id(p) for _, some in said for p in some}
    for writers, some in groups:
        if id(some[0]) in told:
            continue
        if _unsaid(writers, some, activities, gap):
            found.left += some
        else:
            said.append((writers, some))
    for number, (writers, some) in enumerate(said):
        reads = _told(known.get(frozenset(activities[w].index for w in writers)), some, activities)
        if reads is not None:
            found.reads.append(reads)
        else:
            found.states.append(_history(("#history", number), writers, some, activities))
    found.left += [p for p in lasting if id(p) not in told]
    return found


def _lasts(precondition: Precondition) -> bool:
    """Return whether a precondition names nobody who undoes it."""
    return precondition.initially is None and not any(precondition.helpers.values())


Group = tuple[frozenset[str], list[Precondition]]
"""Who changes something, and what is said of it."""


def _clusters(groups: list[Group]) -> list[list[Group]]:
    """Return the groups that have activities in common, in order."""
    clusters: list[tuple[set[str], list[Group]]] = []
    for writers, some in groups:
        near = [c for c in clusters if c[0] & writers]
        first = near[0] if near else (set[str](), list[Group]())
        for other in near[1:]:
            first[0].update(other[0])
            first[1].extend(other[1])
            clusters.remove(other)
        if not near:
            clusters.append(first)
        first[0].update(writers)
        first[1].append((writers, some))
    return [groups for _, groups in clusters]


def _together(
    groups: list[Group],
    lasting: list[Precondition],
    activities: dict[str, ActivityVars],
    gap: Gap,
) -> list[Group]:
    """Return the groups that together say one state variable, as one (nothing, if none do).

    :param lasting: preconditions of which nobody is named who undoes them: some may be said, too.
    """
    while len(groups) > 1:
        writers = frozenset[str]().union(*(w for w, _ in groups))
        every = [p for _, some in groups for p in some]
        every += [p for p in lasting if {p.activity, *p.helpers} <= writers]
        wrong = {id(p) for p in _unsaid(writers, every, activities, gap)}
        if not wrong:
            return [(writers, every)]
        lasting = [p for p in lasting if id(p) not in wrong]
        groups = [g for g in groups if all(id(p) not in wrong for p in g[1])]
    return []


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


def _unsaid(
    writers: frozenset[str],
    preconditions: list[Precondition],
    activities: dict[str, ActivityVars],
    gap: Gap,
) -> list[Precondition]:
    """Return the preconditions that the order of the writers does not say."""
    if not {*writers, *(p.activity for p in preconditions)} <= activities.keys():
        return preconditions
    most = max(p.gap for p in preconditions)
    order = sorted(activities[name].index for name in writers)
    if any(activities[name].least < 1 for name in writers):
        return preconditions
    if any(gap(a, b) < most for i, a in enumerate(order) for b in order[i + 1 :]):
        return preconditions
    followers = _followers(writers, preconditions)
    return [
        precondition
        for precondition in preconditions
        for one in (activities[precondition.activity],)
        if one.least < 1
        or any(gap(one.index, b) < most for b in order if b != one.index)
        or not _rivals_suffice(writers, precondition, followers)
    ]


def _followers(
    writers: frozenset[str], preconditions: list[Precondition]
) -> dict[str | None, frozenset[str]]:
    """Return activity (``None``: the beginning) -> who may come right after it, for all that it
    needs itself.
    """
    needed: dict[str, set[str | None]] = {}
    for precondition in preconditions:
        mine = {*precondition.helpers, *([] if precondition.initially is None else [None])}
        known = needed.get(precondition.activity)
        needed[precondition.activity] = mine if known is None else known & mine
    found: dict[str | None, set[str]] = {name: set() for name in (*writers, None)}
    for name in writers:
        for before in needed.get(name, found.keys()):
            found[before].add(name)
    return {name: frozenset(some) for name, some in found.items()}


def _rivals_suffice(
    writers: frozenset[str],
    precondition: Precondition,
    followers: dict[str | None, frozenset[str]],
) -> bool:
    """Return whether all are named as rivals who may undo what a precondition needs.

    Behind each helper (or the beginning), either nobody may come next who is not named; or nobody
    who is no helper may come next behind any of them.
    """
    one = precondition.activity
    options: list[tuple[str | None, frozenset[str]]] = [*precondition.helpers.items()]
    if precondition.initially is not None:
        options.append((None, precondition.initially))
    behind = frozenset[str]().union(*(followers[helper] for helper, _ in options))
    undo = behind - precondition.helpers.keys() - {one}
    return all(
        undo <= rivals or followers[helper] - {one} - rivals <= {helper}
        for helper, rivals in options
    )


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
        state.writes.append(_write(index[i], values[i]))
    for precondition, some in zip(preconditions, allowed, strict=True):
        mine = frozenset(values[w] for w in some)
        state.reads.append(_read(activities[precondition.activity], mine))
    return state


def _write(activity: ActivityVars, value: int) -> Write:
    time = activity.end.shift(-1)._replace(needs=())
    return Write(activity.index, activity.present, time, constant(value))


def _read(activity: ActivityVars, allowed: frozenset[int]) -> Read:
    start = activity.start._replace(needs=())
    return Read(activity.index, activity.present, start, start, allowed=allowed)
