"""Fleets of all that can be asked of one (``buildings``): their plans before a judge of its own
(``rulebook``), their answers in another listing and when less is asked, their plans on the floor.
"""

import copy

import pytest

from tests.fleet.buildings import Building, built, looser
from tests.fleet.rulebook import Rulebook
from tests.shuffled import shuffled_fleet
from up_samp.execution import (
    Delays,
    Executor,
    Surprise,
    dependencies_of,
    simulate,
    solve_remaining,
)
from up_samp.execution.simulate import Floor
from up_samp.fleet import Fleet, FleetError
from up_samp.fleet.files import write_problem_file
from up_samp.io import plan_from_dict
from up_samp.model import ProblemError
from up_samp.validation import validate_plan

FLOORS = (
    ("reorder", Delays(slow=0.5, late=1.0, stops=4)),
    ("staircase", Delays(slow=0.3, late=0.5, bias=0.05, lag=0.2)),
    ("staircase", Delays(slow=0.2, bias=0.02, noise=0.03)),
)
SEEDS = (6, 111)
GOOD = 7


class Answer:
    """What is said of a fleet: status, value (None: no plan), bounds, and what is wrong in it."""

    def __init__(self, spec, fleet, seed, timeout):
        self.fleet = fleet
        mode = {"optimal": True} if seed % 3 else {"first_plan": seed % 2 == 1}
        self.result = result = fleet.solve(timeout=timeout, **mode)
        self.status = result.status
        plain = spec["objective"] == "makespan"
        told = (result.outcome.metrics or {}).get("lower_bound") if plain else None
        self.bound = float(told or 0) * spec["unit"]
        self.value, self.wrong = None, []
        if self.status == "INTERNAL_ERROR":
            self.wrong.append(result.explain()[:400])
        if result.plan is not None:
            self.value = float(result.makespan if plain else sum(result.costs.values()))
            verdict = validate_plan(result.problem, result.plan, seconds_per_unit=spec["unit"])
            self.wrong += [*map(str, verdict.violations), *Rulebook(spec, result).faults]


def contradictions(one, two):
    """Yield what is wrong with two answers to one question."""
    for here, there in ((one, two), (two, one)):
        if here.status == "UNSOLVABLE_PROVEN" and there.value is not None:
            yield f"unsolvable, and {there.value}"
        optimal = here.value if here.status == "SOLVED_OPTIMALLY" else 0.0
        if there.value is not None and max(here.bound, optimal) > there.value + 1e-6:
            yield f"at least {max(here.bound, optimal)}, and {there.value}"


def eased(answer, less, what):
    """Yield what is wrong with the answer when less is asked."""
    if answer.value is None:
        return
    if less.status == "UNSOLVABLE_PROVEN":
        yield f"unsolvable without '{what}'"
    if less.status == "SOLVED_OPTIMALLY" and less.value > answer.value + 1e-6:
        yield f"dearer without '{what}': {answer.value}, {less.value}"


def driven(answer, seed):
    """Yield what is wrong with executions of the plan."""
    found = dependencies_of(answer.fleet.problem, answer.result.data)
    for k, (policy, delays) in enumerate(FLOORS):
        run = simulate(found, answer.result.data, delays, seed + k, policy=policy)
        # who stops by itself, as these robots do, does so anywhere
        broken = [b for b in run.broken if not (delays.stops and b.startswith("stop: "))]
        if not run.finished or run.contacts or broken:
            yield f"run {k}: {run.finished}, {run.deadlock}, {run.contacts[:2]}, {broken[:2]}"


