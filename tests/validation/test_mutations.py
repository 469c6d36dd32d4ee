"""Good plans with one thing broken: each is caught, with the activity, the object and the time.

What a plan file says beside its schedule and motions is mutated in tests/io/test_wrong_plans.py.
"""

import copy
import math
import re

import pytest

from tests import handmade
from up_samp.io import plan_from_dict, plan_to_dict
from up_samp.validation import validate_plan

WHEN = re.compile(r"\d s\b|\[-?\d+, -?\d+\]")
"""An instant, or the times of an activity."""

BUTTON, ITEM, CORNER = (
    "move_r0_depot0_to_button", "move_r0_button_to_item", "move_r1_depot1_to_corner",
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return handmade.make(tmp_path_factory.mktemp("hall"))


@pytest.fixture(scope="module")
def data(made):
    return plan_to_dict(made.problem, made.plan)


def rows(plan, activity):
    return next(m for m in plan["motions"] if m["activity"] == activity)["samples"]


def times(plan, activity):
    return next(a for a in plan["activities"] if a["name"] == activity)


def each(plan, activity, change):
    for i, row in enumerate(rows(plan, activity)):
        change(i, row)


def shift(column, by, activity):
    return lambda p: each(p, activity, lambda i, r: r.__setitem__(column, r[column] + by))


def one(column, by, activity, at):
    def spoil(plan):
        found = rows(plan, activity)
        found[round(at * (len(found) - 1))][column] += by

    return spoil


def faster(activity, factor):
    def spoil(plan):
        begin = rows(plan, activity)[0][0]
        each(plan, activity, lambda i, r: r.__setitem__(0, begin + (r[0] - begin) / factor))

    return spoil


def cut(activity, keep):
    def spoil(plan):
        found = rows(plan, activity)
        found[:] = found[keep]

    return spoil


def window(activity, **given):
    return lambda p: times(p, activity).update(given)


MUTATIONS = {
    "starts beside its start": (shift(2, 0.2, BUTTON), BUTTON, "r0"),
    "starts turned": (shift(3, 0.1, BUTTON), BUTTON, "r0"),
    "starts before its activity": (shift(0, -0.8, ITEM), ITEM, "r0"),
    "ends after its activity": (shift(0, 3.0, ITEM), ITEM, "r0"),
    "drives through a wall": (shift(2, 8.0, ITEM), ITEM, "r0"),
    "drives through a closed door": (
        lambda p: [window("open_door_r0", start=24, end=25)(p)], ITEM, "r0",
    ),
    "jumps aside in the middle": (one(2, 0.5, ITEM, 0.5), ITEM, "r0"),
    "turns in the middle": (one(3, 0.6, ITEM, 0.5), ITEM, "r0"),
    "turns round once more": (one(3, 2 * math.pi, CORNER, 1.0), CORNER, "r1"),
    "jumps ahead": (one(1, 0.8, BUTTON, 0.4), BUTTON, "r0"),
    "drives twice as fast": (faster(ITEM, 2.0), ITEM, "r0"),
    "drives a little too fast": (faster(BUTTON, 1.1), BUTTON, "r0"),
    "leaves out the end": (cut(BUTTON, slice(None, -30)), BUTTON, "r0"),
    "leaves out the start": (cut(BUTTON, slice(30, None)), BUTTON, "r0"),
    "leaves out the middle": (cut(ITEM, slice(None, None, 400)), ITEM, "r0"),
    "only the start": (cut(CORNER, slice(0, 1)), CORNER, "r1"),
    "ends somewhere else": (one(1, 0.3, CORNER, 1.0), CORNER, "r1"),
    "drives sideways": (
        lambda p: each(p, BUTTON, lambda i, r: r.__setitem__(3, 0.5 * math.pi)), BUTTON, "r0",
    ),
    "leaves the map": (shift(1, -40.0, CORNER), CORNER, "r1"),
    "too long an activity": (window(BUTTON, end=60), BUTTON, None),
    "too short an activity": (window("scan_shelves", end=5), "scan_shelves", None),
    "starts before time": (window("scan_shelves", start=-4, end=5), "scan_shelves", None),
    "ends before it starts": (window("pick_r0_item", start=26, end=24), "pick_r0_item", None),
    "a left-out activity that is needed": (
        lambda p: p["activities"].remove(times(p, "scan_shelves")), "scan_shelves", None,
    ),
    "two robots in one place": (
        lambda p: [shift(2, -8.0, CORNER)(p), shift(1, 0.0, CORNER)(p)], CORNER, "r1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", MUTATIONS)
def test_what_is_broken_is_caught_and_named(kind, made, data):
    spoil, activity, name = MUTATIONS[kind]
    plan = copy.deepcopy(data)
    spoil(plan)
    verdict = validate_plan(made.problem, plan_from_dict(made.problem, plan))
    assert not verdict.valid
    about = [v for v in verdict.violations if activity in v.activities or activity in v.what]
    assert about, verdict.violations
    if name is not None:
        named = [v for v in about if name in v.objects or name in v.what]
        assert named, about
        assert any(v.time is not None or WHEN.search(v.what) for v in named), named


def test_the_plan_itself_is_good(made, data):
    verdict = validate_plan(made.problem, plan_from_dict(made.problem, data))
    assert verdict.valid, verdict.violations
