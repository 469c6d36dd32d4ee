"""A toy of each kind of part: added from outside of the package, used by a solve, taken away."""

import importlib.metadata
import itertools
import math

import numpy as np
import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.metrics import MinimizeExpressionOnFinalState, MinimizeMakespan
from unified_planning.model.motion import MotionModels, MovableObject
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.timing import Timing
from unified_planning.shortcuts import (
    LE,
    LT,
    Int,
    OneshotPlanner,
    Or,
    PlanValidator,
    get_environment,
)

from tests.search.test_components import crossing
from tests.upio.hall import ROBOT, Hall
from up_samp import extensions
from up_samp.cli import main
from up_samp.extensions import KINDS, extend, extended, parts, withdraw
from up_samp.fleet import Fleet
from up_samp.fleet.importers import Importer, import_file
from up_samp.fleet.importers.grids import import_movingai
from up_samp.model import MetricMeaning, MotionModel, ProblemError, Trajectory, UnsupportedError
from up_samp.model.refinement import Strength
from up_samp.motion import Leg
from up_samp.refinement import rules
from up_samp.scheduling.cpsat.encode.forms import constant
from up_samp.search.loop import keep_if_better
from up_samp.search.resolve import Subproblem
from up_samp.upio import read_itinerary
from up_samp.upio.objective import ObjectivePart
from up_samp.upio.restrict import restrict
from up_samp.validation import Violation, validate_plan

get_environment().credits_stream = None


@pytest.fixture(autouse=True)
def nothing_is_left():
    yield
    assert not any(parts(kind) for kind in KINDS)


def solve(problem, engine="samp-refine[cpsat]", **params):
    with OneshotPlanner(name=engine, params=params) as planner:
        return planner.solve(problem, timeout=120)


def makespan(result):
    return max(int(result.plan.get(a.end).constant_value()) for a in result.plan.activities)


# ------------------------------------------------------------------------------- importers
def read_rooms(source, folder, options):
    """A room of so many by so many cells, and one robot's way from a corner to the other."""
    columns, rows = map(int, source.read_text().split())
    cells = "\n".join("." * columns for _ in range(rows))
    text = f"type octile\nheight {rows}\nwidth {columns}\nmap\n{cells}\n"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "room.map").write_text(text)
    way = (0, "room.map", columns, rows, 1, 1, columns - 2, rows - 2, 10.0)
    (folder / "room.map.scen").write_text("version 1\n" + "\t".join(map(str, way)) + "\n")
    return import_movingai(folder / "room.map.scen", folder, options)


def test_an_importer(tmp_path, capsys):
    source = tmp_path / "hall.room"
    source.write_text("8 6")
    with pytest.raises(UnsupportedError, match="--kind"):
        import_file(source, tmp_path / "a")
    with extended("importers", "room", Importer(read_rooms, "a room", (".room",))):
        assert main(["import", str(source), "--out", str(tmp_path / "b")]) == 0
        result = Fleet.from_file(tmp_path / "b" / "problem.yaml").solve(first_plan=True)
        assert result.plan is not None, result.explain()
        source.write_text("8 doors")
        with pytest.raises(ProblemError, match="not readable as a room"):
            import_file(source, tmp_path / "c")


# ------------------------------------------------------------------------ rules of the validator
def not_before_noon(problem, plan):
    """Nothing begins before 12."""
    for activity in plan.activities:
        start = plan.get(activity.start).constant_value()
        if start < 12:
            yield Violation("early", f"{activity.name} begins at {start}", (activity.name,))


