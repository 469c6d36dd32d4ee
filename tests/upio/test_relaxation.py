import contextlib

import pytest
from unified_planning.model.motion import ActivityWaypoints, MotionActivity
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import LE, Equals, Fluent, IntType

from tests.upio.hall import Hall
from up_samp.model import Deadline, ScheduleStatus
from up_samp.model.refinement import (
    Absent,
    Apart,
    Clause,
    Elsewhere,
    Exclusive,
    Lasts,
    Layer,
    Overlap,
    Refinement,
    Requires,
    Strength,
    end_of,
    start_of,
)
from up_samp.scheduling import open_scheduler
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.world import places_between
from up_samp.upio import read_itinerary, read_problem, relax, write_refinement


def refine(relaxation, statement):
    write_refinement(relaxation, Refinement(statement, Layer.GROUP, Strength.PROVEN, "test"))


def solve(relaxation):
    return CpsatSession(relaxation.problem, workers=1).solve(Deadline.after(20.0))


@pytest.fixture
def shuttle(tmp_path):
    """One robot goes there and back; the door opens some time."""
    hall = Hall(tmp_path, robots=2, door=True)
    hall.move("there", 0, "left0", "right0", bounds=(5, 50))
    hall.move("back", 0, "right0", "left0", bounds=(5, 50))
    hall.move("other", 1, "left1", "right1", bounds=(5, 50))
    hall.open_door()
    snapshot = read_problem(hall.problem)
    return relax(hall.problem, snapshot)


def test_the_relaxation_is_plain(shuttle):
    assert type(shuttle.problem) is SchedulingProblem
    assert not any(isinstance(a, MotionActivity) for a in shuttle.problem.activities)
    assert "SAMP" not in shuttle.problem.kind.features
    assert not any(t.is_movable_type() for t in shuttle.problem.user_types)


def test_motions_of_one_object_follow_each_other(shuttle):
    report = solve(shuttle)
    assert report.status is ScheduleStatus.OPTIMAL
    assert report.schedule.times["there"][1] <= report.schedule.times["back"][0]
    assert report.schedule.makespan == 10
    itinerary = read_itinerary(shuttle, report.schedule)
    assert [m.activity for m in itinerary.motions if m.object == "r0"] == ["there", "back"]
    assert itinerary.places(shuttle.snapshot, "r0")[-1] == (10, "left0")


def test_a_fluent_that_tracks_the_object_serves_as_its_state(tmp_path):
    hall = Hall(tmp_path)
    problem = hall.problem
    at = problem.add_fluent("robot_at", hall.place, default_initial_value=hall.poses["left0"])
    move = hall.move("go", 0, "left0", "right0")
    move.add_condition(move.start, Equals(at, hall.poses["left0"]))
    move.add_effect(move.end, at, hall.poses["right0"])
    relaxation = relax(problem, read_problem(problem))
    assert str(relaxation.state["r0"]) == "robot_at"
    assert len(relaxation.problem.fluents) == 1


def test_a_fluent_that_is_set_a_unit_early_serves_too(tmp_path):
    hall = Hall(tmp_path)
    problem = hall.problem
    at = problem.add_fluent("robot_at", hall.place, default_initial_value=hall.poses["left0"])
    for name, here, there in (("go", "left0", "right0"), ("back", "right0", "left0")):
        move = hall.move(name, 0, here, there, bounds=(5, 9))
        move.add_condition(move.start, Equals(at, hall.poses[here]))
        move.add_effect(move.end - 1, at, hall.poses[there])
    relaxation = relax(problem, read_problem(problem))
    assert str(relaxation.state["r0"]) == "robot_at"
    assert relaxation.early == {"r0": 1}
    assert len(relaxation.problem.fluents) == 1
    assert solve(relaxation).schedule.times == {"go": (0, 5), "back": (5, 10)}


def _there_and_back(hall, bounds):
    """Two drives of at least 5 units whose durations are written as ``bounds`` say."""
    moves = [hall.move("go", 0, "left0", "right0"), hall.move("back", 0, "right0", "left0")]
    for move in moves:
        move.set_duration_bounds(*bounds)
        move.add_constraint(LE(move.start + 5, move.end))
    return moves


