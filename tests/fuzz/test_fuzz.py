"""Random problems in several styles: no invalid plan, no false proof, no exception, nothing left
behind. ``benchmarks/reliability/fuzz.py`` runs thousands of them.
"""

import random
import sys
import tempfile
import time
from dataclasses import replace

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status

from tests.fuzz import attack as attacks
from tests.fuzz import herd
from tests.fuzz.attack import ATTACKERS, attack
from tests.fuzz.bodies import BODIES
from tests.fuzz.problems import SECONDS, build, random_case
from tests.fuzz.rows import related
from tests.fuzz.small import small_case
from tests.fuzz.wide import MESHES, wide_case
from up_samp.model.snapshot import MotionTask
from up_samp.upio import read_problem

# another engine computes in a process of its own, and who is late is judged by the clock
pytestmark = pytest.mark.usefixtures("on_the_clock")

WIDE = (1, *(pytest.param(k, marks=pytest.mark.long) for k in (2, 3)))


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """What others leave in the temporary folder is not ours."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.long) for s in (1, 2, 3))])
def test_a_few_problems(tmp_path, seed):
    found = attack(random_case(seed), tmp_path, timeout=6.0, attackers=ATTACKERS[1:3])
    assert found.wrong == []


@pytest.mark.long
@pytest.mark.parametrize("engine", ["cpsat", "aries", "aries-opt"])
@pytest.mark.parametrize("first", range(1000, 1100, 20))
def test_many_problems(tmp_path, engine, first):
    wrong = {}
    for seed in range(first, first + 20):
        found = attack(random_case(seed), tmp_path, engine=engine)
        if found.wrong:
            wrong[seed] = found.wrong
    assert wrong == {}


def test_the_generator_uses_every_style(tmp_path):
    cases = [random_case(seed) for seed in range(60)]
    for field, count in (("obstacles", 3), ("state", 2), ("offset", 2), ("choice", 2)):
        assert len({getattr(c.style, field) for c in cases}) == count
    assert {len(c.robots) for c in cases} == {1, 2, 3, 4}
    assert any(build(c, tmp_path).activities[0].parameters for c in cases[:20])


def test_the_wide_generator_uses_all_that_there_is(tmp_path):
    cases = [wide_case(seed) for seed in range(300)]
    assert {r.moves for c in cases for r in c.robots} == {*BODIES, *(("flyer",) if MESHES else ())}
    assert {len(c.robots) for c in cases} == {1, 2, 3, 4, 5, 6}
    assert {c.style.choice for c in cases} == {"optional", "parameter", "variable"}
    assert {c.style.one_at_a_time for c in cases} == {"pairs", "uses", "all"}
    assert {c.door for c in cases} == {None, "open", "once", "shut", "twice", "closing"}
    assert len({c.floor.kind for c in cases}) == 7
    assert any(c.loads for c in cases)
    assert any(c.idle for c in cases)
    for case in cases[:25]:
        snapshot = read_problem(build(case, tmp_path), SECONDS)
        assert len(snapshot.tasks) > 0


@pytest.mark.parametrize("seed", WIDE)
def test_a_few_wide_problems(tmp_path, seed):
    found = attack(wide_case(seed), tmp_path, timeout=6.0, attackers=ATTACKERS[1:2])
    assert found.wrong == []
    assert found.refused == ""


@pytest.mark.long
@pytest.mark.parametrize("first", range(0, 200, 20))
def test_many_wide_problems(tmp_path, first):
    wrong = {}
    for seed in range(first, first + 20):
        found = attack(wide_case(seed), tmp_path)
        if found.wrong or found.refused:
            wrong[seed] = [*found.wrong, found.refused]
    assert wrong == {}


def test_ompl_refuses_bodies_that_turn_on_the_spot_by_name(tmp_path):
    """The paper's preset asks OMPL for all paths."""
    case = wide_case(0)
    robots = (replace(case.robots[0], body="pivot"),)
    case = replace(case, robots=robots, loads=(), idle=(), door=None, limit=None)
    found = attack(case, tmp_path, attackers=(), preset="paper")
    assert "'RRT' is OMPL's" in found.refused
    assert "turn on the spot" in found.refused


@pytest.mark.parametrize(("status", "raised"), [("SOLVED_OPTIMALLY", 2), ("TIMEOUT", 9)])
def test_false_claims_are_found(tmp_path, monkeypatch, status, raised):
    """Makespan and bound are told as higher than they are."""
    honest = attacks._solve

    def lying(*args, optimal, **params):
        result = honest(*args, optimal=optimal, **params)
        if not optimal:
            return result
        told = {k: str(int(result.metrics[k]) + raised) for k in ("makespan", "lower_bound")}
        metrics = {**result.metrics, **told}
        return replace(result, status=Status[status], metrics=metrics)

    monkeypatch.setattr(attacks, "_solve", lying)
    found = attack(small_case(33), tmp_path, attackers=ATTACKERS[:1])
    assert found.attacks == 1
    assert any("Attacker" in line for line in found.wrong)


def test_small_problems_have_loads_of_all_sorts(tmp_path):
    cases = [small_case(seed) for seed in range(400)]
    assert {len(c.robots) for c in cases} == {1, 2, 3}
    loads = [(c, load) for c in cases for load in c.loads]
    assert {load.side for _, load in loads} == {"ahead", "left", "on"}
    assert any(len({name for name, _ in load.carried}) > 1 for _, load in loads)
    assert any(load.turned for _, load in loads)
    rides = set()
    for case, load in loads[:40]:
        tasks = read_problem(build(case, tmp_path), SECONDS).tasks
        found = [t for t in tasks if isinstance(t, MotionTask) and t.rides]
        assert bool(found) or load.turned, case.seed
        rides.add(len(found))
    assert max(rides) > 1


def test_proofs_are_attacked_in_other_styles():
    case = small_case(0)
    styles = {related(random.Random(k), case) for k in range(40)}
    assert len(styles) > 5
    assert all(s.choice == case.style.choice for s in styles)


CRASHES = """
import json, os, sys, time
for seed in map(int, sys.stdin.read().split()):
    print(seed, flush=True)
    if seed == 3:
        os.abort()
    if seed == 5:
        time.sleep(60.0)
    with open(sys.argv[1], "a") as stream:
        stream.write(json.dumps({"seed": seed, "wrong": []}) + "\\n")
"""


def test_a_problem_that_kills_or_hangs_its_process_costs_itself_only(tmp_path, monkeypatch):
    monkeypatch.setattr(herd, "PATIENCE", 4.0)
    out = tmp_path / "rows.jsonl"
    herd.watch([sys.executable, "-c", CRASHES, str(out)], range(8), out, time.monotonic() + 60)
    rows = {r["seed"]: r["wrong"] for r in herd.read_rows(out)}
    assert sorted(rows) == list(range(8))
    assert "exit code -6" in rows[3][0]
    assert "hung" in rows[5][0]
    assert not any(rows[k] for k in (0, 1, 2, 4, 6, 7))
