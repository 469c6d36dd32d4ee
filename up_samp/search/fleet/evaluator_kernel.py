"""The assignment evaluator and simulated annealing of assignments, compiled: see
:mod:`up_samp.search.fleet.evaluator`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from up_samp.geometry.records import inner, kernel, lean_inner
from up_samp.model.arrays import FloatArray, IntArray

_BELOW = 1.0 - 1e-9
"""So much less than it is found to take alone a tour takes at least: numbers are rounded."""
_LEAST_DRAW = 1e-300
"""Random numbers are taken to be no less: they have logarithms."""
_ENDS, _WHOLE = 0.3, 0.3
"""Share of the changes by which two robots exchange the ends of their tours, and of these the share
in which they exchange all.
"""


class BatteryTables(NamedTuple):
    """What robots' batteries hold: ``level`` at first (``inf``: they never run out), ``full``
    at most, and how long charging a unit takes (``pace``, s). Options take ``uses`` of it,
    rides ``taken`` (kind, from, to), and ``detour`` (s) is how much longer a ride takes by way of
    a charger.
    """

    level: FloatArray
    full: FloatArray
    pace: FloatArray
    uses: FloatArray
    taken: FloatArray
    detour: FloatArray


class HandoverTables(NamedTuple):
    """How long (s) after a robot begins a drive from a shared place another one may end its drive
    there: ``seconds`` by row and column (negative: unknown), which drives (kind, from, to) have
    (``leaves``, ``comes``). ``at`` is where each stop is, ``home`` where a robot goes after an
    option that is its last one. What is unknown takes what is ``likely`` (place, sector where one
    leaves, sector where the other one comes from; negative: unknown), by the ``sector`` of the
    plane in which poses lie (from, to). -1 is no row, no column, nowhere: all tables end with what
    is unknown then.
    """

    at: IntArray
    home: IntArray
    leaves: IntArray
    comes: IntArray
    seconds: FloatArray
    sector: IntArray
    likely: FloatArray


class WorkTables(NamedTuple):
    """What options ask for. Option ``o`` is one of ``of[o]``, a job, by ``robot[o]``; those of job
    ``j`` are ``first[j]:first[j + 1]``. It is entered at ``entry[o]`` and ends at ``exit[o]``;
    from there it takes ``home[o]`` to where nobody is in the way (negative: nobody has to go). It
    is ``due[o]``, and begins no sooner than ``release[o]``. Its stops are ``head[o]:head[o + 1]``:
    ``drive`` from the one before, ``place`` that others need, too (-1: nobody does), and how long
    it ``stays``.

    No robot does two of one ``crew`` (-1: none).

    ``start`` and ``kind`` are where robots are at first, and which row of ``rides`` (kind, from,
    to) is theirs; ``goal`` is where they have to be in the end (-1: anywhere), ``rests`` how long
    they are at rest in between, ``loads`` how many jobs they may have under way at once.
    """

    of: IntArray
    robot: IntArray
    first: IntArray
    entry: IntArray
    exit: IntArray
    home: FloatArray
    due: FloatArray
    release: FloatArray
    head: IntArray
    drive: FloatArray
    place: IntArray
    stays: FloatArray
    crew: IntArray
    start: IntArray
    kind: IntArray
    rides: FloatArray
    goal: IntArray
    rests: FloatArray
    loads: IntArray
    cells: BatteryTables
    handovers: HandoverTables


class CostWeights(NamedTuple):
    """What counts how much when it is decided who does what: ``handover`` s from who leaves a
    shared place to who comes next, as far as one can guess; ``traffic``: the factor by which tours
    are expected to take longer than alone, if one is due; ``late``: by which a second too late
    counts more; ``steep``: the power of a tour's end that counts (the last one most);
    ``at_once``: whether it is decided for all tours at once who goes first, else in order of time.
    """

    handover: float = 5.0
    traffic: float = 1.3
    late: float = 10.0
    steep: float = 6.0
    at_once: bool = False


class TourArrays(NamedTuple):
    """Tours (robots, jobs) and how many options each has (robots,)."""

    tours: IntArray
    counts: IntArray


@kernel
def ends_of(work: WorkTables, rules: CostWeights, arrays: TourArrays, places: int) -> FloatArray:
    """Return when each robot has done its jobs, and by how much it is late in all (robots, 2).

    Whoever comes first to one of ``places`` works there first, or (``at_once``) of those who wait
    the one that has most left to do (Schrage's schedule of one machine; Carlier, EJOR 1982). Who
    ends where another one comes later goes home.
    """
    # to take an array out of a record costs, and in the loop it would be done again and again
    tours, counts = arrays.tours, arrays.counts
    head, place_of, drive, stays, due = work.head, work.place, work.drive, work.stays, work.due
    robots = len(counts)
    found = np.zeros((robots, 2))
    coming = np.full(robots, np.inf)
    at = np.zeros((robots, 2), dtype=np.int64)  # the number of the option, and of the stop
    free = np.full(places, -np.inf)
    last = np.full(places, -1)
    stop_at, home, goes, comes, seconds, sector, likely = work.handovers
    # how the last one drives on: a row of known handovers, and a sector
    leaves, away = np.full(places, -1), np.full(places, -1)
    here, kind = work.start.copy(), work.kind
    saved = np.zeros(robots)  # by the latest option's being done together with the one before
    left = np.zeros(robots)  # what each one has to do from its next stop on (s)
    for r in range(robots):
        if counts[r] > 0:
            coming[r] = _reached(work, arrays, r, 0, 0.0)
            at[r, 1] = head[tours[r, 0]]
            left[r] = _left(work, arrays, r, coming[r]) if rules.at_once else 0.0
    while True:
        first = int(np.argmin(coming))
        if coming[first] == np.inf:
            break
        r, place = first, place_of[at[first, 1]]
        waits = rules.at_once and place >= 0 and free[place] > coming[first]
        for q in range(robots if waits else 0):
            if coming[q] <= free[place] and left[q] > left[r] and place_of[at[q, 1]] == place:
                r = q
        option, stop, came = tours[r, at[r, 0]], at[r, 1], coming[r]
        begin = came
        if place >= 0 and last[place] != r:
            gap = seconds[leaves[place], comes[kind[r], here[r], stop_at[stop]]]
            if gap < 0.0:
                gap = likely[place, away[place], sector[stop_at[stop], here[r]]]
            begin = max(came, free[place] + (gap if gap >= 0.0 else rules.handover))
        done = begin + stays[stop]
        left[r] -= stays[stop]
        here[r] = stop_at[stop]
        if place >= 0:
            free[place] = done
            last[place] = r
            there = _then(stop_at, home, head, tours[r, : counts[r]], at[r])
            leaves[place] = goes[kind[r], stop_at[stop], there]
            away[place] = sector[stop_at[stop], there]
        found[r, 0] = done
        if stop + 1 < head[option + 1]:
            at[r, 1] = stop + 1
            coming[r] = done + drive[stop + 1]
            left[r] -= drive[stop + 1]
            continue
        if due[option] < np.inf:
            found[r, 1] += max(0.0, rules.traffic * done - due[option])
        at[r, 0] += 1
        if at[r, 0] < counts[r]:
            then = tours[r, at[r, 0]]
            at[r, 1] = head[then]
            saved[r] = _together(work, r, option, then) if saved[r] == 0.0 else 0.0
            coming[r] = _reached(work, arrays, r, at[r, 0], done - saved[r])
            left[r] -= coming[r] - done
        else:
            coming[r] = np.inf
    for r in range(robots):
        found[r, 0] += _way_home(work, arrays, r, last)
        found[r, 0] += beside(work, r, tours[r], counts[r])[0]
    return found


@inner
def _left(work: WorkTables, arrays: TourArrays, r: int, since: float) -> float:
    """Return how long (s) a robot's tour takes alone from its first stop on, to which it comes at
    ``since``.
    """
    tour, seconds = arrays.tours[r], since
    for number in range(arrays.counts[r]):
        option = tour[number]
        if number > 0:
            seconds = _reached(work, arrays, r, number, seconds)
        for stop in range(work.head[option], work.head[option + 1]):
            seconds += work.stays[stop] + work.drive[stop]
    return seconds - since


@lean_inner
def _then(stop_at: IntArray, home: IntArray, head: IntArray, tour: IntArray, at: IntArray) -> int:
    """Return where a robot drives from a stop of its tour, ``at`` (number of the option, stop)."""
    option = tour[at[0]]
    if at[1] + 1 < head[option + 1]:
        there: int = stop_at[at[1] + 1]
    elif at[0] + 1 < len(tour):
        there = stop_at[head[tour[at[0] + 1]]]
    else:
        there = home[option]
    return there


@inner
def _way_home(work: WorkTables, arrays: TourArrays, r: int, last: IntArray) -> float:
    """Return how long (s) a robot drives home that ends where another one was ``last``."""
    if arrays.counts[r] == 0:
        return 0.0
    option = arrays.tours[r, arrays.counts[r] - 1]
    place, home = work.place[work.head[option + 1] - 1], work.home[option]
    goes = home >= 0.0 and place >= 0 and last[place] != r
    seconds: float = home if goes else 0.0
    return seconds


@kernel
def beside(work: WorkTables, r: int, tour: IntArray, count: int) -> tuple[float, int]:
    """Return how long (s) a robot does what belongs to no job of its tour, and how often it
    charges: where that is least out of its way since it did so last. What it cannot do at once
    counts as very long.
    """
    cells, kind, here = work.cells, work.kind[r], work.start[r]
    entry, exit_, uses, taken, rides = work.entry, work.exit, cells.uses, cells.taken, work.rides
    ways, goal = cells.detour, work.goal[r]
    seconds, charges, left, detour = work.rests[r], 0, cells.level[r], np.inf
    for number in range(count + (goal >= 0)):
        there = goal if number == count else entry[tour[number]]
        left -= taken[kind, here, there]
        detour = min(detour, ways[kind, here, there])
        if number == count:
            seconds += rides[kind, here, there]
        else:
            left -= uses[tour[number]]
            here = exit_[tour[number]]
        if left + charges * cells.full[r] < 0.0:
            charges += 1
            seconds += detour
            detour = np.inf
    seconds += _of_one_crew(work, tour, count)
    return seconds + max(0.0, -left) * cells.pace[r], charges


@inner
def _of_one_crew(work: WorkTables, tour: IntArray, count: int) -> float:
    """Return what counts as very long (1e4 s) for each two options of a tour that belong to one
    crew.
    """
    seconds, crews = 0.0, work.crew
    for number in range(count):
        crew = crews[tour[number]]
        for other in range(number if crew >= 0 else 0):
            seconds += 1e4 * (crews[tour[other]] == crew)
    return seconds


@inner
def _reached(work: WorkTables, arrays: TourArrays, r: int, number: int, since: float) -> float:
    """Return when a robot may begin an option of its tour that has done all before it."""
    option = arrays.tours[r, number]
    here = work.start[r] if number == 0 else work.exit[arrays.tours[r, number - 1]]
    reached: float = since + work.rides[work.kind[r], here, work.entry[option]]
    return max(reached, work.release[option])


@inner
def _together(work: WorkTables, r: int, one: int, then: int) -> float:
    """Return how much sooner (s) a robot has done two options if it fetches for the second one
    before it brings the first one; 0 where it cannot, or is not.
    """
    if work.loads[r] < 2 or work.head[one + 1] - work.head[one] != 2:
        return 0.0
    if work.head[then + 1] - work.head[then] != 2:
        return 0.0
    rides, fetch, bring = work.rides[work.kind[r]], work.entry, work.exit
    apart = work.drive[work.head[one] + 1] + rides[bring[one], fetch[then]]
    apart += work.drive[work.head[then] + 1]
    way = rides[fetch[one], fetch[then]] + rides[fetch[then], bring[one]]
    sooner: float = max(0.0, apart - way - rides[bring[one], bring[then]])
    return sooner


@inner
def _longest(ends: FloatArray, rules: CostWeights) -> float:
    """Return what the longest tour takes (s), with what is late (1: none takes any time)."""
    longest: float = np.max(ends[:, 0] + rules.late * ends[:, 1])
    return longest if longest > 0.0 else 1.0


@inner
def _weight(ends: FloatArray, rules: CostWeights, unit: float) -> float:
    """Return what an assignment of all jobs costs, by tours of a ``unit`` (s): high powers of
    seconds would be beyond all numbers.
    """
    total = 0.0
    for r in range(len(ends)):
        total += ((ends[r, 0] + rules.late * ends[r, 1]) / unit) ** rules.steep
    return total


@inner
def _least(work: WorkTables, rules: CostWeights, arrays: TourArrays, r: int, unit: float) -> float:
    """Return what a robot's tour costs at least, however long it waits for others."""
    end = _alone(work, rules, r, arrays.tours[r], arrays.counts[r])
    least: float = (_BELOW * end / unit) ** rules.steep
    return least


@inner
def _alone(work: WorkTables, rules: CostWeights, r: int, tour: IntArray, count: int) -> float:
    """Return when a robot would have done a tour without others; what is late counts more."""
    time, late, saved = 0.0, 0.0, 0.0
    here = work.start[r]
    for number in range(count):
        o = tour[number]
        saved = _together(work, r, tour[number - 1], o) if number > 0 and saved == 0.0 else 0.0
        time += work.rides[work.kind[r], here, work.entry[o]] - saved
        time = max(time, work.release[o])
        for stop in range(work.head[o], work.head[o + 1]):
            time += work.stays[stop]
            if stop > work.head[o]:
                time += work.drive[stop]
        if work.due[o] < np.inf:
            late += max(0.0, rules.traffic * time - work.due[o])
        here = work.exit[o]
    return time + rules.late * late + beside(work, r, tour, count)[0]


@kernel
def insert(work: WorkTables, rules: CostWeights, arrays: TourArrays, job: int) -> int:
    """Give a job to who has done everything soonest then, and return who that is."""
    best, gain, who, what, where = np.inf, np.inf, -1, -1, -1
    for o in range(work.first[job], work.first[job + 1]):
        r = work.robot[o]
        tour, count = arrays.tours[r], arrays.counts[r]
        before = _alone(work, rules, r, tour, count)
        for at in range(count + 1):
            longer = _with(tour, count, at, o)
            end = _alone(work, rules, r, longer, count + 1)
            sooner = end < best or (end == best and end - before < gain)
            if sooner or (end == best and end - before == gain and r < who):
                best, gain, who, what, where = end, end - before, r, o, at
    arrays.tours[who] = _with(arrays.tours[who], arrays.counts[who], where, what)
    arrays.counts[who] += 1
    return who


@inner
def _with(tour: IntArray, count: int, at: int, option: int) -> IntArray:
    """Return a tour with an option more."""
    longer = np.copy(tour)
    for number in range(count, at, -1):
        longer[number] = longer[number - 1]
    longer[at] = option
    return longer


@inner
def _without(tour: IntArray, count: int, option: int) -> IntArray:
    """Return a tour with an option less."""
    shorter = np.copy(tour)
    number = 0
    for n in range(count):
        if tour[n] != option:
            shorter[number] = tour[n]
            number += 1
    return shorter


@inner
def _drawn(draw: float, many: int) -> int:
    """Return one of ``many`` numbers by a ``draw`` in [0, 1)."""
    return min(int(draw * many), many - 1)


@inner
def _change(work: WorkTables, arrays: TourArrays, draws: FloatArray) -> tuple[int, int]:
    """Let a random job be done at another time, by another, or for another, or two robots exchange
    all that they do from some job on; return whose tours that changes (the same twice: one;
    negative: nothing was changed).
    """
    tours, counts = arrays.tours, arrays.counts
    full = np.nonzero(counts > 0)[0]
    if len(full) == 0:
        return -1, -1
    one = full[_drawn(draws[0], len(full))]
    if draws[9] < _ENDS:
        return _ends_exchanged(work, arrays, one, draws)
    step = tours[one, _drawn(draws[1], counts[one])]
    job = work.of[step]
    option = work.first[job] + _drawn(draws[2], work.first[job + 1] - work.first[job])
    other = work.robot[option]
    left = _without(tours[one], counts[one], step)
    if other == one:
        tours[one] = _with(left, counts[one] - 1, _drawn(draws[3], counts[one]), option)
        return one, one
    moved = _with(tours[other], counts[other], _drawn(draws[3], counts[other] + 1), option)
    if counts[other] == 0 or draws[4] < 0.5:
        tours[one], tours[other] = left, moved
        counts[one] -= 1
        counts[other] += 1
        return one, other
    back = tours[other, _drawn(draws[5], counts[other])]
    job = work.of[back]
    mine = work.first[job] + np.nonzero(work.robot[work.first[job] : work.first[job + 1]] == one)[0]
    if len(mine) == 0:
        return -1, -1
    taken = mine[_drawn(draws[6], len(mine))]
    tours[one] = _with(left, counts[one] - 1, _drawn(draws[7], counts[one]), taken)
    tours[other] = _without(moved, counts[other] + 1, back)
    return one, other


@inner
def _ends_exchanged(
    work: WorkTables, arrays: TourArrays, one: int, draws: FloatArray
) -> tuple[int, int]:
    """Let a robot and a random other one exchange the ends of their tours (2-opt* of vehicle
    routing; Potvin and Rousseau 1995), or all of them; return both (negative: nothing was changed,
    as somebody cannot do a job of the other one's).
    """
    tours, counts = arrays.tours, arrays.counts
    other = _drawn(draws[1], len(counts))
    whole = draws[4] < _WHOLE
    first = 0 if whole else _drawn(draws[2], counts[one] + 1)
    second = 0 if whole else _drawn(draws[3], counts[other] + 1)
    mine = _as_done_by(work, other, tours[one, first : counts[one]])
    theirs = _as_done_by(work, one, tours[other, second : counts[other]])
    alike = one == other or len(mine) + len(theirs) == 0
    if alike or np.any(mine < 0) or np.any(theirs < 0):
        return -1, -1
    counts[one], counts[other] = first + len(theirs), second + len(mine)
    tours[one, first : counts[one]] = theirs
    tours[other, second : counts[other]] = mine
    return one, other


@inner
def _as_done_by(work: WorkTables, robot: int, tour: IntArray) -> IntArray:
    """Return the options by which a robot does what others do by those of a ``tour``, ending where
    they end (-1: there is none).
    """
    found = np.full(len(tour), -1)
    for number in range(len(tour)):
        job = work.of[tour[number]]
        for o in range(work.first[job], work.first[job + 1]):
            if work.robot[o] == robot and work.exit[o] == work.exit[tour[number]]:
                found[number] = o
    return found


@kernel
def length_of(ends: FloatArray, rules: CostWeights) -> float:
    """Return how long (s) an assignment of all jobs takes, as it is annealed: hardly more than its
    longest tour where ends are ``steep``, and what is late counts more.
    """
    unit = _longest(ends, rules)
    length: float = unit * _weight(ends, rules, unit) ** (1.0 / rules.steep)
    return length


def drawn(chance: np.random.Generator, tries: int) -> FloatArray:
    """Return the random numbers in [0, 1) that some tries of annealing need (tries, 10)."""
    return chance.random((tries, 10))


@kernel
def anneal(
    work: WorkTables,
    rules: CostWeights,
    now: TourArrays,
    best: TourArrays,
    draws: FloatArray,
    heats: FloatArray,
) -> None:
    """Change tours ``now``, also for the worse: by a random share (``heats``, of what they are
    worth) at each of some tries with random numbers ``draws`` (see :func:`drawn`). ``best``
    becomes the best that comes by.
    """
    places = int(np.max(work.place)) + 1 if len(work.place) else 0
    ends = ends_of(work, rules, now, places)
    unit = _longest(ends, rules)
    total = _weight(ends, rules, unit)
    least = _weight(ends_of(work, rules, best, places), rules, unit)
    old = TourArrays(np.copy(now.tours), np.copy(now.counts))
    for number in range(len(draws)):
        one, other = _change(work, now, draws[number])
        if one < 0:
            continue
        # costs that are accepted by chance; often the changed tours alone cost more
        most = total - heats[number] * total * np.log(max(draws[number, 8], _LEAST_DRAW))
        then = max(_least(work, rules, now, one, unit), _least(work, rules, now, other, unit))
        if then <= most:
            then = _weight(ends_of(work, rules, now, places), rules, unit)
        if then > most:
            _copy_rows(old, now, one, other)
            continue
        _copy_rows(now, old, one, other)
        total = then
        if total < least:
            least = total
            best.tours[:] = now.tours
            best.counts[:] = now.counts


@inner
def _copy_rows(source: TourArrays, target: TourArrays, one: int, other: int) -> None:
    """Make the tours of two robots what they are in ``source``."""
    for r in (one, other):
        target.tours[r] = source.tours[r]
        target.counts[r] = source.counts[r]
