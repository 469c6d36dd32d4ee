"""Searches put together from parts: observers, stopping criteria, components of one's own."""

import math
from dataclasses import replace

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import AnytimePlanner, OneshotPlanner

import up_samp.search.search as parts
from tests.upio.hall import Hall
from up_samp.model import ProblemError
from up_samp.model.refinement import Strength
from up_samp.search import (
    Observer,
    Parameters,
    State,
    split_parameters,
)
from up_samp.search.cuts import PaperCuts, SmallCuts
from up_samp.search.params import ABLATIONS, PRESETS
from up_samp.search.presets import components_of
from up_samp.search.search import Components, Statement


def crossing(folder):
    """Two robots that change places, and an optional door that has to be opened for both."""
    hall = Hall(folder, robots=2, door=True)
    for robot in (0, 1):
        hall.move(f"go{robot}", robot, f"left{robot}", f"right{robot}")
        hall.move(f"back{robot}", robot, f"right{robot}", f"left{robot}", optional=True)
    hall.open_door(optional=True).add_release_date(5)
    return hall.problem


def solve(problem, **params):
    if params.get("preset") == "paper":
        params["query_seconds"] = 0.5  # it waits that long for a way through a closed door
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        return planner.solve(problem, timeout=120)


class Recorder(Observer):
    def __init__(self):
        self.events = []

    def __getattribute__(self, name):
        if not name.startswith("on_"):
            return super().__getattribute__(name)
        return lambda state, *told: self.events.append((name, state, *told))

    def named(self, name):
        """Return what was told of one kind: where the search was, and what happened."""
        return [told for kind, *told in self.events if kind == name]


def door_in_the_way(folder):
    hall = Hall(folder, door=True)
    hall.move("go", 0, "left0", "right0")
    hall.open_door(optional=True).add_release_date(5)
    return hall.problem


@pytest.mark.parametrize(("preset", "make"), [("default", crossing), ("paper", door_in_the_way)])
def test_observers_are_told_each_event_by_name(tmp_path, preset, make):
    recorder = Recorder()
    params = {"first_plan": True, "query_seconds": 1.0}
    result = solve(make(tmp_path), preset=preset, observers=[recorder], **params)
    history = result.history
    rounds = [report for _, report, *_ in recorder.named("on_round") if report is not None]
    assert len(rounds) == len(history.rounds)
    learned = [r for _, some in recorder.named("on_refinement") for r in some]
    assert learned == history.refinements
    plans = recorder.named("on_plan")
    makespans = [incumbent.schedule.makespan for _, incumbent in plans]
    assert makespans == sorted(makespans, reverse=True)
    assert makespans[-1] == int(result.metrics["makespan"])
    assert len(recorder.named("on_schedule")) >= len(rounds)
    assert len(recorder.named("on_restart")) == history.restarts
    elapsed = [state.elapsed for _, state, *_ in recorder.events]
    assert elapsed == sorted(elapsed)
    assert {phase.value for _, phase, *_ in recorder.named("on_stage")} >= {"schedule", "motions"}


def test_what_an_observer_raises_ends_the_search(tmp_path):
    class Bored(Observer):
        def on_schedule(self, state, report):
            raise RuntimeError("enough of this")

    with pytest.raises(RuntimeError, match="enough of this"):
        solve(crossing(tmp_path), observers=[Bored()])


def test_a_plan_is_built_once_for_each_incumbent(tmp_path, monkeypatch):
    built = []

    def build(problem, snapshot, schedule, *rest):
        built.append(schedule)
        return original(problem, snapshot, schedule, *rest)

    original = parts.build_plan
    monkeypatch.setattr(parts, "build_plan", build)
    recorder = Recorder()
    params = {"observers": [recorder], "without": ("tidy",)}
    with AnytimePlanner(name="samp-refine[cpsat]", params=params) as planner:
        results = list(planner.get_solutions(crossing(tmp_path), timeout=60))
    plans = recorder.named("on_plan")
    assert results[-1].plan is plans[-1][1].plan
    assert [r.plan for r in results[:-1]] == [incumbent.plan for _, incumbent in plans]
    assert len(built) == len({id(s) for s in built})
    checked = [report for _, report, *_ in recorder.named("on_round") if report is not None]
    assert len(plans) <= len(built) <= len(checked)


