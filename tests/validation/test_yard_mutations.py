"""A good plan with one thing broken, where the problem says all that a schedule can say: each is
caught, with the activity, the object and the time.

Together with tests/validation/test_mutations.py and tests/io/test_wrong_plans.py: over 80 kinds.
"""

import copy
import itertools
import math

import numpy as np
import pytest

from tests import handmade
from tests.validation import yard
from tests.validation.test_mutations import WHEN
from up_samp.io import contradictions, plan_from_dict, plan_to_dict
from up_samp.model import ProblemError
from up_samp.validation import validate_plan


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return yard.make(tmp_path_factory.mktemp("yard"))


@pytest.fixture(scope="module")
def data(made):
    return plan_to_dict(made.problem, made.plan)


def activity(plan, name):
    return next(a for a in plan["activities"] if a["name"] == name)


def motion(plan, name):
    return next(m for m in plan["motions"] if m["activity"] == name)


def rows(plan, name):
    return motion(plan, name)["samples"]


def at(name, start, end):
    return lambda p: activity(p, name).update(start=start, end=end)


def moved(name, by, **times):
    """Move an activity and its motions by some units."""

    def spoil(plan):
        entry = activity(plan, name)
        entry.update(start=entry["start"] + by, end=entry["end"] + by)
        for m in plan["motions"]:
            if m["activity"] == name:
                for row in m["samples"]:
                    row[0] += by

    return spoil


def added(name, start, end):
    return lambda p: p["activities"].append({"name": name, "start": start, "end": end})


def removed(name):
    return lambda p: p["activities"].remove(activity(p, name))


def to_place(place):
    return lambda p: activity(p, "cart_on").update(parameters={"to": place})


def bent(name, column, height, start=0.2, end=0.8):
    """Let one coordinate swell and ebb in the middle of a motion, smoothly."""

    def spoil(plan):
        found = rows(plan, name)
        first, last = found[0][0], found[-1][0]
        for row in found:
            share = ((row[0] - first) / (last - first) - start) / (end - start)
            if 0 < share < 1:
                row[column] += height * math.sin(math.pi * share) ** 2

    return spoil


def with_rows(name, make):
    def spoil(plan):
        found = rows(plan, name)
        found[:] = make(found)

    return spoil


def of_trajectory(trajectory):
    table = np.column_stack((trajectory.times, trajectory.poses))
    return lambda _found: [[float(v) for v in row] for row in table]


def at_once(found):
    """The same way at constant speed: no ramps."""
    ends = found[0][0], found[-1][0]
    way = [0.0]
    for a, b in itertools.pairwise(found):
        way.append(way[-1] + math.dist(a[1:3], b[1:3]))
    times = [ends[0] + (ends[1] - ends[0]) * s / way[-1] for s in way]
    return [[t, *row[1:4]] for t, row in zip(times, found, strict=True)]


def snaking():
    """A way round curves of 0.4 m, slowly, where 1 m is the least."""
    part = 0.4 * 0.5
    pieces = [(5.0, 0.0), (part, 2.5), (2 * part, -2.5), (part, 2.5), (20.0, 0.0)]
    ahead = handmade.along(yard.PLACES["t0"], pieces[:4], 99.0)[0] - yard.PLACES["t0"][0]
    pieces[4] = (21.0 - ahead, 0.0)
    return of_trajectory(handmade.drive(yard.PLACES["t0"], pieces, 4.2, 1.9, 0.5))


def swap(plan):
    one, other = motion(plan, "cart_go"), motion(plan, "truck_go")
    one["samples"], other["samples"] = other["samples"], one["samples"]


def both(*spoils):
    return lambda p: [spoil(p) for spoil in spoils]


def backwards_in_time(found):
    return [[a[0], *b[1:]] for a, b in zip(found, reversed(found), strict=True)]


def two_at_once(found):
    """Two samples in the middle have one time."""
    middle = len(found) // 2
    found[middle][0] = found[middle + 5][0]
    return found


def shuffled(found):
    middle = len(found) // 2
    found[middle], found[middle + 9] = found[middle + 9], found[middle]
    return found


def standing(found):
    return [[row[0], *found[0][1:]] for row in found]


def lane(name, by):
    """Drive on another lane, and start and end there."""
    return with_rows(name, lambda found: [[t, x, y + by, *more] for t, x, y, *more in found])


