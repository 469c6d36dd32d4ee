"""Metrics other than the makespan with motions: proven values are those of all walks.

A robot in a hall may drive between three places, each way once, until a deadline. What drives take
is asked once, each drive alone; then every walk is looked at.
"""

import itertools
import random
from fractions import Fraction

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.metrics import (
    MaximizeExpressionOnFinalState,
    MinimizeActionCosts,
    MinimizeExpressionOnFinalState,
    MinimizeMakespan,
    Oversubscription,
    TemporalOversubscription,
)
from unified_planning.model.motion import MotionModels
from unified_planning.shortcuts import (
    AnytimePlanner,
    ClosedTimeInterval,
    GlobalEndTiming,
    GlobalStartTiming,
    OneshotPlanner,
    Replanner,
    TimePointInterval,
    get_environment,
)

from tests.shuffled import shuffled
from tests.upio.hall import Hall
from tests.usual import usually
from up_samp.model import UnsupportedError
from up_samp.validation import validate_plan, value_of

PLACES = {"left0": (3.0, 3.0, 0.0), "mid": (8.0, 5.0, 0.0), "right0": (17.0, 3.0, 0.0)}
PAIRS = list(itertools.permutations(PLACES, 2))
SORTS = ("least", "most", "goals", "timed", "costs", "weighted", "fractions")
LATEST = 45


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


def hall(folder):
    made = Hall(folder, motion_model=MotionModels.SE2, motion_parameters={"v_max": 1.0})
    made.pose("mid", *PLACES["mid"])
    return made


@pytest.fixture(scope="module")
def lengths(tmp_path_factory):
    """What each drive takes, alone (units)."""
    get_environment().credits_stream = None
    found = {}
    for origin, goal in PAIRS:
        made = hall(tmp_path_factory.mktemp("hall"))
        made.problem.set_initial_configuration(made.robots[0], made.poses[origin])
        pairs = made.problem._initial_configuration
        made.problem._initial_configuration[:] = pairs[-1:]
        made.move("go", 0, origin, goal)
        with OneshotPlanner(name="samp-refine[cpsat]", params={"optimal": True}) as planner:
            result = planner.solve(made.problem, timeout=60)
        found[origin, goal] = int(result.metrics["makespan"])
    return found


class Walks:
    """One problem of a sort of metric, and the best value of all walks."""

    def __init__(self, folder, sort, seed, lengths):
        self.rng = rng = random.Random(f"{sort} {seed}")
        self.sort, self.lengths = sort, lengths
        made = hall(folder)
        self.problem = p = made.problem
        self.em = p.environment.expression_manager
        types = p.environment.type_manager
        self.deadline = rng.randint(18, LATEST)
        self.drives = rng.sample(PAIRS, rng.randint(4, 6))
        self.worth = {pair: rng.randint(-3, 5) for pair in self.drives}
        fine = sort == "fractions"
        share = Fraction(1, rng.choice([2, 3])) if fine else 1
        self.worth = {pair: share * w for pair, w in self.worth.items()}
        number = types.RealType(-50, 50) if fine else types.IntType(-50, 50)
        self.count = p.add_fluent("count", number, default_initial_value=0)
        self.seen = {
            name: p.add_fluent(f"seen_{name}", default_initial_value=False) for name in PLACES
        }
        for origin, goal in self.drives:
            drive = made.move(f"go_{origin}_{goal}", 0, origin, goal, optional=True)
            drive.add_deadline(self.deadline)
            drive.add_increase_effect(drive.end, self.count(), self.worth[origin, goal])
            drive.add_effect(drive.end, self.seen[goal](), True)
        p.clear_quality_metrics()
        p.add_quality_metric(self.metric())

    def metric(self):
        rng, em, p = self.rng, self.em, self.problem
        if self.sort == "goals":
            self.gains = {name: rng.randint(-2, 5) for name in PLACES}
            return Oversubscription({self.seen[n](): g for n, g in self.gains.items()})
        if self.sort == "timed":
            self.gains = {(n, rng.randint(5, LATEST)): rng.randint(-1, 4) for n in PLACES}
            spans = {}
            for (name, time), gain in self.gains.items():
                at = TimePointInterval(GlobalStartTiming(time))
                late = ClosedTimeInterval(GlobalStartTiming(time), GlobalEndTiming() + LATEST)
                spans[rng.choice([at, late]), self.seen[name]()] = gain
            return TemporalOversubscription(spans)
        if self.sort == "costs":
            self.wanted = rng.choice([name for name in PLACES if name != "left0"])
            p.add_condition(TimePointInterval(GlobalEndTiming()), self.seen[self.wanted]())
            return MinimizeActionCosts({}, default=3)
        if self.sort == "weighted":
            self.weight = rng.choice([3, 6])
            latest = p.add_variable("latest", p.environment.type_manager.IntType(0, LATEST))
            p.add_constraint(em.LE(em.TimingExp(GlobalEndTiming()), latest))
            gain = em.Times(self.weight, self.count())
            return MinimizeExpressionOnFinalState(em.Minus(em.ParameterExp(latest), gain))
        least = self.sort == "least" or (self.sort == "fractions" and rng.random() < 0.5)
        kind = MinimizeExpressionOnFinalState if least else MaximizeExpressionOnFinalState
        return kind(self.count())

    def walks(self, at="left0", done=(), time=0):
        yield done, time
        for pair in self.drives:
            later = time + self.lengths[pair]
            if pair[0] == at and pair not in dict(done) and later <= self.deadline:
                yield from self.walks(pair[1], (*done, (pair, later)), later)

    def cost(self, done, time):
        """Return what a walk costs, the less the better (None: it is none)."""
        count = sum(self.worth[pair] for pair, _ in done)
        if self.sort == "goals":
            return -sum(self.gains[n] for n in {pair[1] for pair, _ in done})
        if self.sort == "timed":
            first = {}
            for (_, goal), end in done:
                first.setdefault(goal, end)
            return -sum(gain for (n, t), gain in self.gains.items() if n in first and first[n] < t)
        if self.sort == "costs":
            reached = any(pair[1] == self.wanted for pair, _ in done)
            return 3 * len(done) if reached else None
        if self.sort == "weighted":
            return time - self.weight * count
        maximal = isinstance(self.problem.quality_metrics[0], MaximizeExpressionOnFinalState)
        return -count if maximal else count

    def best(self):
        """Return the least cost of a walk (None: there is no walk)."""
        costs = (self.cost(done, time) for done, time in self.walks())
        return min((c for c in costs if c is not None), default=None)


