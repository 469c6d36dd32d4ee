"""Machines that are set up for kinds of jobs, batches, and buffers of limited room."""

import itertools

import pytest

from tests.fleet.test_rules import one_room, solved
from tests.usual import usually
from up_samp.fleet import Fleet, FleetError
from up_samp.validation import validate_plan

SETUP = {"red": {"blue": 10}, "blue": {"red": 4}}


def planned(fleet):
    """When everything is in a first plan, that the validator found nothing wrong with."""
    result = fleet.solve(timeout=60, first_plan=True)
    assert result.plan is not None, result.explain()
    assert validate_plan(fleet.problem, result.plan, seconds_per_unit=1.0).valid
    return {a["name"]: (a["start"], a["end"]) for a in result.data["activities"]}


def machines(kinds, lasts=3, **resource):
    fleet = one_room(robots=1)
    fleet.add_resource("press", **resource)
    for k, kind in enumerate(kinds):
        fleet.add_task(f"t{k}", duration=lasts, resources="press", kind=kind)
    return fleet


def least(kinds, lasts, setup, first):
    """The least makespan on one machine, over all orders."""

    def ends(order):
        now, before = 0, first
        for kind in order:
            now += setup.get(before, {}).get(kind, 0) + lasts
            before = kind
        return now

    return min(map(ends, itertools.permutations(kinds)))


@pytest.mark.parametrize("first", ["", "red", "blue"])
@pytest.mark.parametrize("kinds", [("red", "blue", "red"), ("blue", "red", "blue", "blue")])
def test_set_ups_are_kept_and_the_best_order_is_proven(kinds, first):
    result, times = solved(machines(kinds, setup=SETUP, kind=first))
    assert result.status == "SOLVED_OPTIMALLY"
    assert result.makespan == least(kinds, 3, SETUP, first)
    done = sorted((*times[f"t{k}"], kind) for k, kind in enumerate(kinds))
    for (_, end, one), (start, _, other) in itertools.pairwise(done):
        assert start - end >= SETUP[one].get(other, 0)


def test_a_batch_is_of_one_kind_and_begins_together():
    kinds = ("red", "blue", "red", "blue", "red", "blue", "blue", "red")
    fleet = machines(kinds, lasts=5, capacity=3, batches=True, setup=SETUP)
    result, times = solved(fleet)
    # two batches of each kind, blue before red
    assert (result.status, result.makespan) == ("SOLVED_OPTIMALLY", 24)
    for (j, one), (k, other) in itertools.combinations(enumerate(kinds), 2):
        (start, end), (begin, until) = times[f"t{j}"], times[f"t{k}"]
        if start < until and begin < end:
            assert (start, end, one) == (begin, until, other)
    starts = [start for start, _ in times.values()]
    assert max(map(starts.count, starts)) <= 3


def stored(room, holds):
    """One robot could bring both parts before another one fetches any."""
    fleet = one_room(robots=1)
    fleet.add_place("rack", 6, 8, room=room, holds=holds)
    for k in range(2):
        fleet.add_order(f"in{k}", pickup="a", delivery="rack")
        fleet.add_order(f"out{k}", pickup="rack", delivery="b")
    return fleet


def levels(times, holds):
    """How many loads are in the rack after each change."""
    changes = [(start, 1) for name, (start, _) in times.items() if name.startswith("deliver_in")]
    changes += [(end, -1) for name, (_, end) in times.items() if name.startswith("pick_out")]
    return [holds + n for n in itertools.accumulate(c for _, c in sorted(changes))]


@pytest.mark.parametrize(("room", "holds"), usually((2, 2), of=[(1, 0), (1, 1), (2, 0), (2, 2)]))
def test_a_place_holds_no_more_than_it_has_room_for(room, holds):
    times = planned(stored(room, holds))
    found = levels(times, holds)
    assert len(found) == 4
    assert min(found) >= 0
    assert max(found) <= room


def test_what_is_fetched_has_to_be_there():
    fleet = one_room(robots=1)
    fleet.add_place("rack", 6, 8, room=2, holds=1)
    for k in range(2):
        fleet.add_order(f"out{k}", pickup="rack", delivery="b")
    assert fleet.solve(timeout=20).status == "UNSOLVABLE_PROVEN"


def test_a_machine_empties_the_place_before_it_and_fills_the_one_behind():
    fleet = one_room(robots=2)
    fleet.add_place("before", 6, 8, room=1)
    fleet.add_place("behind", 10, 8, room=1)
    fleet.add_resource("saw")
    for k in range(2):
        saw = {"duration": 4, "input": "before", "output": "behind", "resources": "saw"}
        fleet.add_task(f"cut{k}", modes={"saw": saw})
        fleet.add_order(f"in{k}", pickup="a", delivery={"task": f"cut{k}"})
        fleet.add_order(f"out{k}", pickup={"task": f"cut{k}"}, delivery="b")
    times = planned(fleet)

    def of(word, k):
        return next(t for name, t in times.items() if name.startswith(f"{word}{k}"))

    one, two = sorted(range(2), key=lambda k: of("cut", k))
    assert of("deliver_in", two)[0] >= of("cut", one)[0]
    assert of("cut", two)[1] >= of("pick_out", one)[1]


WRONG = (
    (dict(setup={"red": {"blue": 1}}, capacity=2), "which is set up for what"),
    (dict(setup={"red": {"blue": 1}}, kind="green"), "none of the kinds"),
    (
        dict(setup={"red": {"blue": 9, "green": 1}, "green": {"blue": 1}, "blue": {}}),
        "by way of a third",
    ),
)


@pytest.mark.parametrize(("options", "words"), WRONG)
def test_set_ups_that_make_no_sense_are_told(options, words):
    with pytest.raises(FleetError, match=words):
        machines((), **options)


def test_jobs_of_no_kind_and_batches_of_two_lengths_are_told():
    with pytest.raises(FleetError, match="'t0' uses it: no kind ''"):
        machines(("",), setup=SETUP).problem.activities  # noqa: B018
    with pytest.raises(FleetError, match="no kind 'bleu'; did you mean 'blue'"):
        machines(("bleu",), setup=SETUP).problem.activities  # noqa: B018
    fleet = machines(("red",), capacity=2, batches=True)
    fleet.add_task("longer", duration=9, resources="press", kind="red")
    with pytest.raises(FleetError, match="a batch begins and ends together"):
        fleet.problem.activities  # noqa: B018


def test_rooms_are_told_of():
    fleet: Fleet = one_room(robots=1)
    with pytest.raises(FleetError, match="more than there is room for"):
        fleet.add_place("shelf", 6, 8, holds=2)
    fleet.add_place("shelf", 6, 8, room=2)
    fleet.add_order("o", pickup=["a", "shelf"], delivery="b")
    with pytest.raises(FleetError, match="named alone"):
        fleet.problem.activities  # noqa: B018