MUTATIONS = {
    "ends after its deadline": (at("paint", 24, 27), "paint", None),
    "drives after its deadline": (moved("cart_go", 13), "cart_go", None),
    "starts before its release": (at("grind", 8, 11), "grind", None),
    "two users of more than there is": (at("paint", 2, 5), "paint", "power"),
    "leaves its window": (at("inspect", 31, 33), "inspect", None),
    "comes before what it waits for": (at("inspect", 15, 17), "inspect", None),
    "both of a choice": (added("clean_b", 7, 8), "clean_b", None),
    "none of a choice": (removed("clean_a"), "clean_a", None),
    "lasts no time": (at("weld", 0, 0), "weld", None),
    "lasts longer": (at("weld", 0, 6), "weld", None),
    "half a unit": (at("weld", 0.5, 4.5), "weld", None),
    "a parameter that is not allowed": (to_place("c2"), "cart_on", None),
    "a parameter that it does not drive to": (to_place("c3"), "cart_on", "cart"),
    "a parameter that is no place": (to_place("truck"), "cart_on", None),
    "a parameter that is nothing": (to_place("nowhere"), "cart_on", None),
    "a variable that is a number": (lambda p: p["parameters"].update(night=3), "night", None),
    "a variable that forbids it": (at("weld", 40, 44), "weld", None),
    "two drives of one robot at once": (moved("cart_on", -4), "cart_on", "cart"),
    "drives on before it has come": (
        both(moved("cart_go", 11), moved("cart_on", -10)), "cart_on", "cart",
    ),
    "the door opens behind it": (at("open_door", 8, 9), "truck_go", "truck"),
    "the door opens too soon": (at("open_door", 0, 1), "open_door", None),
    "passes a waypoint by": (bent("cart_go", 2, 0.3), "cart_go", "cart"),
    "drives into the other robot": (lane("cart_go", -8.0), "cart_go", "cart"),
    "drives in another's place": (swap, "cart_go", "cart"),
    "starts where its last drive did not end": (
        with_rows("cart_on", lambda f: [[r[0], r[1] - 0.5, *r[2:]] for r in f]), "cart_on", "cart",
    ),
    "drives from the goal to the start": (
        with_rows("cart_go", backwards_in_time), "cart_go", "cart",
    ),
    "turns too fast": (bent("cart_go", 3, 1.5, 0.4, 0.6), "cart_go", "cart"),
    "speeds up at once": (with_rows("truck_go", at_once), "truck_go", "truck"),
    "two places at one time": (with_rows("cart_go", two_at_once), "cart_go", "cart"),
    "times that go back": (with_rows("cart_go", shuffled), "cart_go", "cart"),
    "slides to the side": (bent("truck_go", 3, 0.2), "truck_go", "truck"),
    "takes curves too tight": (with_rows("truck_go", snaking()), "truck_go", "truck"),
    "stands still": (with_rows("truck_go", standing), "truck_go", "truck"),
    "a drive without a motion": (added("truck_back", 21, 36), "truck_back", "truck"),
    "another unit of time": (lambda p: p.update(seconds_per_unit=2.0), "cart_on", "cart"),
    "grazes the wall": (bent("cart_on", 2, 2.0, 0.1, 0.9), "cart_on", "cart"),
    "rests before its time is over": (
        with_rows("cart_on", lambda f: f[: len(f) * 3 // 4]), "cart_on", "cart",
    ),
}  # fmt: skip


def said(problem, plan):
    """Return all that is said against a plan file, as (text, whether it tells when)."""
    found = [(line, True) for line in contradictions(problem, plan)]
    try:
        read = plan_from_dict(problem, plan)
    except ProblemError as error:
        return [*found, (str(error), True)]
    for v in validate_plan(problem, read, seconds_per_unit=plan["seconds_per_unit"]).violations:
        timed = v.time is not None or bool(WHEN.search(v.what))
        found.append((f"{v.kind} {v.what} {v.activities} {v.objects}", timed))
    return found


@pytest.mark.parametrize("kind", MUTATIONS)
def test_what_is_broken_is_caught_and_named(kind, made, data):
    spoil, name, thing = MUTATIONS[kind]
    plan = copy.deepcopy(data)
    spoil(plan)
    found = said(made.problem, plan)
    about = [(text, timed) for text, timed in found if name in text]
    assert about, found
    if thing is not None:
        assert any(thing in text.replace(name, "") and timed for text, timed in about), about


def test_the_plan_itself_is_good(made, data):
    assert said(made.problem, data) == []


def test_over_eighty_kinds_of_broken_plans_are_tried():
    from tests.io.test_wrong_plans import CONTRADICTIONS
    from tests.validation.test_mutations import MUTATIONS as OTHERS

    kinds = {*MUTATIONS, *OTHERS, *CONTRADICTIONS}
    assert len(kinds) == len(MUTATIONS) + len(OTHERS) + len(CONTRADICTIONS)
    assert len(kinds) >= 80