def test_a_rule_of_the_validator(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0")
    early = solve(hall.problem)
    assert early.status is Status.SOLVED_OPTIMALLY
    with extended("rules", "noon", not_before_noon):
        assert [v.kind for v in validate_plan(hall.problem, early.plan).violations] == ["early"]
        with PlanValidator(name="samp-validator") as judge:
            assert not judge.validate(hall.problem, early.plan)
        late = solve(
            hall.problem, stop=lambda state: state.rounds >= 3
        )  # what is refused becomes a cut
        assert late.status is not Status.SOLVED_OPTIMALLY
        if late.plan is not None:
            assert not list(not_before_noon(hall.problem, late.plan))
    assert validate_plan(hall.problem, early.plan).valid


def test_a_rule_that_names_no_activity(tmp_path):
    """What is refused is the schedule as it is timed, whatever of it the scheduler made up: that a
    door is open meanwhile, which may be shut again.
    """
    hall = Hall(tmp_path, door=True)
    opening, go = hall.open_door(), hall.move("go", 0, "left0", "right0")
    shut = hall.problem.add_motion_activity("close", 1, optional=True)
    shut.add_motion_effect(hall.door, hall.poses["shut"])
    hall.problem.add_constraint(LT(opening.end, go.start))

    def once(problem, plan):
        """The first plan of all is refused."""
        seen.append(plan)
        if len(seen) == 1:
            yield Violation("unlucky", "the first plan is no good")

    seen = []
    with extended("rules", "once", once):
        result = solve(hall.problem, first_plan=True)
    assert result.metrics["refused"] == "1"
    assert result.plan is not None


# ------------------------------------------------------- side constraints of the CP-SAT model
def shop():
    """Four tasks of 2 units, as few of which are done one after the other as nobody asks."""
    problem = SchedulingProblem("shop")
    for k in range(4):
        problem.add_activity(f"task{k}", 2)
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def starts_apart(model):
    """Two tasks begin 3 units apart at least."""
    tasks = [a for a in model.world.activities.values() if a.name.startswith("task")]
    gap = constant(3)
    for one, other in itertools.combinations(tasks, 2):
        yield ("|", one.start.plus(gap).le(other.start), other.start.plus(gap).le(one.start))


def test_a_side_constraint_of_the_model(tmp_path):
    assert makespan(solve(shop())) == 2
    with extended("constraints", "apart", starts_apart):
        result = solve(shop())
        assert result.status is Status.SOLVED_OPTIMALLY
        plan = result.plan
        starts = sorted(plan.get(a.start).constant_value() for a in plan.activities)
        assert starts == [0, 3, 6, 9]
    assert makespan(solve(shop())) == 2


def test_a_side_constraint_holds_for_a_plan_with_motions(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0")

    def later(model):
        return [constant(50).le(model.world.activities["go"].start)]

    soon = makespan(solve(hall.problem))
    with extended("constraints", "later", later):
        result = solve(hall.problem)
    assert result.status is Status.SOLVED_OPTIMALLY
    assert makespan(result) == soon + 50


# ------------------------------------------------------------------------------ objectives
class TotalStart(MinimizeExpressionOnFinalState):
    """All tasks begin as early as can be, in sum: UP has no such metric."""

    def __init__(self):
        super().__init__(Int(0))


def starts_of(metric, problem):
    manager = problem.environment.expression_manager
    for activity in problem.activities:
        yield ObjectivePart(1, manager.TimingExp(Timing(0, activity.start)))


TOTAL = MetricMeaning(
    TotalStart,
    "sum of starts",
    1,
    starts_of,
    lambda metric, timeline: sum(start for start, _ in timeline.decisions.times.values()),
)


def test_an_objective():
    problem = SchedulingProblem("line")
    lengths = (5, 1, 3)
    tasks = [problem.add_activity(f"t{k}", length) for k, length in enumerate(lengths)]
    for one, other in itertools.combinations(tasks, 2):
        problem.add_constraint(Or(LE(one.end, other.start), LE(other.end, one.start)))
    problem.add_quality_metric(TotalStart())
    with pytest.raises(UnsupportedError, match="metric"):
        solve(problem)
    with extended("objectives", "total start", TOTAL):
        result = solve(problem)
        assert result.status is Status.SOLVED_OPTIMALLY
        starts = [int(result.plan.get(t.start).constant_value()) for t in tasks]
        assert sum(starts) == 0 + 1 + 4 == starts[0] + starts[1] + starts[2]
        with PlanValidator(name="samp-validator") as judge:
            told = judge.validate(problem, result.plan)
        assert list(told.metric_evaluations.values()) == [5]


# ------------------------------------------------------------------- cuts and statements
def test_a_cut_is_asked_where_a_group_fails(tmp_path):
    asked = []

    def nothing_more(failure, late):
        asked.append((late, sorted(failure.scheduled)))
        return []

    with extended("cuts", "toy", nothing_more):
        solve(crossing(tmp_path), first_plan=True)
    assert asked
    assert all(late in group for late, group in asked)


def test_a_statement(tmp_path):
    hall = Hall(tmp_path)
    hall.move("go", 0, "left0", "right0")

    def speed_limit(search):
        return [rules.lasts("go", 40, "a speed limit", strength=Strength.PROVEN)]

    with extended("statements", "speed limit", speed_limit):
        assert makespan(solve(hall.problem)) >= 40
    assert makespan(solve(hall.problem)) < 40


# ------------------------------------------------------------------------------- improvers
def as_short_as_can_be(search, stuck):
    """Have the best plan's activities scheduled again, to end sooner."""
    best = search.bounds.incumbent
    problem = restrict(search.knowledge.relaxation, best.schedule)
    found = Subproblem(search, problem, 0.1).schedule(best.schedule)
    if found is not None and search.bounds.improves(found):
        itinerary = read_itinerary(search.knowledge.relaxation, found)
        check = search.checker.check(itinerary)
        made = search.plan_of(found, check.trajectories) if check.passed else None
        better = None if made is None else keep_if_better(search, made)
        yield from () if better is None else (better,)


def test_an_improver(tmp_path):
    asked = []

    def counted(search, stuck):
        asked.append(stuck)
        yield from as_short_as_can_be(search, stuck)

    with extended("improvers", "shorter", counted):
        result = solve(crossing(tmp_path), stop=lambda state: state.rounds >= 4, optimal=True)
    assert validate_plan(crossing(tmp_path), result.plan).valid
    assert asked


# --------------------------------------------------------- motion models, and who plans for them
def crab(state, control, rate):
    """A body that is pushed in any direction of the floor and does not turn."""
    rate[0], rate[1], rate[2] = control[0], control[1], 0.0


class Crab:
    """Straight on at half its speed, or not at all."""

    name = "crab"
    reversible = False
    default_for = (MotionModel.CONTROL,)

    def __init__(self, scene, seed):
        self.scene = scene

    def leg(self, query, deadline):
        start, goal = np.array(query.start), np.array(query.goal)
        seconds = float(np.abs(goal - start)[:2].max()) / 0.5
        count = math.ceil(seconds / Trajectory.MAX_STEP) + 1
        share = np.linspace(0.0, 1.0, count)[:, None]
        poses = start + share * (goal - start)
        return Leg(Trajectory(np.linspace(0.0, seconds, count), poses), complete=True)


def test_a_motion_model(tmp_path):
    hall = Hall(tmp_path, robots=0)
    body = MovableObject(
        "crab",
        hall.robot,
        footprint=ROBOT,
        motion_model=MotionModels.SE2,
        control_model=crab,
        control_parameters={"east_max": 1.0, "north_max": 1.0},
    )
    hall.problem.add_object(body)
    hall.robots.append(body)
    hall.problem.set_initial_configuration(body, hall.pose("here", 3.0, 3.0, 0.0))
    hall.pose("there", 7.0, 6.0, 0.0)
    hall.move("go", 0, "here", "there")
    with extended("planners", "crab", Crab):
        result = solve(hall.problem)
    assert validate_plan(hall.problem, result.plan).valid
    assert result.plan.trajectories["go"].duration == pytest.approx(8.0)


# ------------------------------------------------------------------------- how parts are found
def test_installed_packages_name_their_parts(monkeypatch):
    made = importlib.metadata.EntryPoint(
        "shorter", f"{__name__}:as_short_as_can_be", "up_samp.improvers"
    )
    broken = importlib.metadata.EntryPoint("gone", f"{__name__}:nobody", "up_samp.cuts")
    found = {entry.group: [entry] for entry in (made, broken)}
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: found.get(group, []))
    extensions._installed.cache_clear()
    try:
        assert parts("improvers") == {"shorter": as_short_as_can_be}
        with pytest.raises(ProblemError, match=r"'gone' of up_samp\.cuts"):
            parts("cuts")
    finally:
        monkeypatch.undo()
        extensions._installed.cache_clear()


def test_what_is_no_part_is_refused():
    with pytest.raises(ProblemError, match="known are constraints"):
        extend("wheels", "round", None)
    with extended("rules", "noon", not_before_noon), pytest.raises(ProblemError, match="already"):
        extend("rules", "noon", not_before_noon)
    with pytest.raises(KeyError):
        withdraw("rules", "noon")