def told(seed, folder, timeout=10.0, draw=Building, looser=looser):
    """Return what is wrong with the answers to a random fleet (None: no such fleet)."""
    spec = draw(seed, folder).spec
    try:
        fleet = built(spec)
        faults = [str(f) for f in fleet.check() if f.level.value == "error"]
        answer = Answer(spec, fleet, seed, timeout)
    except FleetError:
        return None
    found = list(answer.wrong)
    if faults and answer.value is not None:
        found.append(f"a plan, and errors: {faults}")
    if seed % 2:
        records = shuffled_fleet(fleet.records, seed, rename=False).records
        listed = Fleet.from_file(write_problem_file(folder / f"other{seed}.yaml", records))
        other = Answer(spec, listed, seed, timeout)
        found += [*other.wrong, *contradictions(answer, other)]
    elif answer.value is not None:
        spec, what = looser(spec, seed)
        less = Answer(spec, built(spec), seed, timeout)
        found += [*less.wrong, *eased(answer, less, what)]
    if answer.value is not None and answer.result.data["motions"]:
        found += driven(answer, seed)
    return found


@pytest.mark.parametrize("seed", SEEDS)
def test_plans_keep_what_is_asked_also_on_the_floor(seed, tmp_path):
    assert told(seed, tmp_path) == []


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 400, 25))
def test_many_plans_keep_what_is_asked(first, tmp_path):
    findings = {seed: told(seed, tmp_path) for seed in range(first, first + 25)}
    assert {seed: found for seed, found in findings.items() if found} == {}


def rests(seed, folder):
    """Yield what is wrong with plans of what is left of a late run, at a third and at two."""
    spec = Building(seed, folder).spec
    try:
        answer = Answer(spec, built(spec), 3, 10.0)
    except FleetError:
        return
    if answer.value is None:
        return
    plan, problem = answer.result.data, answer.fleet.problem
    executor = Executor(plan, problem)
    floor = Floor(executor, Delays(slow=0.3, late=0.3), seed)
    for share in (0.3, 0.6):
        until = share * plan["makespan"] * spec["unit"]
        while floor.goes_on and floor.now < until:
            floor.step()
        if not floor.goes_on:
            return
        left = executor.remaining_problem(Surprise(same_choices=share < 0.5))
        try:
            rest = plan_from_dict(left.problem, solve_remaining(left, seconds=20.0))
        except ProblemError as error:
            if not executor.missed():  # what has not begun may have a deadline, too
                yield str(error)
            continue
        verdict = validate_plan(left.problem, rest, seconds_per_unit=spec["unit"])
        yield from map(str, verdict.violations)


@pytest.mark.long
@pytest.mark.parametrize("first", range(300, 400, 25))
def test_the_rest_of_many_plans_is_planned_anew(first, tmp_path):
    findings = {seed: [*rests(seed, tmp_path)] for seed in range(first, first + 25)}
    assert {seed: found for seed, found in findings.items() if found} == {}


def crossed(plan, spec):
    plan["motions"][0]["samples"][0][1] += 3.0


def undone(plan, spec):
    plan["activities"] = [a for a in plan["activities"] if not a["name"].startswith("deliver_")]


def tired(plan, spec):
    for robot in spec["robots"].values():
        robot["breaks"] = [{"duration": 5, "window": [1e5, 2e5]}]


def closed(plan, spec):
    for robot in spec["robots"].values():
        robot["shift"] = [1e5, 2e5]


def full(plan, spec):
    spec["types"]["agv"]["capacity"]["item"] = 0


def slow(plan, spec):
    for lift in spec["lifts"].values():
        lift["seconds"] = 1e3


def late(plan, spec):
    for job in spec["orders"] + spec["tasks"]:
        job["release"] = 1e5


def cheap(plan, spec):
    spec["objective"] = {term: 7.5 * weight for term, weight in spec["objective"].items()}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    spec = Building(GOOD, folder).spec
    return spec, Answer(spec, built(spec), 3, 20.0).result


@pytest.mark.parametrize("harm", [crossed, undone, tired, closed, full, slow, late, cheap])
def test_the_judge_sees_what_is_wrong(harm, good):
    spec, result = copy.deepcopy(good[0]), copy.copy(good[1])
    result.__dict__["data"] = copy.deepcopy(result.data)
    assert Rulebook(spec, result).faults == []
    harm(result.data, spec)
    assert Rulebook(spec, result).faults
