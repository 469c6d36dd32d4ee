"""What is left of a problem: solved, drawn up after breakdowns, and what falls away with them."""

import time

import pytest
from unified_planning.model import Fluent, TimePointInterval, Timing
from unified_planning.model.motion import ConfigurationObject, SchedulingMotionProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import (
    LE,
    BoolType,
    Equals,
    Iff,
    IntType,
    Not,
    OneshotPlanner,
    Or,
    Plus,
    UserType,
    get_environment,
)

import up_samp  # noqa: F401
from tests.execution.floors import hall
from tests.fleet.floors import WALL, map_with
from tests.fleet.test_rules import one_room
from tests.metamorphic.motions import ALIKE, OTHERS, MotionStyle, MotionWriter
from tests.metamorphic.sites import store
from tests.upio.hall import Hall
from up_samp.benchmarks import instance
from up_samp.execution import Delays, Executor, Surprise, dependencies_of, solve_remaining
from up_samp.execution.simulate import Floor
from up_samp.fleet import Fleet
from up_samp.fleet.files import write_starter
from up_samp.io import plan_to_dict, result_to_dict
from up_samp.model import ProblemError
from up_samp.validation import terms_of, validate_plan

NAME = "logistics-do-oc-r2-i2"


@pytest.fixture(scope="module")
def made():
    get_environment().credits_stream = None
    problem = instance(NAME).build()
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=120)
    return problem, result_to_dict(problem, result)


@pytest.fixture
def floor(made):
    """The plan on the floor with slow robots, when a good third of it is over."""
    problem, plan = made
    found = dependencies_of(problem, plan)
    executor = Executor(plan, problem, dependencies=found)
    floor = Floor(executor, Delays(slow=0.4), 3)
    while floor.now < 0.4 * plan["makespan"]:
        floor.step()
    return floor


def solved(problem):
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=120)
    assert result.plan is not None, result.log_messages
    assert validate_plan(problem, result.plan).valid
    return result_to_dict(problem, result)


def test_the_rest_is_planned_anew_and_carried_out(floor):
    executor = floor.executive
    left = executor.remaining_problem(Surprise(same_choices=True))
    names = {a.name for a in left.problem.activities}
    phases = {n: executor.phase(n).value for n in executor.state.phase}
    assert names == {n for n, p in phases.items() if p != "done"}
    begun = {n for n, p in phases.items() if p == "running"}
    assert begun
    assert left.since >= executor.now
    for robot in floor.robots.values():
        # where it is to stand is ahead of it, where it can stop
        way = executor.state.of_object.get(robot.name)
        if way is not None:
            assert robot.name in left.poses
    plan = solved(left.problem)
    starts = {a["name"]: a["start"] for a in plan["activities"]}
    assert all(starts[n] == 0 for n in begun)
    again = dependencies_of(left.problem, plan)
    rest = Executor(plan, left.problem, dependencies=again)
    second = Floor(rest, Delays(slow=0.4), 3)
    while not rest.finished and second.now < 1000:
        second.step()
    assert rest.finished


def test_a_broken_robot_stands_in_the_way_and_does_nothing(floor):
    executor = floor.executive
    pose = (40.0, 50.0, 0.5)
    left = executor.remaining_problem(Surprise(broken={"robot1": pose}))
    assert left.poses["robot1"] == pytest.approx(pose)
    assert not [a.name for a in left.problem.activities if "_robot1_" in a.name]
    picks = [a.name for a in left.problem.activities if a.name.startswith("pick_robot0")]
    assert picks
    initial = {m.object().name: c.object() for m, c in left.problem.initial_configuration}
    assert isinstance(initial["robot1"], ConfigurationObject)
    assert initial["robot1"].name.startswith("now_robot1")
    assert any("broken robot" in note for note in left.notes)


def broken(style, tmp_path):
    """Each robot of a small site in turn is out of order, a little off its place."""
    writer = MotionWriter(store(0, robots=2, items=1), style, tmp_path)
    plan = solved(writer.problem)
    executor = Executor(plan, writer.problem)
    executor.commands(0.0)
    places = {m.object().name: c.object() for m, c in writer.problem.initial_configuration}
    for body in writer.bodies:
        x, y, theta = (float(v) for v in places[body.name].configuration)
        left = executor.remaining_problem(Surprise(broken={body.name: (x, y, theta + 0.05)}))
        rest = solve_remaining(left, seconds=120)
        truth = {a.name: writer.bodies[r].name for r, a in writer._doings()}
        assert {truth[a["name"]] for a in rest["activities"]} == {
            b.name for b in writer.bodies if b is not body
        }
        assert Executor(rest).commands(0.0)