@pytest.mark.parametrize("written", ["constant", "zero", "fluent", "parameter"])
def test_drives_touch_however_their_durations_are_written(tmp_path, written):
    """A drive to another place takes time, whatever its bounds say: no unit is lost between."""
    hall = Hall(tmp_path)
    lasts = Fluent("lasts", IntType(0, 100), place=hall.place)
    hall.problem.add_fluent(lasts, default_initial_value=5)
    least = hall.problem.add_variable("least", IntType(2, 9))
    low = {"constant": 5, "zero": 0, "fluent": lasts(hall.poses["left0"]), "parameter": least}
    _there_and_back(hall, (low[written], 50))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert solve(relaxation).schedule.times == {"go": (0, 5), "back": (5, 10)}


@pytest.mark.parametrize("low", [0, 1])
@pytest.mark.parametrize("engine", ["cpsat", "aries"])
def test_drives_touch_that_start_where_a_fluent_says(tmp_path, low, engine):
    """Also where they may last no time, so that the fluent, set a unit early, is not the state."""
    hall = Hall(tmp_path)
    at = hall.problem.add_fluent("robot_at", hall.place, default_initial_value=hall.poses["left0"])
    for name, there in (("back", "left0"), ("go", "right0")):
        move = hall.problem.add_motion_activity(name)
        move.set_duration_bounds(low, 50)
        goal = hall.poses[there]
        move.add_motion_constraint(ActivityWaypoints(hall.robots[0], at, [goal]))
        move.add_constraint(LE(move.start + 5, move.end))
        move.add_effect(move.end - 1, at, goal)
    hall.problem.add_constraint(LE(move.end, hall.problem.get_activity("back").start))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    with contextlib.closing(open_scheduler(engine, relaxation.problem)) as scheduler:
        report = scheduler.solve(Deadline.after(20.0))
    # aries takes empty intervals for others, and is asked for a unit more
    assert report.schedule.makespan == 10 + (engine == "aries" and low == 0)


@pytest.mark.parametrize("first", [True, False], ids=["back_first", "go_first"])
@pytest.mark.parametrize("via", [None, "robot_at", "other", "place"])
@pytest.mark.parametrize("start", ["robot_at", "other", "place"])
def test_a_drive_waits_for_what_its_waypoints_tell_and_no_longer(tmp_path, start, via, first):
    """A fluent is read at the start: one that is set as another drive ends tells it a unit later.
    What a fluent in the middle tells is where the way leads through.
    """
    hall = Hall(tmp_path)
    left, right = hall.poses["left0"], hall.poses["right0"]
    named = {"place": right}
    named["robot_at"] = hall.problem.add_fluent("robot_at", hall.place, default_initial_value=left)
    named["other"] = hall.problem.add_fluent("other", hall.place, default_initial_value=right)
    ways = {"go": (left, [right]), "back": (named[start], [*([named[via]] if via else []), left])}
    for name in ("back", "go") if first else ("go", "back"):
        origin, waypoints = ways[name]
        move = hall.problem.add_motion_activity(name)
        move.set_duration_bounds(5, 50)
        move.add_motion_constraint(ActivityWaypoints(hall.robots[0], origin, waypoints))
        move.add_effect(move.end, named["robot_at"], waypoints[-1])
    if "robot_at" in (start, via):
        hall.problem.add_constraint(
            LE(hall.problem.get_activity("go").end, hall.problem.get_activity("back").start)
        )
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert str(relaxation.state["r0"]) == "robot_at"
    schedule = solve(relaxation).schedule
    late = "robot_at" in (start, via)
    assert schedule.times == {"go": (0, 5), "back": (5 + late, 10 + late)}
    motions = {m.activity: m.configurations for m in read_itinerary(relaxation, schedule).motions}
    assert motions["back"] == ("right0", *(["right0"] if via else []), "left0")


