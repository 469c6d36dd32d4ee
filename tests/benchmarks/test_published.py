"""The published forms: as many activities as published, and how they are written."""

import itertools
import math

import pytest
from unified_planning.model.motion import MotionModels

from up_samp.benchmarks import (
    door_sequence,
    instance,
    instances,
    job_shop,
    kitting,
    logistics,
    navigation,
)
from up_samp.benchmarks.instances import ENCODINGS
from up_samp.model import ProblemError
from up_samp.upio import read_problem


def conditions(a):
    return {(str(when), str(c)) for when, cs in a.conditions.items() for c in cs}


def effects(a):
    return {(str(when), str(e)) for when, es in a.effects.items() for e in es}


def kinds(problem):
    return [a.name.split("_")[0] for a in problem.activities]


def test_logistics_has_one_pick_per_robot_and_item():
    problem = logistics(2, 4, encoding="fluents")
    assert len(problem.activities) == 62
    assert kinds(problem).count("pick") == 8
    pick = problem.get_activity("pick_robot0_item2")
    assert (pick.duration.lower.constant_value(), pick.duration.upper.constant_value()) == (1, 1)
    assert conditions(pick) == {
        ("[start(pick_robot0_item2)]", "((robot0_at == item2_in) or (robot0_at == item2_out))"),
        ("[start(pick_robot0_item2)]", "robot0_is_free"),
    }
    assert effects(pick) == {("end(pick_robot0_item2) - 1", "robot0_is_free := false")}


def test_a_published_move():
    problem = logistics(2, 1, sides="corridor", encoding="fluents")
    move = problem.get_activity("move_robot0_item0_in_to_robot0_depot")
    name = move.name
    assert conditions(move) == {(f"[start({name})]", "(robot0_at == item0_in)")}
    assert effects(move) == {
        (f"end({name}) - 1", "robot0_at := robot0_depot"),
        (f"end({name}) - 1", "robot0_is_free := true"),
    }
    assert {str(k): str(v) for k, v in move.motion_effects.items()} == {"robot0": "robot0_depot"}
    (constraint,) = move.motion_constraints
    assert {k.name: v.name for k, v in constraint.static_obstacles.items()} == {"door0": "door0_at"}
    assert {k.name: v.name for k, v in constraint.dynamic_obstacles_at_start.items()} == {
        "robot1": "robot1_at"
    }
    # 47.43 m: at 0.5 m/s^2 rest to rest floor(19.48) s, at 1 m/s 48 s
    distance = math.dist((20, 59), (59, 32))
    assert move.duration.lower.constant_value() == math.floor(2 * math.sqrt(distance / 0.5)) == 19
    assert move.duration.upper.constant_value() == math.ceil(distance) == 48


def test_what_robots_are():
    robot = logistics(1, 1, encoding="fluents").object("robot0")
    assert robot.motion_model is MotionModels.REEDSSHEPP
    assert robot.motion_parameters == {"turning_radius": 1.0}
    rates = [0.0, 0.0, 0.0]
    robot.control_model([0.0, 0.0, math.pi / 2], [2.0, 0.5], rates)
    assert rates == pytest.approx([0.0, 2.0, math.tan(0.5)])  # the bicycle is 2 m long
    limits = read_problem(logistics(1, 1, encoding="fluents")).objects["robot0"].body.kinematics
    assert limits.v_max == 20.0
    assert limits.turning_radius == pytest.approx(2.0 / math.tan(1.0))
    assert kitting(1, 1, 1, 2).object("robot0").motion_model is MotionModels.SE2
    assert door_sequence(1, 1).object("robot0").motion_parameters == {"turning_radius": 4.0}


def test_the_door_may_be_opened_again_by_anybody():
    problem = logistics(2, 1, encoding="fluents")
    for r in (0, 1):
        opening = problem.get_activity(f"open_door0_robot{r}")
        assert conditions(opening) == {
            (f"[start({opening.name})]", f"(robot{r}_at == door0_button)")
        }
        assert effects(opening) == {(f"end({opening.name}) - 1", "door0_at := door0_open")}
        assert {str(v) for v in opening.motion_effects.values()} == {"door0_open"}


