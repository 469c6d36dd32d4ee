"""Objectives in an order, rank by rank: what is kept, and what is called optimal."""

import itertools
from dataclasses import replace

import pytest
from unified_planning.engines import LogLevel, LogMessage, PlanGenerationResult
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model import GlobalEndTiming
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.shortcuts import Minus, get_environment

from tests.fleet.test_rules import one_room
from up_samp.engines.faces import Call
from up_samp.engines.indirect import InOrder, costs_in_order
from up_samp.fleet import Fleet, FleetError
from up_samp.model.errors import InterruptedSearch
from up_samp.model.objective import Cost, MinimizeCosts
from up_samp.search import session
from up_samp.validation import ranked, validate_plan

OPTIMAL, FOUND = Status.SOLVED_OPTIMALLY, Status.SOLVED_SATISFICING


@pytest.fixture(autouse=True)
def _silent(monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)


def problem(objective):
    """Three tasks for one robot; what is due first is furthest."""
    fleet = one_room(objective=objective)
    fleet.add_task("near", "a", duration=3, due=500)
    fleet.add_task("far", "c", duration=3, due=9, weight=2)
    fleet.add_task("side", "b", duration=3)
    return fleet


def solved(objective, **params):
    fleet = problem(objective)
    result = fleet.solve(optimal=True, timeout=120, **params)
    assert result.status == "SOLVED_OPTIMALLY", result.explain()
    assert validate_plan(fleet.problem, result.plan).valid
    return result


def test_the_first_objective_goes_before_all_others():
    """The same as a weight that nothing can outweigh; and each alone is never better."""
    alone = {term: solved({term: 1}).costs[term] for term in ("tardiness", "driving")}
    for first, then in itertools.permutations(alone):
        result = solved([first, then])
        heavy = solved({first: 1000, then: 1}).costs
        assert result.costs == {first: heavy[first] / 1000, then: heavy[then]}
        assert result.costs[first] == alone[first]
        assert result.costs[then] >= alone[then]
        lines = result.explain().splitlines()
        assert f"{first} {result.costs[first]:g} (proven)" in lines
        assert f"{then} {result.costs[then]:g} (proven)" in lines


def test_the_makespan_first_is_the_makespan_alone():
    result = solved(["makespan", {"tardiness": 1, "driving": 0.5}])
    alone = problem("makespan").solve(optimal=True, timeout=120)
    assert result.makespan == alone.makespan
    assert list(result.costs) == ["makespan", "tardiness", "driving"]


def test_a_file_lists_terms_in_their_order(tmp_path):
    fleet = problem(["tardiness", {"makespan": 0.1, "driving": 2}])
    again = Fleet.from_file(fleet.save(tmp_path / "problem.yaml"))
    assert again.records == fleet.records
    for objective, said in (
        (["tardiness", "speed"], r"objective\[1\]"),
        (["tardiness", "tardiness"], r"objective\[1\]: is there before"),
        (["tardiness", {}], r"objective\[1\]: give a weight above 0"),
        ([], "or a list of such, the most important first"),
    ):
        with pytest.raises(FleetError, match=said):
            problem(objective).solve(timeout=60)


# -- rank by rank, with results of our own -------------------------------------------------------


class Ranks:
    """Answers as an engine would: a list of (status, which plan), one for each rank."""

    def __init__(self, answers):
        fleet = problem("none")
        self.problem = fleet.problem
        env, em = self.problem.environment, self.problem.environment.expression_manager
        by_name = {a.name: a for a in self.problem.activities}
        ends = {name: by_name[f"{name}_r0"].end for name in ("far", "near")}
        self.plans = [fleet.solve(first_plan=True, seed=1).plan]
        self.costs = [
            Cost("far", 1, Minus(ends["far"], 0), "far_r0", rank=0),
            Cost("near", 1, Minus(ends["near"], 0), "near_r0", rank=2),
            Cost("all", 1, em.TimingExp(GlobalEndTiming()), rank=5),
        ]
        self.problem.clear_quality_metrics()
        self.problem.add_quality_metric(MinimizeCosts(self.costs, env))
        self.answers, self.asked = list(answers), []

    def results(self, call):
        status, planned, *told = self.answers[len(self.asked)]
        self.asked.append(call)
        plan = self.plans[0] if planned else None
        if status == "stop":
            raise InterruptedSearch(self.result(Status.TIMEOUT, plan))
        yield self.result(status, plan, *told)

    def result(self, status, plan, *told):
        levels = {True: LogLevel.INFO, False: LogLevel.ERROR}
        messages = [LogMessage(levels[text.startswith("why")], text) for text in told]
        return PlanGenerationResult(status, plan, "fake", {"value_bound": "3"}, messages)

    def solve(self, first=False, **call):
        metric = costs_in_order(self.problem)
        steps = InOrder(metric, Call(self.problem, **call), self.results, counted=True)
        *_, last = steps.solve(first=first)
        return last