def state(**changes):
    return replace(State(3, 0, 80, 100, 12.0, 2.0, 1), **changes)


def test_the_gap_is_a_share_of_the_plans_cost():
    assert state(lower_bound=80, upper_bound=100).gap == pytest.approx(0.2)
    assert state(lower_bound=-60, upper_bound=-50).gap == pytest.approx(0.2)
    assert state(lower_bound=0, upper_bound=0).gap == 0.0
    assert state(upper_bound=None).gap == state(lower_bound=None).gap == math.inf


@pytest.mark.parametrize("wrong", [{"runtime": -1}, {"runtime": math.nan}, {"stop": 3}])
def test_ends_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ProblemError):
        split_parameters(wrong)


def test_a_search_stops_as_it_was_told(tmp_path):
    problem = crossing(tmp_path)
    best = solve(problem, optimal=True)
    assert best.status is Status.SOLVED_SATISFICING
    assert "nothing was left to try" in best.log_messages[0].message
    result = solve(door_in_the_way(tmp_path), preset="paper", stop=lambda state: state.rounds >= 1)
    assert result.status is Status.TIMEOUT
    assert result.plan is None
    assert "before there was a plan" in result.log_messages[0].message
    assert len(result.history.rounds) == 1
    result = solve(problem, optimal=True, stop=lambda state: state.gap < math.inf)
    assert result.plan is not None
    assert int(result.metrics["makespan"]) >= int(best.metrics["makespan"])
    assert solve(problem, runtime=0).status is Status.TIMEOUT


def test_a_preset_is_a_list_of_components():
    def parts(preset, native=True):
        params, _ = split_parameters({"preset": preset})
        return components_of(params, native=native)

    full = parts("default")
    assert [s.name for s in full.statements] == [
        "lower bounds on motions",
        "what is due too soon",
        "proofs of unreachability",
        "unary places",
        "orders on rings",
        "unobstructed motions",
        "handing over places",
    ]
    assert isinstance(full.cuts, SmallCuts)
    assert full.pace.staged
    other = parts("without-incumbents", native=False)
    assert not other.pace.staged
    assert "unary places" not in [s.name for s in other.statements]
    paper = parts("paper")
    assert isinstance(paper.cuts, PaperCuts)
    assert paper.learns
    assert (paper.statements, paper.repairs, paper.shapers, paper.finishers) == ((), (), (), ())
    assert not parts("sequential").learns
    for name in ABLATIONS:
        assert parts(name) != full
    assert set(PRESETS) == {"default", "paper", "sequential"}


def test_ideas_are_left_out_beside_those_of_the_preset():
    params, rest = split_parameters({"preset": "paper", "without": ["equivalents"], "workers": 1})
    assert set(params.without) == {*PRESETS["paper"]["without"], "equivalents"}
    assert rest == {"workers": 1}
    assert split_parameters({"without": ("tidy",)})[0].without == ("tidy",)


def test_components_of_ones_own(tmp_path):
    """A search told by a statement of one's own that a drive lasts longer."""
    from up_samp.refinement import rules

    params, _ = split_parameters({})
    plain = components_of(params, native=True)
    slow = Statement(
        "a speed limit",
        lambda search: [rules.lasts("go0", 40, "made up", strength=Strength.HEURISTIC)],
    )
    mine = replace(plain, statements=(*plain.statements, slow))
    assert isinstance(mine, Components)
    result = solve(crossing(tmp_path), components=mine, max_restarts=0)
    assert int(result.metrics["makespan"]) >= 40


@pytest.mark.parametrize(
    "given", [{"observers": 3}, {"observers": [print]}, {"stop": 3}, {"components": "paper"}]
)
def test_parts_that_are_none_are_refused(given):
    with pytest.raises(ProblemError, match=next(iter(given))):
        Parameters(**given)