def test_job_shops_move_between_all_places():
    problem = job_shop(2, 2, 4, encoding="fluents")
    places = 4 + 4 + 2  # machines, buttons and both robots' starts
    assert kinds(problem).count("move") == 2 * places * (places - 1)
    assert kinds(problem).count("open") == 2 * 4
    assert len(problem.activities) == 2 * places * (places - 1) + 2 * 4 + 2 * 8
    route = [a.name for a in problem.activities if a.name.startswith("r1_j0_")]
    assert [n.split("_")[2] for n in route] == ["t0", "t1", "t2", "t3"]
    later = problem.get_activity(route[1])
    assert {str(when) for when in later.conditions} == {f"[start({later.name})]"}
    constraints = [str(c) for c, _ in later.scoped_constraints]
    earlier = [route[0].replace("r1", f"r{r}") for r in (0, 1)]
    wanted = " and ".join(
        f"(present({e}) implies (end({e}) <= start({later.name})))" for e in earlier
    )
    assert constraints == [f"({wanted})"]


@pytest.mark.parametrize("family", ["logistics", "jobshop"])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_variants_say_one_at_a_time_in_their_way(family, encoding):
    build = logistics if family == "logistics" else job_shop
    size = (2, 2) if family == "logistics" else (2, 2, 1)
    problem, plain = build(*size, encoding=encoding), build(*size, encoding="fluents")
    assert [a.name for a in problem.activities] == [a.name for a in plain.activities]
    names = {f.name for f in problem.fluents}
    assert ("robot0_at" in names) == encoding.startswith("fluents")
    tokens = {f"{o}_free" for o in ("robot0", "robot1", "door0")}
    assert tokens <= names if encoding.endswith("-uses") else not tokens & names
    assert ("sequential_schedule" in names) == encoding.endswith("-sequential")
    pairwise = [c for c, scope in problem.base_scoped_constraints if len(scope) == 2]
    assert bool(pairwise) != encoding.endswith("-uses")
    lists = [c for a in problem.motion_activities for c in a.motion_constraints]
    assert all(
        isinstance(c.static_obstacles, dict) == encoding.startswith("fluents") for c in lists
    )


def holds(node, times):
    """Whether an expression over starts, ends and presences is true (all times present)."""
    args = [holds(a, times) for a in node.args]
    if node.is_present_exp():
        return node.presence().container in times
    if node.is_timing_exp():
        point = node.timing().timepoint
        pair = times.get(point.container)
        return None if pair is None else pair["START" not in point.kind.name]
    if node.is_and():
        return all(args)
    if node.is_or():
        return any(args)
    if node.is_implies():
        return not args[0] or args[1]
    assert node.is_le()
    return None not in args and args[0] <= args[1]


def test_without_fluents_a_move_needs_a_helper_and_no_rival_in_between():
    problem = logistics(1, 2, sides="corridor", encoding="no-fluents")
    home = "move_robot0_item0_in_to_robot0_depot"
    out, other = "move_robot0_robot0_depot_to_item0_in", "move_robot0_robot0_depot_to_item1_in"
    (need,) = [
        c
        for c, scope in problem.base_scoped_constraints
        if [str(s) for s in scope] == [f"present({home})"]
    ]
    assert holds(need, {out: (0, 10), home: (12, 20)})
    assert holds(need, {out: (0, 10), home: (12, 20), other: (20, 30)})
    assert not holds(need, {home: (12, 20)})
    assert not holds(need, {out: (13, 14), home: (12, 20)})
    assert not holds(need, {out: (0, 3), other: (3, 10), home: (12, 20)})


def test_without_fluents_hands_are_free_after_leaving_the_depot():
    problem = logistics(1, 2, sides="corridor", encoding="no-fluents")
    pick, other = "pick_robot0_item0", "pick_robot0_item1"
    needs = [
        c
        for c, scope in problem.base_scoped_constraints
        if [str(s) for s in scope] == [f"present({pick})"]
    ]
    assert len(needs) == 3  # at the pose; free hands; brought home
    out, again = "move_robot0_robot0_depot_to_item0_in", "move_robot0_robot0_depot_to_item1_in"
    home = "move_robot0_item0_in_to_robot0_depot"
    good = {out: (0, 5), pick: (5, 6), home: (6, 9), again: (9, 12), other: (12, 13)}
    assert all(holds(c, good) for c in needs)
    assert not all(holds(c, {**good, other: (4, 5)}) for c in needs)
    without = {k: v for k, v in good.items() if k != home}
    assert not all(holds(c, without) for c in needs)


