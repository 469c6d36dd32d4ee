"""Where nobody can pass, that an order cannot change is proven, and nothing more than that."""

import itertools

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.motion.fleet.spacetime_oracle import room
from tests.search.rows import BOX, FLOORS, Row, aisle, drawn, problem_of, ring
from tests.soundness.known_plans import KnownPlan, NoPlanError
from up_samp.geometry import load_map
from up_samp.model import Body, Kinematics, MotionModel, Placed
from up_samp.motion import MotionService
from up_samp.upio import read_problem


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


def solve(problem, seconds=60.0):
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        return planner.solve(problem, timeout=seconds)


def wrong(floor, seed, folder):
    """Return what is wrong with the answer to the row of a seed (None: nothing)."""
    row = drawn(seed, floor)
    status = solve(problem_of(row, folder, seed)).status
    proven = status is Status.UNSOLVABLE_PROVEN
    return None if proven != row.solvable else f"{row} {status.name}"


@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize("seed", [1, 2, pytest.param(3, marks=pytest.mark.long)])
def test_a_row_is_unsolvable_where_its_order_changes(floor, seed, tmp_path):
    assert wrong(floor, seed, tmp_path) is None


@pytest.mark.long
@pytest.mark.parametrize("floor", FLOORS)
def test_rows_are_unsolvable_where_their_order_changes(floor, tmp_path):
    found = {seed: wrong(floor, seed, tmp_path) for seed in range(10, 40)}
    assert not {seed: why for seed, why in found.items() if why is not None}


def test_four_that_cannot_swap_are_told_why(tmp_path):
    row = Row(aisle(6), (0, 1, 4, 5), (5, 4, 1, 0))
    result = solve(problem_of(row, tmp_path, 1))
    assert result.status is Status.UNSOLVABLE_PROVEN
    assert "nobody passes anybody" in str(result.log_messages)


def test_one_that_is_parked_in_the_way_may_go_aside_only_if_that_helps(tmp_path):
    for aside, status in ((5, Status.SOLVED_OPTIMALLY), (3, Status.UNSOLVABLE_PROVEN)):
        row = Row(aisle(6), (0, 2), (4, aside), frozenset({1}))
        assert solve(problem_of(row, tmp_path, aside)).status is status


def test_two_pass_each_other_in_a_pocket_that_holds_one(tmp_path):
    row = Row(aisle(6, pocket=1.5), (0, 5), (5, 0))
    assert solve(problem_of(row, tmp_path)).plan is not None


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 40), marks=pytest.mark.long)])
def test_what_a_known_plan_does_is_never_called_impossible(seeds, tmp_path):
    for seed in seeds:
        try:
            world = KnownPlan(seed, tmp_path)
        except NoPlanError:
            continue
        snapshot = read_problem(world.problem, 0.1)
        service = MotionService(load_map(snapshot.map_file))
        body = snapshot.objects["r0"].body
        ends = [[tuple(map(float, d.motion.poses[k])) for d in world.drives] for k in (0, -1)]
        for count in (2, 3):
            for some in itertools.combinations(zip(*ends, strict=True), count):
                start, goal = zip(*some, strict=True)
                apart = service.in_order([Placed("", body, pose) for pose in start], ())
                assert apart is None or not apart(goal), seed


@pytest.mark.parametrize("heights", [(0.5, 2.0), (2.0, 0.5)])
def test_who_is_low_lets_others_pass_below_what_hangs_there(heights, tmp_path):
    """A shelf over the pocket bars it to the high one only: it may pass while the low one waits."""
    floor = aisle(6, pocket=1.5)
    size = (1.4, 1.4, 0.4)
    file = tmp_path / "shelf.stl"
    pytest.importorskip("trimesh").creation.box(size).export(file)
    middle = (floor.free[1][0] + floor.free[1][2]) / 2
    shelf = Body((), Kinematics(MotionModel.SE3), str(file))
    hangs = Placed("shelf", shelf, (middle, floor.free[0][3] + 0.75, 1.2, 0.0, 0.0, 0.0, 1.0))
    service = MotionService(room(15, 5, floor.free))
    low, high = (Body(BOX, Kinematics(MotionModel.SE2), height=h) for h in heights)
    start = [Placed("a", low, floor.places[0]), Placed("b", high, floor.places[5])]
    goal = (floor.places[5], floor.places[0])
    apart = service.in_order(start, [hangs])
    assert apart is None or not apart(goal)
    both = [Placed(one.name, Body(BOX, one.body.kinematics, height=2.0), one.pose) for one in start]
    assert service.in_order(both, [hangs])(goal)


def on_a_ring(floor, count, model=MotionModel.SE2):
    """Return what tells which of a ring's places so many robots do not reach together."""
    body = Body(BOX, Kinematics(model))
    start = [Placed(str(k), body, floor.places[2 * k]) for k in range(count)]
    return MotionService(room(8, 8, floor.free)).in_order(start, ())


@pytest.mark.parametrize("pocket", [0.0, 0.1])
def test_three_on_a_ring_keep_who_is_between_whom(pocket):
    floor = ring(pocket=pocket)
    apart = on_a_ring(floor, 3)
    for ends in itertools.permutations(range(6), 3):
        turned = sorted(range(3), key=lambda k: ends[k])
        kept = turned in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
        assert apart([floor.places[k] for k in ends]) != kept, ends


def test_who_leaves_by_another_name_of_its_place_makes_way(tmp_path):
    """The third one may not come before the first one has left where it began."""
    row = Row(ring(), (0, 2, 4), (3, 5, 1), called_otherwise=True)
    assert row.solvable
    result = solve(problem_of(row, tmp_path), 20.0)
    assert result.status is not Status.UNSOLVABLE_PROVEN, str(result.log_messages)


def test_two_on_a_ring_come_everywhere():
    floor = ring()
    apart = on_a_ring(floor, 2)
    assert not any(apart(ends) for ends in itertools.permutations(floor.places, 2))


@pytest.mark.parametrize("pocket", [0.9, 1.2, 1.5])
def test_who_has_a_bay_to_wait_in_may_come_in_any_order(pocket):
    """The same ring with one place to pass: nothing is impossible."""
    floor = ring(pocket=pocket)
    apart = on_a_ring(floor, 3)
    assert apart is None or not any(apart(e) for e in itertools.permutations(floor.places, 3))


def test_three_that_pass_in_the_bay_of_a_ring_are_driven_or_nothing_is_said(tmp_path):
    row = Row(ring(pocket=1.5), (0, 2, 4), (4, 2, 0))
    assert solve(problem_of(row, tmp_path), 10.0).status is not Status.UNSOLVABLE_PROVEN
