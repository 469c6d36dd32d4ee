"""What is stated of motions before the first schedule where there are very many of them."""

import pytest

from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.geometry.atlas import lay_out
from up_samp.model import Deadline
from up_samp.motion.service import MotionService
from up_samp.search import statements
from up_samp.search.budget import Budget
from up_samp.search.facts import Facts
from up_samp.search.knowledge import History, Knowledge
from up_samp.search.world import Motions
from up_samp.upio import read_problem, relax


@pytest.fixture
def parts():
    problem = warehouse(2, 3, encoding="compact")
    snapshot, grid = lay_out(read_problem(problem))
    relaxation = relax(problem, snapshot)

    def fresh():
        service = MotionService(grid)
        facts = Facts(snapshot, relaxation.choices)
        motions = Motions(facts, service, Budget(Deadline.never(), 10.0))
        return motions, Knowledge(relaxation, History())

    return fresh


def test_far_too_many_motions_are_left_for_later(parts, monkeypatch):
    monkeypatch.setattr(statements, "PROBE", 2)
    monkeypatch.setattr(statements, "HOPELESS", 1e-9)
    motions, knowledge = parts()
    assert len(motions.facts.by_signature) > 10
    statements.fastest_durations(motions, knowledge, lambda *_: None)
    assert len(knowledge.durations) == 2