def disagreement(sort, seed, lengths, folder):
    """Return what differs from the best walk (None: nothing)."""
    walks = Walks(folder, sort, seed, lengths)
    problem = shuffled(walks.problem, seed).problem
    best, metric = walks.best(), problem.quality_metrics[0]
    kind = problem.kind
    with OneshotPlanner(problem_kind=kind, optimality_guarantee="SOLVED_OPTIMALLY") as planner:
        assert planner.name == "samp-refine[cpsat]"
        result = planner.solve(problem, timeout=300)
    if best is None:
        proven = result.status is Status.UNSOLVABLE_PROVEN
        return None if proven else f"{result.status}, but there is no walk"
    told = f"{result.status.name} {result.metrics.get('value')} {walks.deadline} best {best}"
    if result.status is not Status.SOLVED_OPTIMALLY:
        return f"{told} {result.log_messages}"
    if not validate_plan(problem, result.plan).valid:
        return "invalid"
    sign = 1 if "minimize" in str(metric) else -1
    values = value_of(problem, result.plan), Fraction(result.metrics["value"])
    return None if values == (sign * best,) * 2 else told


@pytest.mark.parametrize("sort", usually("most", "goals", "timed", "costs", "fractions", of=SORTS))
def test_proven_values_are_those_of_the_best_walk(sort, lengths, tmp_path):
    assert disagreement(sort, 0, lengths, tmp_path) is None


@pytest.mark.long
@pytest.mark.parametrize("sort", SORTS)
def test_proven_values_are_those_of_the_best_walk_in_many(sort, lengths, tmp_path):
    found = {}
    for seed in range(1, 21):
        folder = tmp_path / str(seed)
        folder.mkdir()
        found[seed] = disagreement(sort, seed, lengths, folder)
    assert not {seed: why for seed, why in found.items() if why is not None}


def test_an_anytime_planner_yields_better_and_better_values(lengths, tmp_path):
    walks = Walks(tmp_path, "most", 3, lengths)
    values = []
    with AnytimePlanner(name="samp-refine[cpsat]") as planner:
        for result in planner.get_solutions(walks.problem, timeout=60):
            values.append(Fraction(result.metrics["value"]))
    assert result.status is Status.SOLVED_OPTIMALLY
    assert values == sorted(values)
    assert values[-1] == -walks.best()


def test_what_up_cannot_copy_is_refused_by_name(lengths, tmp_path):
    walks = Walks(tmp_path, "costs", 0, lengths)
    with pytest.raises(UnsupportedError, match="UP cannot copy"):
        Replanner(walks.problem, name="samp-refine[cpsat]")


def test_metrics_without_a_meaning_and_several_are_refused_by_name(lengths, tmp_path):
    for more, why in ((MinimizeMakespan(), "one quality metric"), (None, "by default")):
        problem = Walks(tmp_path, "least", 0, lengths).problem
        if more is None:
            problem.clear_quality_metrics()
        problem.add_quality_metric(more or MinimizeActionCosts({}))
        with (
            OneshotPlanner(name="samp-refine[cpsat]") as planner,
            pytest.raises(UnsupportedError, match=why),
        ):
            planner.solve(problem, timeout=60)
