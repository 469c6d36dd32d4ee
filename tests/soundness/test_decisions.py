"""Proofs about worlds whose waypoints hang on decisions are attacked with the decisions made."""

from dataclasses import dataclass, field

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins.oneshot_planner import OptimalityGuarantee
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.soundness.decisions import build, random_world
from tests.soundness.worlds import SECONDS, write_rooms
from tests.usual import usually
from up_samp.model import CandidateSchedule
from up_samp.model.refinement import Strength
from up_samp.model.snapshot import TermKind
from up_samp.scheduling.quirks import known_engines
from up_samp.search.world import places_between
from up_samp.upio import read_itinerary, read_problem, relax
from up_samp.validation import validate_plan

SEEDS = (1, 2, 6, 7, 8, 9, 11, 12, 13, 16, 17, 19, 24, 25, 28, 38, 43, 53, 67)
"""Quick ones of all sorts: each with a few dozen attacks at most. Every second one waits for the
slow tests.
"""
get_environment().credits_stream = None
PROVING = ["cpsat", *(name for name, _, _ in known_engines() if name != "aries")]
MOST_ATTACKS = 40


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    return write_rooms(tmp_path_factory.mktemp("rooms"))


@dataclass
class Verdict:
    """What came of one world; ``wrong`` has a line for each discrepancy."""

    status: str
    makespan: int | None
    best: int | None = None
    attacks: int = 0
    wrong: list[str] = field(default_factory=list)
    refused: str = ""


def solve(problem, engine="cpsat", **params):
    with OneshotPlanner(
        name=f"samp-refine[{engine}]",
        params={"seconds_per_unit": SECONDS, "query_seconds": 1.0} | params,
        optimality_guarantee=OptimalityGuarantee.SOLVED_OPTIMALLY,
    ) as planner:
        return planner.solve(problem, timeout=20.0)


def judge(world, rooms, engine="cpsat", *, named=False, **params) -> Verdict:
    """Solve a world, then try to beat what was proven by making each choice of decisions."""
    problem = build(world, rooms, named=named)
    result = solve(problem, engine, **params)
    found = Verdict(result.status.name, None)
    if result.status is Status.INTERNAL_ERROR:
        found.wrong.append(f"internal error: {[m.message for m in result.log_messages]}")
    if result.plan is not None:
        found.makespan = int(result.metrics["makespan"])
        verdict = validate_plan(problem, result.plan, seconds_per_unit=SECONDS)
        if not verdict.valid:
            found.wrong.append(f"invalid plan: {verdict.violations[0]}")
    for decided in list(world.all_decisions())[:MOST_ATTACKS]:
        found.attacks += 1
        attack = solve(build(world, rooms, decided))
        if attack.plan is None:
            continue
        makespan = int(attack.metrics["makespan"])
        found.best = makespan if found.best is None else min(found.best, makespan)
        if result.status is Status.UNSOLVABLE_PROVEN:
            found.wrong.append(f"called unsolvable, but {decided} ends at {makespan}")
        beaten = found.makespan is not None and makespan < found.makespan
        if result.status is Status.SOLVED_OPTIMALLY and beaten:
            kind = result.metrics["bound_kind"]
            found.wrong.append(
                f"{found.makespan} called optimal ({kind}), but {decided} ends at {makespan}"
            )
        found.wrong += broken(world, rooms, decided, attack, result.history.refinements, named)
    return found


def broken(world, rooms, decided, attack, refinements, named=False):
    """Return the proven statements that the plan of a decided world breaks."""
    problem = build(world, rooms, named=named)
    snapshot = read_problem(problem, SECONDS)
    relaxation = relax(problem, snapshot)
    values = {k: v for k, v in decided.items() if ":" not in k}
    told = {f"told({k})": v for k, v in values.items()} if named else {}
    for (activity, term, _), choice in relaxation.choices.items():
        if choice.variable is not None:
            key = term.name if term.kind is TermKind.PARAMETER else f"{activity}:{term.name}"
            values[choice.variable] = told[term.name] if term.name in told else decided[key]
    plan = attack.plan
    times = {
        a.name: tuple(int(plan.get(t).constant_value()) for t in (a.start, a.end))
        for a in plan.activities
    }
    schedule = CandidateSchedule(times, values)
    itinerary = read_itinerary(relaxation, schedule)

    def places(name, first, last):
        return places_between(itinerary, snapshot, name, first, last)

    for refinement in refinements:
        if refinement.strength is not Strength.PROVEN:
            continue
        if not refinement.statement.holds(schedule, places):
            yield f"{decided} with {times} breaks {refinement}"


@pytest.mark.parametrize("seed", usually(11, 67, of=[*SEEDS, 14, 44]))
def test_decided_worlds_beat_no_proof(rooms, seed):
    assert judge(random_world(seed), rooms).wrong == []


def owned(world):
    """Return whether each drive looks at its own decisions only."""
    return all(
        world.owner(where.name) in (None, step.name)
        for step in world.steps
        for where in (step.start, step.goal)
        if where.kind == "decision"
    ) and any(world.decisions)


@pytest.mark.parametrize("seed", usually(6, of=[s for s in SEEDS[:5] if owned(random_world(s))]))
def test_places_may_be_named(rooms, seed):
    assert judge(random_world(seed), rooms, named=True).wrong == []


@pytest.mark.long
@pytest.mark.parametrize("engine", PROVING)
@pytest.mark.parametrize("first", range(0, 200, 20))
def test_many_worlds_of_named_places(rooms, first, engine):
    wrong = {}
    for seed in range(first, first + 20):
        if owned(random_world(seed)):
            found = judge(random_world(seed), rooms, engine, named=True)
            if found.wrong:
                wrong[seed] = found.wrong
    assert wrong == {}


@pytest.mark.long
@pytest.mark.parametrize("engine", PROVING)
@pytest.mark.parametrize("first", range(0, 200, 20))
def test_many_decided_worlds_beat_no_proof(rooms, first, engine):
    wrong = {}
    for seed in range(first, first + 20):
        found = judge(random_world(seed), rooms, engine)
        if found.wrong:
            wrong[seed] = found.wrong
    assert wrong == {}


@pytest.mark.parametrize("seed", usually(18, of=(2, 18)))
def test_the_papers_cuts_hold_for_their_decisions_only(rooms, seed):
    """Seed 1 has a drive that leads nowhere."""
    assert judge(random_world(seed), rooms, preset="paper").wrong == []