def test_others_do_the_work_of_a_broken_robot(tmp_path):
    broken(MotionStyle(shuffled=3, alone="level", fluents="parameter"), tmp_path)
    broken(MotionStyle(fluents="precedences", obstacles="lists", hands="pairs"), tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("style", [s for s in [*ALIKE, *OTHERS] if s.obstacles != "none"], ids=str)
def test_others_do_the_work_of_a_broken_robot_in_every_style(style, tmp_path):
    broken(style, tmp_path)


def test_a_broken_robot_of_a_fleet_need_not_come_to_its_end(tmp_path):
    fleet = Fleet(hall(tmp_path))
    fleet.add_robot_type("agv", (0.8, 0.5), model="diff")
    for k in range(2):
        fleet.add_place(f"home{k}", 2, 3 + 3 * k)
        fleet.add_robot(f"r{k}", "agv", f"home{k}", end=f"home{k}")
    fleet.add_place("dock", 9, 3)
    fleet.add_task("look", "dock", duration=2)
    executor = Executor(fleet.solve(60, first_plan=True).data, fleet.problem)
    executor.commands(0.0)
    left = executor.remaining_problem(Surprise(broken={"r1": (2.0, 8.0, 0.0)}))
    assert left.notes == ("about a broken robot, dropped: (r1_at == home1)",)
    assert {m["object"] for m in solve_remaining(left, seconds=60)["motions"]} == {"r0"}


@pytest.mark.long
def test_the_rest_of_the_starter_is_solved_when_one_of_its_robots_breaks_down(tmp_path):
    """Who is under way uses its robot all the same: the scheduler finds its route by that."""
    write_starter(tmp_path)
    fleet = Fleet.from_file(tmp_path / "problem.yaml")
    # another plan may leave the broken robot where an order has to go
    plan = fleet.solve(300, workers=1, reproducible=True, first_plan=True).data
    found = dependencies_of(fleet.problem, plan)
    executor = Executor(plan, fleet.problem, dependencies=found)
    floor = Floor(executor, Delays(), 3)
    while floor.now < 12.0:
        floor.step()
    x, y, theta = executor.remaining_problem().poses["r1"]
    left = executor.remaining_problem(Surprise(broken={"r1": (x, y, theta)}))
    used = {left.problem.fluent(f"busy@{r}") for r in ("r1", "r2")}
    assert all(left.problem.initial_value(u()).constant_value() == 1 for u in used)
    begun = time.process_time()
    rest = solve_remaining(left, seconds=60)
    assert time.process_time() - begun < 20.0
    assert {a["name"] for a in rest["activities"]} >= {"deliver_o1_r2", "deliver_o2_r2"}


def test_effects_some_time_after_a_start_are_still_to_come(tmp_path):
    hall = Hall(tmp_path, robots=2)
    hall.move("go", 0, "left0", "right0", bounds=(1, 100))
    hall.move("after", 1, "left1", "right1", bounds=(1, 100))
    shut = hall.problem.add_fluent("shut", BoolType(), default_initial_value=True)
    work = hall.problem.add_activity("work", 20)
    work.add_effect(Timing(16, work.start), shut, False)
    after = hall.problem.get_activity("after")
    after.add_condition(TimePointInterval(after.start), Not(shut()))
    executor = Executor(solved(hall.problem), hall.problem)
    executor.commands(0.0)
    for now in range(1, 5):
        executor.commands(float(now))
    left = executor.remaining_problem()
    (work,) = (a for a in left.problem.activities if a.name == "work")
    assert [t.delay for t in work.effects] == [16 - left.since]
    starts = {a["name"]: a["start"] for a in solved(left.problem)["activities"]}
    assert starts["after"] > 16 - left.since


def test_a_deadline_that_what_has_begun_will_miss_is_told_and_dropped(tmp_path):
    """It was a proof that nothing of the rest can be done, for ever."""
    hall = Hall(tmp_path, robots=1)
    hall.move("go", 0, "left0", "right0", bounds=(1, 100))
    work = hall.problem.add_activity("work", 20)
    other = hall.problem.add_activity("other", 2)
    work.add_constraint(LE(work.end, 22))
    hall.problem.add_constraint(LE(other.end, Plus(work.start, 100)))
    executor = Executor(solved(hall.problem), hall.problem)
    for now in range(5, 9):
        executor.commands(float(now))
    left = executor.remaining_problem()
    assert left.notes == ("already broken, dropped: (end(work) <= 22)",)
    ends = {a["name"]: a["end"] for a in solved(left.problem)["activities"]}
    assert ends["work"] == 25 - left.since


def test_values_that_a_fluent_cannot_have_are_told(made):
    problem, plan = made
    changed = problem.clone()
    room = changed.add_fluent("room", IntType(0, 1), default_initial_value=0)
    first = next(a for a in plan["activities"] if a["start"] == 0)["name"]
    activity = changed.get_activity(first)
    activity.add_decrease_effect(activity.start, room, 1)
    executor = Executor(plan, problem)
    executor.commands(0.0)
    executor.problem = changed
    with pytest.raises(ProblemError, match=f"'room' is -1 now, and may be 0 to 1.*'{first}'"):
        executor.remaining_problem()


def test_a_plan_of_another_encoding_is_told(made):
    _, plan = made
    for encoding in ("fluents", "no-fluents"):
        problem = instance("jobshop-r2-j1-m1").build(encoding, True)
        with pytest.raises(ProblemError, match="is of another problem, or of another encoding"):
            Executor(plan, problem)


def test_what_is_not_optional_and_needs_a_broken_robot_is_told(tmp_path):
    hall = Hall(tmp_path, robots=2)
    for k in range(2):
        hall.move(f"go{k}", k, f"left{k}", f"right{k}", bounds=(1, 100))
    executor = Executor(solved(hall.problem), hall.problem)
    executor.commands(0.0)
    x, y, theta = (float(v) for v in hall.poses["left1"].configuration)
    left = executor.remaining_problem(Surprise(broken={"r1": (x, y, theta)}))
    assert left.notes == ("not optional, and cannot happen any more, dropped: 'go1'",)
    assert [a.name for a in left.problem.activities] == ["go0"]


def test_what_only_a_broken_robot_could_do_is_named(made):
    """Both robots are out of order: nobody can fetch the items."""
    problem, plan = made
    executor = Executor(plan, problem)
    executor.commands(0.0)
    poses = {"robot0": (20.0, 59.0, 1.57), "robot1": (30.0, 59.0, 1.57)}
    with pytest.raises(ProblemError, match=r"nothing can keep .*pick_robot0_item"):
        executor.remaining_problem(Surprise(broken=poses))


@pytest.mark.parametrize(
    ("pose", "told"),
    [
        ((9.4, 3.2, 0.0), r"_dock_to_home0 absent \(at 'dock' .* collides with 'r1'\)"),
        ((2.2, 3.3, 0.0), r"_to_home0 absent \(at 'home0' .* collides with 'r1'\)"),
        ((8.0, 4.5, 1.57), r"absent \(from '\w+' to '\w+' no free way past r1\)"),
    ],
)
def test_what_a_broken_robot_blocks_is_named(pose, told, tmp_path):
    """It stands where another one has to deliver, where that one has to end, or in the doorway."""
    site = Fleet(map_with(WALL, tmp_path) if pose[0] == 8.0 else hall(tmp_path))
    for k, length in enumerate((0.8, 1.8)):
        site.add_robot_type(f"agv{k}", (length, 0.5), model="diff")
        site.add_place(f"home{k}", 2, 3 + 3 * k)
        site.add_robot(f"r{k}", f"agv{k}", f"home{k}", end=["home0", None][k])
    site.add_place("dock", 9, 3)
    site.add_place("shelf", 9.5, 7.5)
    site.add_order("o1", "shelf", "dock", robots="r0")
    site.add_task("look", "shelf", duration=2, robots="r1")
    executor = Executor(site.solve(60, first_plan=True).data, site.problem)
    executor.commands(0.0)
    if pose[0] == 2.2:  # r0 has left there
        way = executor.state.of_object["r0"]
        for k in range(1, 40):
            executor.update("r0", progress=0.1 * k, now=0.2 * k)
        assert way.told > 2.0
    left = executor.remaining_problem(Surprise(broken={"r1": pose}))
    with pytest.raises(ProblemError, match=rf"UNSOLVABLE_PROVEN\): .*{told}"):
        solve_remaining(left, seconds=60)


@pytest.mark.parametrize("robots", [1, pytest.param(2, marks=pytest.mark.long)])
def test_what_is_left_costs_what_the_whole_does(robots):
    """A plan of several terms is followed, and what is left counts from where it began."""
    terms = {"tardiness": 10, "driving": 1, "completion": 1, "makespan": 2, "robots": 3}
    site = one_room(robots, objective=terms)
    site.add_order("o1", "a", "b", due=10)
    site.add_order("o2", "b", "c", due=20, optional=True, penalty=500)
    site.add_task("t", "c", duration=3, due=30, after="o1")
    result = site.solve(60, optimal=True)
    floor = Floor(Executor(result.data, site.problem), Delays(), 1)
    # a unit later: two orders are late, three things done later, all is over later, and the drive
    # under way has lasted longer
    rate = 2 * terms["tardiness"] + 3 * terms["completion"] + terms["makespan"] + terms["driving"]
    for until in (0.0, 6.0):
        while floor.now < until:
            floor.step()
        left = floor.executive.remaining_problem()
        with OneshotPlanner(name="samp-refine[cpsat]", params={"optimal": True}) as planner:
            rest = planner.solve(left.problem, timeout=60).plan
        assert validate_plan(left.problem, rest).valid
        costs = terms_of(left.problem, rest)
        assert costs.keys() == result.costs.keys()
        later = left.since - until  # robots come to rest first
        assert abs(float(sum(costs.values())) - sum(result.costs.values())) <= rate * later


def test_cancelled_tasks_take_their_constraints_with_them(made):
    problem, plan = made
    executor = Executor(plan, problem)
    executor.commands(0.0)
    names = [a.name for a in problem.activities]
    picks = [n for n in names if n.startswith("pick_") and n.endswith("_item1")]
    left = executor.remaining_problem(Surprise(cancelled=picks))
    assert not {a.name for a in left.problem.activities} & set(picks)
    assert any("about cancelled tasks" in note for note in left.notes)
    begun = next(n for n in executor.state.phase if executor.phase(n).value == "running")
    with pytest.raises(ProblemError, match="cannot be cancelled: it has begun"):
        executor.remaining_problem(Surprise(cancelled=[begun]))
    with pytest.raises(ProblemError, match="no activity of"):
        executor.remaining_problem(Surprise(cancelled=["nothing"]))


def test_a_door_stays_shut_and_a_task_is_new():
    problem = instance("logistics-dc-all-r2-i2").build()
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=120)
    executor = Executor(result_to_dict(problem, result), problem)
    executor.commands(0.0)

    def add(target):
        target.add_activity("sweep", 5)

    left = executor.remaining_problem(Surprise(shut=["door0"], new=[add]))
    names = {a.name for a in left.problem.activities}
    assert "sweep" in names
    assert not [n for n in names if n.startswith("open_door")]
    with pytest.raises(ProblemError, match="'gate' is no object"):
        executor.remaining_problem(Surprise(shut=["gate"]))


