"""Random problems in several styles: no invalid plan, no false proof, no exception, nothing left
behind. ``benchmarks/reliability/fuzz.py`` runs thousands of them.
"""

import tempfile
from dataclasses import replace

import pytest

from tests.fuzz.attack import ATTACKERS, attack
from tests.fuzz.problems import BODIES, SECONDS, build, random_case
from tests.fuzz.wide import MESHES, wide_case
from up_samp.upio import read_problem

WIDE = (1, 2, 3)


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """What others leave in the temporary folder is not ours."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))


@pytest.mark.parametrize("seed", range(8))
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
