"""How long a search goes on where nothing is said: until a bound is met, or patience ends."""

import itertools
import math
import time
from types import SimpleNamespace

import pytest
from unified_planning.shortcuts import OneshotPlanner, get_environment

from tests.metamorphic.motions import ALIKE, write
from tests.metamorphic.sites import store
from up_samp.model import Deadline, ProblemError
from up_samp.model.deadline import computing_time
from up_samp.search.budget import PARTS, Budget, SchedulerPace
from up_samp.search.fleet import solve
from up_samp.search.knowledge import History
from up_samp.search.params import Parameters
from up_samp.validation import validate_plan


@pytest.fixture(autouse=True)
def patience_as_it_is(monkeypatch):
    """What is tested here, other tests spare."""
    monkeypatch.setattr("up_samp.search.budget._PATIENCE", 1.0)


def budget(total=100.0, **settings):
    return Budget(Deadline.counted(total), 10.0, **settings)


def test_patience_begins_anew_with_each_better_plan():
    spent = budget(patience=1.0)
    assert not spent.hurried
    spent.deadline.spend(10.0)
    spent.planned()
    assert spent.hurried
    assert spent.deadline.remaining() == pytest.approx(10.0)
    spent.deadline.spend(6.0)
    spent.planned()
    assert spent.deadline.remaining() == pytest.approx(16.0)
    assert not spent.impatient
    spent.deadline.spend(17.0)
    assert spent.impatient
    spent.end()
    assert not spent.hurried
    assert spent.deadline.remaining() > 60.0


def test_patience_is_a_second_at_least_and_never_more_than_there_is_time():
    soon = budget(patience=0.5)
    soon.planned()
    assert soon.deadline.remaining() == pytest.approx(1.0)
    late = Budget(Deadline.after(0.5), 10.0, patience=9.0)
    late.planned()
    assert late.deadline.remaining() <= 0.5


def test_computing_time_does_not_pass_while_this_process_waits():
    with computing_time():
        soon = Deadline.after(0.2)
        time.sleep(0.3)
        assert not soon.expired()
        assert soon.moment > time.monotonic()
        while not soon.expired():
            pass
    assert Deadline.after(100.0).remaining() > 99.0


def test_endless_patience_changes_nothing():
    spent = budget()
    spent.planned()
    assert spent.deadline.remaining() == pytest.approx(100.0)
    assert not spent.hurried


def test_patience_lasts_a_share_of_the_time_limit_at_least(monkeypatch):
    monkeypatch.setitem(PARTS, "patience", (0.25, 15.0))
    for limit, patience, left in (
        (40.0, 1.0, 10.0),
        (40.0, 0.5, 5.0),
        (40.0, 0.0, 1.0),
        (100.0, 2.0, 30.0),
        (9e3, 1.0, 15.0),
    ):
        soon = budget(limit, patience=patience)
        soon.deadline.spend(3.0)
        soon.planned()
        assert soon.deadline.remaining() == pytest.approx(left)
        soon.deadline.spend(0.5)
        soon.planned()
        assert soon.deadline.remaining() == pytest.approx(left)
    unlimited = Budget(Deadline.never(), 10.0, patience=1.0)
    unlimited.planned()
    assert unlimited.deadline.remaining() <= 1.0


def test_a_quarter_of_patience_is_for_the_motions_of_what_is_found():
    spent, pace = budget(patience=1.0), SchedulerPace(True, proof_seconds=30.0)
    spent.deadline.spend(20.0)
    spent.planned()
    deadline = pace.deadline(spent, planned=True, proving=True)
    assert deadline.remaining() == pytest.approx(15.0)


@pytest.mark.parametrize(
    "given", [{"patience": -1.0}, {"patience": math.nan}, {"first_plan": True, "optimal": True}]
)
def test_what_makes_no_sense_is_refused(given):
    with pytest.raises(ProblemError, match=r"patience|different things"):
        Parameters(**given)


def test_the_default_goes_on_and_the_first_plan_is_to_be_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(get_environment(), "credits_stream", None)
    found = {}
    for name, given in (("first", {"first_plan": True}), ("default", {})):
        problem, plans = write(store(3), ALIKE[1], tmp_path), []

        def watch(event, plans=plans):
            if event.phase == "plan":
                plans.append(event.upper_bound)

        params = {"reproducible": True, "progress": watch, **given}
        with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
            result = planner.solve(problem, timeout=120)
        assert validate_plan(problem, result.plan).valid
        assert plans[-1] == int(result.metrics["makespan"])
        found[name] = plans
    assert len(found["first"]) == 1
    assert found["default"][0] == found["first"][0] > found["default"][-1]


def test_each_better_plan_of_a_fleet_gives_those_after_it_the_time_to_come(monkeypatch):
    spent, kept = budget(1000.0, patience=1.0), []
    spent.deadline.spend(10.0)
    spent.planned()

    def improved(over, deadline):
        for number in itertools.count():
            if over():
                return
            spent.deadline.spend(8.0)
            if number < 10:
                yield number

    def keep(search, found):
        kept.append(found)
        spent.planned()

    monkeypatch.setattr(solve, "plan_of_tours", lambda _, decided: decided)
    monkeypatch.setattr(solve, "keep_if_better", keep)
    search = SimpleNamespace(
        budget=spent, history=History(), stopped=False, bounds=SimpleNamespace(met=False)
    )
    large = SimpleNamespace(part=lambda deadline, name: deadline.share(0.6))
    better = SimpleNamespace(
        improved=improved, without_traffic=math.inf, assignment=None, tours=None, best=None
    )
    assert list(solve.improve(search, large, better)) == []
    assert kept == list(range(10))
    assert 180.0 < spent.deadline.used() < 190.0  # twice as long as to the best one
