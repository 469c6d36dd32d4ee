"""Earliest times under differences, and what happens to them when something takes longer."""

import itertools
import math
import random

from up_samp.scheduling.partial_order import Difference, Earliest

ZERO = ("zero", "")


def after(first, then, lag=0, strict=False):
    return Difference(("end", first), ("start", then), lag, strict)


def lasts(name, units):
    return Difference(("start", name), ("end", name), units)


def test_what_depends_on_a_late_end_comes_later():
    times = Earliest("abc", [lasts("a", 3), lasts("b", 2), after("a", "b", 0, True)])
    assert times.times["start", "b"] == 4
    assert times.raised({("end", "a"): 10})
    assert (times.times["start", "b"], times.times["end", "b"]) == (11, 13)
    assert times.times["start", "c"] == 0


def test_what_is_pinned_stays_or_nothing_changes():
    times = Earliest("ab", [lasts("a", 3), after("a", "b"), lasts("b", 1)])
    assert times.raised({("start", "b"): 5, ("end", "b"): 6}, pin=True)
    before = dict(times.times)
    assert not times.raised({("end", "a"): 6})
    assert not times.raised({("start", "b"): 7})
    assert times.times == before
    assert times.raised({("end", "a"): 5})


def test_a_latest_end_is_kept():
    due = Difference(("end", "b"), ZERO, -9)
    times = Earliest("ab", [lasts("a", 3), after("a", "b"), lasts("b", 2), due])
    assert times.feasible
    assert times.raised({("end", "a"): 7})
    assert not times.raised({("end", "a"): 8})
    assert not Earliest("ab", [lasts("a", 8), after("a", "b"), lasts("b", 2), due]).feasible


def test_a_ring_has_no_times():
    assert not Earliest("ab", [after("a", "b", 0, True), after("b", "a")]).feasible


def test_all_differences_hold_after_any_delays():
    rng = random.Random(3)
    names = "abcdefgh"
    for _ in range(50):
        pairs = [p for p in itertools.combinations(names, 2) if rng.random() < 0.4]
        rules = [after(a, b, rng.randint(-2, 4), rng.random() < 0.5) for a, b in pairs]
        rules += [lasts(n, rng.randint(0, 5)) for n in names]
        times = Earliest(names, rules)
        for _ in range(6):
            point = (rng.choice(("start", "end")), rng.choice(names))
            assert times.raised({point: times.times[point] + rng.randint(0, 5)})
            for d in rules:
                assert times.times[d.then] >= times.times[d.first] + d.lag + d.strict


def test_a_state_is_gone_back_to():
    times = Earliest("ab", [lasts("a", 3), after("a", "b"), lasts("b", 1)])
    before, begun = dict(times.times), times.state()
    assert times.raised({("end", "a"): 9}, pin=True)
    assert not times.raised({("end", "a"): 10})
    times.restore(begun)
    assert times.times == before
    assert times.raised({("end", "a"): 10})


def test_nothing_can_come_after_its_latest_time():
    """Raised alone to its latest time a point keeps all that is asked, and not one unit later."""
    rng = random.Random(5)
    names, bound = "abcdef", 0
    for _ in range(40):
        pairs = [p for p in itertools.combinations(names, 2) if rng.random() < 0.4]
        rules = [after(a, b, rng.randint(0, 4), rng.random() < 0.5) for a, b in pairs]
        rules += [lasts(n, rng.randint(0, 5)) for n in names]
        rules += [Difference(("end", n), ZERO, -rng.randint(10, 60)) for n in rng.sample(names, 2)]
        times = Earliest(names, rules)
        if not times.feasible:
            continue
        latest = times.latest()
        for point in [(side, n) for side in ("start", "end") for n in names]:
            begun = times.state()
            assert times.raised({point: min(latest[point], 1000)})
            times.restore(begun)
            if latest[point] < math.inf:
                bound += 1
                assert not times.raised({point: latest[point] + 1})
    assert bound > 100
