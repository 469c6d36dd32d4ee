"""What a search tells about itself: the trace folder, the history and the metrics."""

import json

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.upio.hall import Hall
from up_samp.search import session
from up_samp.search.loop import InvalidPlanError

get_environment().credits_stream = None


def blocked(tmp_path):
    """A drive through a door that has to be opened first."""
    hall = Hall(tmp_path, door=True)
    hall.move("go", 0, "left0", "right0")
    hall.open_door(optional=True).add_release_date(5)
    return hall.problem


@pytest.mark.parametrize("preset", ["default", pytest.param("paper", marks=pytest.mark.long)])
def test_the_trace_holds_every_candidate_and_every_refinement(tmp_path, preset):
    folder = tmp_path / "trace"
    params = {"preset": preset, "trace": str(folder), "query_seconds": 2.0}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(blocked(tmp_path), timeout=60)
    assert result.plan is not None
    rounds = len(result.history.rounds)
    files = sorted(folder.glob("round-*.txt"))
    assert [f.name for f in files] == [f"round-{i:03d}.txt" for i in range(rounds + 1)]
    text = "\n".join(f.read_text(encoding="utf-8") for f in files)
    for refinement in result.history.refinements:
        assert str(refinement) in text
    assert "before the first schedule" in files[0].read_text(encoding="utf-8")
    assert "go" in files[1].read_text(encoding="utf-8")
    known = json.loads((folder / "history.json").read_text(encoding="utf-8"))
    assert len(known["refinements"]) == len(result.history.refinements)
    assert [r["number"] for r in known["rounds"]] == list(range(1, rounds + 1))
    if preset == "paper":
        assert rounds > 1  # it has to learn that the door is in the way
        assert "that the candidate breaks" in text


def test_the_metrics_tell_the_gap(tmp_path):
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(blocked(tmp_path), timeout=60)
    low, high = int(result.metrics["lower_bound"]), int(result.metrics["makespan"])
    assert float(result.metrics["gap"]) == pytest.approx(1 - low / high, abs=1e-4)


def test_a_failure_does_not_lose_the_plan_found_before_it(tmp_path, monkeypatch):
    problem = blocked(tmp_path)

    def fails_later(context, **goal):
        search = run(context, **goal)
        yield next(search)
        raise InvalidPlanError("made up by the test")

    run = session.run
    monkeypatch.setattr(session, "run", fails_later)
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status is Status.SOLVED_SATISFICING
    assert result.plan is not None
    assert "made up by the test" in result.log_messages[0].message


def test_what_is_ignored_is_said(tmp_path):
    problem = blocked(tmp_path)
    with OneshotPlanner(name="samp-refine[cpsat]") as planner:
        first = planner.solve(problem, timeout=60)
        with pytest.warns(UserWarning, match="ignores the heuristic"):
            again = planner.solve(problem, heuristic=lambda state: 0.0, timeout=60)
    assert again.metrics["makespan"] == first.metrics["makespan"]