CHOICES = {
    "same": lambda a, b, n: Equals(a[0], b[0]),
    "other": lambda a, b, n: Not(Equals(a[0], b[0])),
    "numbers": lambda a, b, n: LE(n(a[0]), n(b[0])),
    "number": lambda a, b, n: LE(Plus(n(a[0]), 1), 3),
    "iff": lambda a, b, n: Iff(a[1], b[1]),
    "flag": lambda a, b, n: a[1],
    "or": lambda a, b, n: Or(a[1], Not(b[1])),
}


@pytest.mark.parametrize("asked", ["constraint", "condition"])
@pytest.mark.parametrize("over", [True, False])
@pytest.mark.parametrize("choice", CHOICES)
def test_what_others_have_chosen_is_known_or_asks_nothing(choice, over, asked):
    """What is asked of parameters of what is over, and of what is cancelled and so has none."""
    problem = SchedulingMotionProblem("choices")
    spot = UserType("Spot")
    spots = [problem.add_object(name, spot) for name in ("left", "right")]
    n = problem.add_fluent(Fluent("n", IntType(0, 9), spot=spot), default_initial_value=2)
    tasks = [problem.add_activity(name, 2, name == "first") for name in ("first", "then")]
    chosen = [(t.add_parameter("s", spot), t.add_parameter("f", BoolType())) for t in tasks]
    if asked == "constraint":
        problem.add_constraint(CHOICES[choice](*chosen, n))
    else:
        tasks[1].add_condition(tasks[1].start, CHOICES[choice](*chosen, n))
    values = {tasks[0].start: 0, tasks[0].end: 2, tasks[1].start: 2, tasks[1].end: 4}
    for (place, flag), other in zip(chosen, (False, choice == "other"), strict=True):
        values |= {place: spots[int(other)], flag: True}
    plan = plan_to_dict(problem, Schedule(tasks, values))
    executor = Executor(plan, problem)
    if over:
        executor.commands(0.0)
        assert executor.done("first", 2.0).heard.value == "taken"
        executor.commands(2.0)
    left = executor.remaining_problem(Surprise(cancelled=() if over else ("first",)))
    found = solve_remaining(left, seconds=20.0)
    assert [a["name"] for a in found["activities"]] == ["then"]
    told = found["activities"][0]["parameters"]
    if over and choice in ("same", "other"):
        assert told["s"] == ("right" if choice == "other" else "left")
    if over and choice == "iff":
        assert told["f"] is True