def test_it_is_optimal_only_if_every_rank_was_proven():
    for statuses in (
        (OPTIMAL, OPTIMAL, OPTIMAL),
        (FOUND, OPTIMAL, OPTIMAL),
        (OPTIMAL, FOUND, OPTIMAL),
    ):
        last = Ranks((status, True) for status in statuses).solve()
        assert (last.status is OPTIMAL) == (set(statuses) == {OPTIMAL})
        for status, message in zip(statuses, last.log_messages, strict=True):
            assert ("(proven)" in message.message) == (status is OPTIMAL)


def test_each_rank_limits_those_after_it_and_begins_from_the_best_plan():
    ranks = Ranks([(OPTIMAL, True)] * 3)
    last = ranks.solve(timeout=90.0)
    worth = ranked(ranks.problem, last.plan)
    metrics = [call.problem.quality_metrics[0] for call in ranks.asked]
    assert [m.limits for m in metrics] == [(), tuple(worth[:1]), tuple(worth[:2])]
    assert not any(m.in_order for m in metrics)
    assert ranks.problem.quality_metrics == [MinimizeCosts(ranks.costs)]
    assert [call.warm_start_plan for call in ranks.asked] == [None, last.plan, last.plan]
    assert [call.timeout for call in ranks.asked] == [30.0] * 3


def test_a_rank_that_fails_leaves_the_plan_before_it_and_its_errors():
    last = Ranks(
        [(OPTIMAL, True), (Status.INTERNAL_ERROR, False, "broke"), (OPTIMAL, True)]
    ).solve()
    assert (last.status, last.plan is not None) == (FOUND, True)
    assert "broke" in [m.message for m in last.log_messages]


def test_why_each_rank_ended_is_told_by_its_name_and_once():
    answers = [(FOUND, True, "why: slow"), (OPTIMAL, True, "why: slow", "why: late", "broke")]
    last = Ranks([*answers, (Status.TIMEOUT, False, "why: no time")]).solve()
    told = [m.message for m in last.log_messages]
    assert [text for text in told if "why" in text or "broke" in text] == [
        "far: why: slow", "near: why: late", "broke", "all: why: no time",
    ]  # fmt: skip
    assert [text.split()[0] for text in told if "proven" in text] == ["far", "near", "all"]


def test_a_rank_goes_on_with_what_those_before_have_learned(monkeypatch):
    opened, open_search = [], session.open_search

    def spied(*args, **options):
        opened.append((open_search(*args, **options), options["service"]))
        return opened[-1][0]

    monkeypatch.setattr(session, "open_search", spied)
    solved(["tardiness", "driving"])
    by_rank = [one for one in opened if one[0].start is not None or one[1] is None]
    (first, _), (second, service) = by_rank[0], by_rank[-1]
    assert first is not second
    assert service is first.motions.service is second.motions.service
    known = {one.statement for one in second.knowledge.active}
    assert {one.statement for one in first.knowledge.sure} <= known
    assert first.knowledge.sure


def test_without_a_plan_no_more_is_asked():
    for status in (Status.UNSOLVABLE_PROVEN, Status.TIMEOUT):
        ranks = Ranks([(status, False)])
        last = ranks.solve()
        assert (last.status, last.plan, len(ranks.asked)) == (status, None, 1)


def test_whoever_stops_it_has_the_best_plan_until_then():
    ranks = Ranks([(OPTIMAL, True), ("stop", False)])
    with pytest.raises(InterruptedSearch) as stop:
        ranks.solve()
    assert (stop.value.result.status, stop.value.result.plan) == (FOUND, ranks.plans[0])


def test_a_first_plan_is_by_the_first_rank():
    ranks = Ranks([(FOUND, True)])
    last = ranks.solve(first=True)
    assert (last.status, len(ranks.asked)) == (FOUND, 1)


def test_the_makespan_as_the_first_rank_is_asked_as_such():
    ranks = Ranks([(OPTIMAL, True)] * 3)
    ranks.problem.clear_quality_metrics()
    costs = [replace(cost, rank=n) for n, cost in enumerate(reversed(ranks.costs))]
    ranks.problem.add_quality_metric(MinimizeCosts(costs))
    ranks.solve()
    first, *others = [call.problem.quality_metrics[0] for call in ranks.asked]
    assert isinstance(first, MinimizeMakespan)
    assert all(isinstance(m, MinimizeCosts) for m in others)
