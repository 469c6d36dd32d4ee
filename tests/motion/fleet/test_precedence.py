"""Where one of two goes first and that decides everything, there is nothing else to be tried."""

import itertools
import random

import numpy as np
import pytest

from tests.motion.fleet.spacetime_oracle import room
from up_samp.model import (
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    Rest,
    TimedMotion,
)
from up_samp.model.bodies import Body
from up_samp.motion import MotionService
from up_samp.motion.fleet.coordination import one_decides, order_decides

SIZE = 5


def runs_of(blocked):
    """Return conflicting cells as the workspace tells them."""
    rows = []
    for i, row in enumerate(blocked):
        for value, some in itertools.groupby(range(len(row)), key=lambda j: row[j]):
            some = list(some)
            if value:
                rows.append((i, some[0], some[-1]))
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def arrivals(blocked):
    """Return all (arrival of one, of the other) that are possible: each may go on by a cell a tick,
    and leave one cell as the other one comes to conflict with the next.
    """
    last, found = SIZE - 1, set()
    here = {(0, 0, 0, 0)}
    for t in range(1, 3 * SIZE):
        there = set()
        for (i, j, a, b), di, dj in itertools.product(here, (0, 1), (0, 1)):
            u, v = min(i + di, last), min(j + dj, last)
            if not blocked[u][v]:
                there.add((u, v, t if u == last > i else a, t if v == last > j else b))
        found |= {(a, b) for i, j, a, b in there if i == j == last}
        here = {x for x in there if x[:2] != (last, last)}
    return found


def behind(blocked):
    """Return the earliest arrival of the one that goes along the rows, the other being as fast as
    it can be; None where there is none.
    """
    at = {0}
    for t in range(1, 3 * SIZE):
        j = min(t, SIZE - 1)
        at = {u for i in at for u in (i, min(i + 1, SIZE - 1)) if not blocked[u][j]}
        if SIZE - 1 in at:
            still = [blocked[SIZE - 1][min(s, SIZE - 1)] for s in range(t, SIZE)]
            if not any(still):
                return t
    return None


def area(rng):
    """Return random conflicts: a few boxes, the corners free."""
    blocked = np.zeros((SIZE, SIZE), dtype=bool)
    for _ in range(rng.choice((1, 2, 2, 3))):
        i, j = rng.randrange(SIZE), rng.randrange(SIZE)
        blocked[i : i + rng.randint(1, 4), j : j + rng.randint(1, 4)] = True
    blocked[0, 0] = blocked[-1, -1] = False
    return blocked


def better(blocked):
    """Return what is possible and not as late as both of the two attempts."""
    tried = []
    for one, turned in ((blocked, False), (blocked.T, True)):
        late = behind(one)
        if late is not None:
            tried.append((SIZE - 1, late) if turned else (late, SIZE - 1))
    return [(a, b) for a, b in arrivals(blocked) if not any(x <= a and y <= b for x, y in tried)]


def test_two_attempts_tell_all_where_one_decides():
    rng, decided = random.Random(0), 0
    for _ in range(150):
        blocked = area(rng)
        if one_decides(runs_of(blocked)):
            decided += 1
            assert better(blocked) == [], blocked
    assert 40 < decided < 145


@pytest.mark.parametrize(
    "rows",
    [
        [".....", ".#...", ".....", "...#.", "....."],  # two places
        [".....", ".###.", ".#.#.", ".....", "....."],  # a dent: a place to wait
        [".....", ".##..", ".#...", ".##..", "....."],
    ],
)
def test_two_places_or_a_dent_do_not_decide(rows):
    assert not one_decides(runs_of(np.array([[c == "#" for c in row] for row in rows])))


def test_somewhere_more_than_two_attempts_are_needed():
    """The oracle sees the difference: one goes first at one place, the other at the next."""
    found = [b for b in map(area, map(random.Random, range(150))) if better(b)]
    assert found
    assert not any(one_decides(runs_of(b)) for b in found)


def body():
    footprint = ((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3))
    return Body(footprint, Kinematics(MotionModel.SE2, 1.0, 1.0, 1.0))


def motion(name, *poses, avoid=None):
    return TimedMotion(name, name, body(), poses, 0.0, 100.0, avoid=avoid)


def test_a_crossing_decides_and_two_crossings_do_not():
    service = MotionService(None)
    ahead = motion("a", (0.0, 0.0, 0.0), (12.0, 0.0, 0.0))
    across = motion("b", (4.0, -5.0, 0.0), (4.0, 5.0, 0.0))
    round_trip = motion("c", (4.0, -5.0, 0.0), (4.0, 5.0, 0.0), (9.0, 5.0, 0.0), (9.0, -5.0, 0.0))
    blind = motion("d", (4.0, -5.0, 0.0), (4.0, 5.0, 0.0), avoid=frozenset())
    limit = Deadline.after(60.0)
    assert order_decides(service, ahead, across, limit)
    assert not order_decides(service, ahead, round_trip, limit)
    assert not order_decides(service, ahead, blind, limit)


def corridor(leaf, seconds=20.0):
    """Two whose ways cross: one waits for a door's leaf on its way, or does not (or for a crate
    aside); the other one is due soon.
    """
    free = [(0.1, 3.2, 14.0, 4.8), (2.2, 2.0, 3.8, 8.0)]
    rests = {
        "leaf": (Rest("leaf", body(), (8.5, 4.0, 0.0), until=30.0),),
        "crate": (Rest("crate", body(), (13.2, 4.0, 0.0)),),
        "none": (),
    }[leaf]
    motions = (
        TimedMotion("a", "ra", body(), ((3.0, 4.0, 0.0), (11.0, 4.0, 0.0)), 0.0, 1e9),
        TimedMotion("b", "rb", body(), ((3.0, 3.05, 0.0), (3.0, 7.0, 0.0)), 0.0, 14.0),
    )
    service = MotionService(room(15, 9, free))
    return service.coordinate(GroupQuery(motions, rests), Deadline.after(seconds))


def test_who_goes_first_does_not_decide_where_something_else_comes_or_goes():
    """Who waits for a leaf at its start is in the other one's way; it might wait on its way."""
    assert not corridor("leaf", seconds=2.0).exhaustive  # it tries other orders until then
    assert corridor("none").exhaustive
    assert corridor("crate").exhaustive


def test_who_goes_first_does_not_decide_where_neither_can():
    """Two that swap places leave their fastest ways and are late: other ways may be sooner than
    those that were found.
    """
    one, other = (3.0, 4.0, 0.0), (10.0, 4.0, 0.0)
    motions = (
        TimedMotion("a", "ra", body(), (one, other), 0.0, 8.05),
        TimedMotion("b", "rb", body(), (other, one), 0.0, 8.05),
    )
    service = MotionService(room(15, 9, [(0.1, 0.1, 14.0, 8.8)]))
    report = service.coordinate(GroupQuery(motions, ()), Deadline.after(60.0))
    assert report.outcome is Outcome.FOUND
    assert report.late
    assert not report.exhaustive
    assert not order_decides(service, *motions, Deadline.after(60.0))
