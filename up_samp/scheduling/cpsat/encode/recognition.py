"""State variables and unary resources that are said in another way: with precedences, with
clauses, by levels of one and busy flags.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import starmap

from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Cmp,
    Form,
    Lin,
    Literal,
    constant,
    difference_told,
    parts_of,
    value_told,
)
from up_samp.scheduling.cpsat.encode.states import (
    Key,
    Read,
    States,
    StateVar,
    SureChange,
    Write,
)
from up_samp.scheduling.cpsat.encode.terms import ActivityVars
from up_samp.scheduling.cpsat.encode.timeline import pair_uses
from up_samp.scheduling.cpsat.normal import Precondition

Gap = Callable[[int, int], int]
"""How far apart two activities (indices) are in every schedule; negative if they may overlap."""

START = -1
"""In place of an activity: what holds at first."""


def find_histories(
    preconditions: list[Precondition],
    activities: dict[str, ActivityVars],
    gap: Gap,
) -> tuple[list[StateVar], list[Precondition]]:
    """Return the state variables that preconditions speak of, and the preconditions that none of
    these say.

    Assumes: helpers, rivals and who needs them never overlap, and all are named who may undo what
    is needed.
    """
    left: list[Precondition] = []
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
            left += some
        else:
            said.append((writers, some))
    made = [
        _history(("#history", number), writers, some, activities)
        for number, (writers, some) in enumerate(said)
    ]
    return made, left + [p for p in lasting if id(p) not in told]


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
        or not _rivals_suffice(precondition, followers)
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
    precondition: Precondition, followers: dict[str | None, frozenset[str]]
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


# ------------------ What clauses say of who comes first
# Someone who needs one of some others to have ended before. ``Or(not A.present, another value,
# And(H.present, H.end + k <= A.end), ...)`` asks no more than a condition of A on a state that each
# H sets once and for all. Where a state variable tells just that (a door that nobody shuts), it is
# that one; else there is a *milestone* for it. The clauses stay as they are: what is found here
# constrains nothing, but routes are read off it.


Value = tuple[int, int]
"""A variable (a parameter) and its value."""


@dataclass(frozen=True)
class ClausePrecedence:
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
    reader = _ClauseReader(states)
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
        reads.setdefault(state.key, []).append(_read_clause(found, state, states))
    return list(made.values()), reads


class _ClauseReader:
    """Reads precedences off clauses."""

    def __init__(self, states: States) -> None:
        self._states = states
        self._movers = states.movers()
        self._by_time: dict[int, list[ActivityVars]] = {}
        for activity in states.activities:
            for var in {v for lin in (activity.start, activity.end) for v, _ in lin.terms}:
                self._by_time.setdefault(var, []).append(activity)

    def precedence(self, form: Form) -> ClausePrecedence | None:
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
        return ClausePrecedence(activity, tuple(sorted(values)), point, helpers)

    def _after(self, part: Form) -> tuple[tuple[int, int], ActivityVars, Lin] | None:
        """Return ((helper, gap), activity, its time) of "the helper is there and has ended"."""
        parts = parts_of("&", part)
        present = {p for p in parts if p.__class__ is int}
        order = [p for p in parts if p.__class__ is Cmp]
        if len(order) != 1 or len(present) + 1 < len(parts):
            return None
        cmp, told = order[0], difference_told(order[0])
        if told is None:
            return None
        first, then, units = told
        activity = self._whose(then, cmp.needs)
        if activity is None or activity.index not in self._movers:
            return None
        helper = self._whose(first, cmp.needs)
        if helper is None or helper is activity:
            return None
        if not {helper.present} - {TRUE} <= present <= {helper.present, activity.present}:
            return None
        # first + const <= then, and the helper's end is at most ``late`` after ``first``
        late = self._states.difference(helper.end, Lin(((first, 1),)))[1]
        gap, point = units - late, Lin(((then, 1),))
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
        changes = states.sure_changes(state) if key[0] in states.dynamic else []
        if changes and all(_sets(state, change) for change in changes):
            found.setdefault(frozenset(change.owner.index for change in changes), state)
    return found


def _sets(state: StateVar, change: SureChange) -> bool:
    """Return whether a change brings a state somewhere else, at a known time."""
    low, high = change.late
    return not change.adds and state.initial not in (None, change.value) and low == high <= 0


def _milestone(number: int, helpers: list[int], states: States) -> StateVar:
    state = StateVar(("#milestone", number), (0, 1), [0, 1], 0)
    state.writes += [_write(states.activity(index), 1) for index in helpers]
    return state


def _read_clause(found: ClausePrecedence, state: StateVar, states: States) -> Read:
    """Return what a precedence asks of a state: at an instant by which it is seen to be set."""
    activity = found.activity
    delays = {
        w.owner: states.difference(w.time, states.activity(w.owner or 0).end)[1]
        for w in state.writes
    }
    seen = max(delays[helper] + 1 - gap for helper, gap in found.helpers.items())
    at = found.point.shift(seen)
    store = states.store
    chosen = list(starmap(store.is_value, found.values))
    allowed = frozenset(w.value.const for w in state.writes)
    active = store.all_of([activity.present, *chosen])
    return Read(activity.index, active, at, at, allowed=allowed)


# ------------------ Unary resources in whatever style
# Levels of one, busy flags, and states that are held. Each finder returns activities of which no
# two overlap, with the gap that they keep: what follows from the effects and conditions on one
# state variable. ``whole`` says that the state variable asks nothing else, so that the disjunctions
# may take its place.


@dataclass(frozen=True)
class Unary:
    """Activities (indices) done one at a time: ``b.start >= a.end + gap``, or vice versa."""

    key: Key
    gap: int
    members: tuple[int, ...]
    whole: bool


Section = tuple[int, Lin, Lin]
"""What one activity (its index) keeps for itself: the instants from one to another."""


def find_unary(states: States) -> list[Unary]:
    """Return all unary resources among the state variables."""
    found = []
    for key, state in states.vars.items():
        if key[0] not in states.dynamic or len(state.writes) < 2:
            continue
        unary = _borrowed(states, state) or _marked(states, state) or _held(states, state)
        if unary is not None and len(unary.members) > 1:
            found.append(unary)
    return found


# -- a level of which each takes more than half --------------------------------------------------
def _borrowed(states: States, state: StateVar) -> Unary | None:
    """Find who borrows more than half of what there is (``uses``, a decrease and an increase).

    Assumes: each takes more than half of what there is, at its start, and gives it back in the end.
    """
    if not state.numeric or state.initial is None:
        return None
    uses = pair_uses(states, state)
    if uses is None or any(take.owner is None for take, _ in uses):
        return None
    capacity = state.initial - state.bounds[0]
    owners = [take.owner for take, _ in uses]
    sections = [
        (take.owner, take.time, give.time)
        for take, give in uses
        if take.owner is not None
        and owners.count(take.owner) == 1
        and capacity < 2 * give.value.const
        and take.active == states.activity(take.owner).present
        and states.difference(give.time, take.time)[0] >= 1
    ]
    if not sections:
        return None
    exact = all(_exactly(states, s) for s in sections)
    fits = all(give.value.const <= capacity for _, give in uses)
    fits = fits and state.initial <= state.bounds[1]
    whole = exact and fits and len(sections) == len(uses) and not state.reads
    return _unary(states, state, sections, 0, whole)


# -- a flag that is set by who begins and needs it free ------------------------------------------
def _marked(states: States, state: StateVar) -> Unary | None:
    """Find who needs a state free, takes it, and frees it in the end.

    In the order of taking, the last effect before anybody takes it must be one that frees it; it
    cannot be the taking of the one before.

    Assumes: whoever takes needs it free, frees it itself, and what is free is never what is taken.
    """
    if state.numeric:
        return None
    pairs = _takes_and_frees(states, state)
    if not pairs:
        return None
    taken = {take.value.const for take, _ in pairs.values()}
    freed = {free.value.const for _, free in pairs.values()}
    if taken & freed:
        return None
    sections, left = [], list(state.reads)
    exact = state.initial is not None
    for owner, (take, free) in pairs.items():
        needed = next(
            (
                r
                for r in state.reads
                if r.owner == owner
                and r.active == take.active
                and r.allowed is not None
                and not r.allowed & taken
                and states.difference(take.time, r.hi)[0] >= 0
                and states.difference(take.time, r.hi)[1] <= 1
            ),
            None,
        )
        if needed is None:
            return None
        sections.append((owner, needed.lo, free.time))
        allowed = needed.allowed or frozenset()
        at_once = states.difference(needed.lo, take.time) == (0, 0)
        exact &= at_once and freed | {state.initial} <= allowed
        implied = [r for r in left if r is needed or _while_taken(states, r, owner, take, free)]
        left = [r for r in left if all(r is not other for other in implied)]
    whole = exact and not left and all(_exactly(states, s) for s in sections)
    return _unary(states, state, sections, 1, whole)


def _takes_and_frees(states: States, state: StateVar) -> dict[int, tuple[Write, Write]]:
    """Return the two effects of each owner; nothing if there are any others."""
    pairs = {}
    for owner, writes in state.by_owner().items():
        if owner is None or len(writes) != 2:
            return {}
        present = states.activity(owner).present
        if any(write.value.terms or write.active != present for write in writes):
            return {}
        one, other = writes
        if states.difference(other.time, one.time)[0] >= 1:
            pairs[owner] = (one, other)
        elif states.difference(one.time, other.time)[0] >= 1:
            pairs[owner] = (other, one)
        else:
            return {}
    return pairs


def _while_taken(states: States, read: Read, owner: int, take: Write, free: Write) -> bool:
    """Return whether a read asks no more than that its owner holds what it has taken."""
    after = 0 if read.guard_only else 1
    return (
        read.owner == owner
        and read.active == take.active
        and read.value is None
        and (read.allowed is None or take.value.const in read.allowed)
        and states.difference(read.lo, take.time)[0] >= after
        and states.difference(free.time, read.hi)[0] >= 0
    )


# -- a state that everybody changes once and holds -----------------------------------------------
def _held(states: States, state: StateVar) -> Unary | None:
    """Find who changes a state at one end of a span over which it keeps others from doing so.

    Assumes: each sets it once, at one end of the span over which it keeps it.
    """
    if state.numeric:
        return None
    for at_end in (True, False):
        sections = list(_spans(states, state, at_end))
        if len(sections) > 1:
            unary = _unary(states, state, sections, 1, False)
            if unary is not None:
                return unary
    return None


def _spans(states: States, state: StateVar, at_end: bool) -> Iterator[Section]:
    seen = set()
    for read in state.reads:
        mine = state.by_owner().get(read.owner, [])
        if len(mine) != 1 or read.owner is None or read.owner in seen or read.loose:
            continue
        write = mine[0]
        present = states.activity(read.owner).present
        if read.active != present or write.active != present:
            continue
        before = states.difference(write.time, read.hi)
        after = states.difference(read.lo, write.time)
        if at_end and before[0] >= 0 and before[1] <= 1:
            seen.add(read.owner)
            yield (read.owner, read.lo, write.time)
        elif not at_end and after[0] >= 0 and after[1] <= 1:
            seen.add(read.owner)
            yield (read.owner, write.time, read.hi)


# -- common ------------------------------------------------------------------------------------
def _unary(
    states: States, state: StateVar, sections: list[Section], margin: int, whole: bool
) -> Unary | None:
    """Return what sections that are ``margin`` apart say of their activities."""
    covering = []
    for owner, lo, hi in sections:
        activity = states.activity(owner)
        tail = states.difference(hi, activity.end)[0]
        head = states.difference(lo, activity.start)[1]
        covering.append((tail, head, owner))
    gap = margin + min(t for t, _, _ in covering) - max(h for _, h, _ in covering)
    if gap < 0:
        return None
    return Unary(state.key, gap, tuple(sorted(o for _, _, o in covering)), whole)


def _exactly(states: States, section: Section) -> bool:
    """Return whether a section is its activity's time, start to end."""
    owner, lo, hi = section
    activity = states.activity(owner)
    return (
        states.difference(lo, activity.start) == (0, 0)
        and states.difference(hi, activity.end) == (0, 0)
        and states.difference(activity.end, activity.start)[0] >= 1
    )