def test_navigation():
    problem = navigation(4)
    assert len(problem.activities) == 4
    for r, move in enumerate(problem.activities):
        (constraint,) = move.motion_constraints
        assert constraint.static_obstacles is constraint.dynamic_obstacles_at_start is None
        assert (f"end({move.name}) - 1", f"robot{r}_at := robot{r}_goal") in effects(move)
    ys = [problem.object(f"robot{r}_start").configuration.y for r in range(4)]
    assert ys == sorted(ys)
    assert len(instances("navigation")) == 9
    with pytest.raises(ProblemError, match="navigation takes"):
        navigation(11)


def test_kitting():
    problem = kitting(2, 2, 3, 2)
    # per robot: start, 6 parts and 2 buttons; 2 doors; 2 x (3 loads and an unload)
    assert len(problem.activities) == 2 * (9 * 8 + 2 + 8) + 2
    initial = [str(place) for _, place in problem.initial_configuration]
    closed = {n: tuple(problem.object(n).configuration) for n in initial if "door" in n}
    assert closed == {
        "door0_closed": (25.0, 11.0, math.pi / 2),
        "door1_closed": (25.0, 19.8, math.pi / 2),
    }
    assert tuple(problem.object("door1_open").configuration)[:2] == (18.0, 19.8)
    assert tuple(problem.object("door1_button").configuration)[:2] == pytest.approx((25.0, 18.3))
    load = problem.get_activity("load_robot1_kit0_part1")
    assert load.duration.lower.constant_value() == 5
    assert [v.name for v in problem.base_variables] == [
        "robot0_builds_kit0",
        "robot1_builds_kit0",
        "robot0_builds_kit1",
        "robot1_builds_kit1",
    ]
    prepare = problem.get_activity("prepare_unload_kit1")
    assert not prepare.optional
    assert prepare.duration.lower.constant_value() == 30
    unload = problem.get_activity("unload_robot1_kit0")
    inside = {str(c) for c, _ in unload.scoped_constraints}
    assert "((10 + start(prepare_unload_kit0)) <= start(unload_robot1_kit0))" in inside or (
        "((start(prepare_unload_kit0) + 10) <= start(unload_robot1_kit0))" in inside
    )
    move = problem.get_activity("move_robot0_robot0_start_to_door0_button")
    assert effects(move) == {(f"end({move.name})", "robot0_at := door0_button")}
    operators = instance("kitting-r1-k1-p2-d2-op").build()
    assert "operator" in {f.name for f in operators.fluents}
    with pytest.raises(ProblemError, match="doors"):
        kitting(1, 1, 1, 3)


def test_doors_in_sequence():
    problem = door_sequence(3, 2)
    assert kinds(problem).count("move") == 3 * 8 * 7
    places = {
        o.name: tuple(o.configuration)
        for o in problem.all_objects
        if "door" in o.name and "_" in o.name
    }
    assert places["door1_closed"] == (26.3, 15.0, 0.0)
    assert places["door1_open"] == (26.3, 21.0, 0.0)
    assert places["door1_button"] == (22.2, 15.0, -math.pi / 2)
    for r in range(3):
        x, y, heading = problem.object(f"robot{r}_start").configuration
        assert 2 <= x <= 13
        assert 2 <= y <= 28
        assert abs(heading) == math.pi / 2
        assert problem.object(f"robot{r}_goal").configuration.x > 26.3
    drawn = [door_sequence(2, 1, seed=s).object("robot0_start").configuration for s in (1, 1, 2)]
    assert tuple(drawn[0]) == tuple(drawn[1]) != tuple(drawn[2])


@pytest.mark.parametrize("family", ["navigation", "kitting", "doors"])
def test_families_beside_the_paper_build_by_name(family):
    for chosen, encoding in itertools.product(instances(family)[:1], ENCODINGS):
        problem = chosen.build(encoding, False)
        assert problem.name == chosen.name
        assert len({a.name for a in problem.activities}) == len(problem.activities)
        assert read_problem(problem).tasks