def test_who_takes_no_time_is_where_it_says(tmp_path):
    """Nothing is driven, but from there."""
    hall = Hall(tmp_path)
    look = hall.move("look", 0, "right0", "right0", bounds=(0, 0))
    glance = hall.move("glance", 0, "left0", "left0", bounds=(0, 9))
    go = hall.move("go", 0, "left0", "right0", bounds=(5, 50))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    times = solve(relaxation).schedule.times
    assert times[glance.name][1] <= times[go.name][0]
    assert times[go.name][1] <= times[look.name][0] <= 6
    hall.problem.add_constraint(LE(go.end, glance.start))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert solve(relaxation).status is ScheduleStatus.INFEASIBLE


def test_a_fluent_that_says_the_same_whoever_sets_it_is_read_all_the_same(tmp_path):
    hall = Hall(tmp_path)
    at = hall.problem.add_fluent("from", hall.place, default_initial_value=hall.poses["left0"])
    tell = hall.problem.add_activity("tell", 3)
    tell.add_effect(tell.end, at, hall.poses["left0"])
    go = hall.problem.add_motion_activity("go", 5)
    go.add_motion_constraint(ActivityWaypoints(hall.robots[0], at, [hall.poses["right0"]]))
    go.add_release_date(3)
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert solve(relaxation).schedule.makespan == 8
    hall.problem.add_constraint(LE(tell.end, 3))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert solve(relaxation).schedule.times["go"][0] == 4


def test_drives_touch_whatever_a_fluent_says_that_nobody_reads(tmp_path):
    hall = Hall(tmp_path)
    at = hall.problem.add_fluent("robot_at", hall.place, default_initial_value=hall.poses["left0"])
    moves = _there_and_back(hall, (1, 50))
    for move, there in zip(moves, ("right0", "left0"), strict=True):
        move.add_effect(move.end, at, hall.poses[there])
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert str(relaxation.state["r0"]) == "robot_at"
    assert solve(relaxation).schedule.times == {"go": (0, 5), "back": (5, 10)}
    look = hall.problem.add_activity("look", 1)
    look.add_condition(look.start, Equals(at, hall.poses["right0"]))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert solve(relaxation).schedule.times["look"][0] == 6


def test_a_drive_follows_a_lift_that_takes_no_time(tmp_path):
    """What takes no time sets the place at its end, and the next drive may begin just then."""
    hall = Hall(tmp_path)
    lift = hall.problem.add_motion_activity("lift", 0)
    lift.add_motion_effect(hall.robots[0], hall.poses["right0"])
    hall.move("go", 0, "right0", "left0", bounds=(5, 50))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    assert solve(relaxation).schedule.times == {"lift": (0, 0), "go": (0, 5)}


def test_a_motion_does_not_start_while_a_static_obstacles_fluent_lags(tmp_path):
    """The door opens at 1, and its fluent, set then, says so from 2 on."""
    for delay, start in ((0, 2), (-1, 1)):
        folder = tmp_path / str(start)
        folder.mkdir()
        hall = Hall(folder, door=True)
        problem = hall.problem
        shut, away = hall.poses["shut"], hall.poses["away"]
        at = problem.add_fluent("door_at", hall.place, default_initial_value=shut)
        opening = hall.open_door()
        opening.add_effect(opening.end + delay, at, away)
        move = hall.move(
            "go", 0, "left0", "right0", bounds=(5, 50), static_obstacles={hall.door: at}
        )
        relaxation = relax(problem, read_problem(problem))
        refine(relaxation, Requires("go", "door", "shut"))
        assert solve(relaxation).schedule.times["go"][0] == start, move


def test_a_fluent_that_others_change_does_not(tmp_path):
    hall = Hall(tmp_path)
    problem = hall.problem
    at = problem.add_fluent("robot_at", hall.place, default_initial_value=hall.poses["left0"])
    move = hall.move("go", 0, "left0", "right0")
    move.add_effect(move.end, at, hall.poses["right0"])
    reset = problem.add_activity("reset", 1)
    reset.add_effect(reset.end, at, hall.poses["left0"])
    relaxation = relax(problem, read_problem(problem))
    assert str(relaxation.state["r0"]) == "samp_at_r0"


STATEMENTS = [
    (Lasts("there", 9), 14),
    (Requires("there", "door", "shut"), 11),
    (Requires("there", "door", "shut", at_end=True), 10),
    (Clause((Apart(end_of("back"), start_of("other"), 3),)), 18),
    (Clause((Apart(start_of("other"), start_of("there"), -2),)), 10),
    (Clause((Elsewhere("other", "door", "shut"),)), 10),
    (Clause((Elsewhere("other", "r0", "left0"),)), 11),
    (Clause((Overlap("other", ("back",)), Absent("other"))), 10),
]


@pytest.mark.parametrize(("statement", "makespan"), STATEMENTS, ids=lambda x: str(x)[:40])
def test_each_statement_binds_the_scheduler(shuttle, statement, makespan):
    refine(shuttle, statement)
    report = solve(shuttle)
    assert report.status is ScheduleStatus.OPTIMAL
    assert report.schedule.makespan == makespan
    itinerary = read_itinerary(shuttle, report.schedule)

    def places(name, first, last):
        return places_between(itinerary, shuttle.snapshot, name, first, last)

    assert statement.holds(report.schedule, places)


def test_a_place_for_one_keeps_arrivals_apart(tmp_path):
    hall = Hall(tmp_path, robots=2)
    hall.pose("shared", 15.0, 5.0, 0.0)
    hall.move("in0", 0, "left0", "shared", bounds=(5, 50))
    hall.move("out0", 0, "shared", "right0", bounds=(4, 50))
    hall.move("in1", 1, "left1", "shared", bounds=(5, 50))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    statement = Exclusive("shared", frozenset({"in0", "in1"}), frozenset({"out0"}), False)
    refine(relaxation, statement)
    report = solve(relaxation)
    times = report.schedule.times
    assert times["out0"][0] < times["in1"][1]
    assert statement.holds(report.schedule, lambda *_: set())


def test_nobody_passes_through_a_place_for_one_while_another_rests_there(tmp_path):
    hall = Hall(tmp_path, robots=2)
    hall.pose("shared", 15.0, 5.0, 0.0)
    hall.move("in0", 0, "left0", "shared", bounds=(5, 5))
    hall.move("out0", 0, "shared", "right0", bounds=(4, 50))
    hall.move("in1", 1, "left1", "shared", bounds=(5, 50))
    hall.move("out1", 1, "shared", "right1", bounds=(4, 50))
    relaxation = relax(hall.problem, read_problem(hall.problem))
    names = [frozenset({f"{what}{i}" for i in range(2)}) for what in ("in", "out")]
    refine(relaxation, Exclusive("shared", *names, False))
    activities = relaxation.activities
    manager = hall.problem.environment.expression_manager
    for earlier, later in (("in0", "in1"), ("in1", "out0")):
        end = activities[later].end if later == "in1" else activities[later].start
        relaxation.problem.add_constraint(manager.LE(activities[earlier].end, end))
    relaxation.problem.add_constraint(
        manager.Equals(activities["in1"].end, activities["out1"].start)
    )
    assert solve(relaxation).status is ScheduleStatus.INFEASIBLE


def test_too_long_means_absent(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0", bounds=(5, 8), optional=True)
    relaxation = relax(hall.problem, read_problem(hall.problem))
    hall_go = relaxation.activities["go"]
    refine(relaxation, Lasts("go", 9))
    report = solve(relaxation)
    assert "go" not in report.schedule.times
    relaxation.problem.add_constraint(hall_go.present)
    assert solve(relaxation).status is ScheduleStatus.INFEASIBLE


def test_the_relaxation_solves_with_aries_too(shuttle):
    scheduler = open_scheduler("aries", shuttle.problem)
    try:
        report = scheduler.solve(Deadline.after(30.0))
    finally:
        scheduler.close()
    assert report.schedule is not None
    assert report.schedule.times["there"][1] <= report.schedule.times["back"][0]


def test_names_used_in_statements_exist(shuttle):
    with pytest.raises(KeyError):
        refine(shuttle, Lasts("nobody", 3))
