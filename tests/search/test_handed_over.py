"""What another engine is handed over: what our own scheduler drew, then more; what that proves."""

import random

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.model.metrics import MinimizeMakespan

from tests.search.test_end_to_end import solve
from tests.search.test_parameters import INSTALLED
from tests.search.test_tidy import idle_fleet
from tests.usual import usually
from up_samp.benchmarks.instances import instance
from up_samp.model import Deadline, ScheduleReport, ScheduleStatus, UnsupportedError
from up_samp.model.refinement import Strength
from up_samp.refinement import rules
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.thinned import ThinnedScheduler
from up_samp.upio import read_problem, relax, write_refinement
from up_samp.validation import validate_plan


class Scripted:
    """An engine that gives the answers it is given, or what our own scheduler finds."""

    def __init__(self, *answers):
        self.answers, self.parts = list(answers), []

    def solve(self, deadline, *, optimal=True, part=None):
        self.parts.append(part)
        assert not optimal
        answer = self.answers.pop(0) if self.answers else None
        if isinstance(answer, Exception):
            raise answer
        if answer is not None:
            return ScheduleReport(answer, message="scripted")
        return CpsatSession(part, workers=1).solve(deadline, optimal=False)


def draw(problem, *answers, refinements=()):
    """Return what comes of a draw that an engine with these answers is handed over."""
    relaxation = relax(problem, read_problem(problem))
    for refinement in refinements:
        write_refinement(relaxation, refinement)
    engine = Scripted(*answers)
    scheduler = ThinnedScheduler(engine, relaxation, seed=0)
    return scheduler.solve(Deadline.after(60), optimal=False), engine.parts


def names(part):
    return {a.name for a in part.activities}


@pytest.mark.parametrize("refusal", [ScheduleStatus.INFEASIBLE, ScheduleStatus.NOT_FOUND])
def test_what_is_refused_is_followed_by_more(tmp_path, refusal):
    problem = idle_fleet(tmp_path).problem
    report, parts = draw(problem)
    assert names(parts[0]) < names(problem)
    assert len(parts) == 1
    report, parts = draw(problem, refusal, refusal)
    assert names(parts[0]) < names(parts[1]) <= names(parts[2]) == names(problem)
    assert report.schedule is not None
    assert [told.partition(" (")[0] for told in report.handed_over] == [
        "what our own scheduler drew",
        "that and all moves",
        "the whole",
    ]


def test_a_part_that_takes_too_long_has_no_quicker_whole(tmp_path):
    report, parts = draw(idle_fleet(tmp_path).problem, ScheduleStatus.OUT_OF_TIME)
    assert report.status is ScheduleStatus.OUT_OF_TIME
    assert len(parts) == 1
    assert report.schedule is None


def test_no_word_of_an_engine_about_parts_is_a_proof(tmp_path):
    """Not even that all of it leaves nothing: ours has just drawn something."""
    report, _ = draw(idle_fleet(tmp_path).problem, *[ScheduleStatus.INFEASIBLE] * 3)
    assert report.status is ScheduleStatus.NOT_FOUND
    assert report.message == "scripted"


def test_what_is_too_large_is_told_after_smaller_parts_only(tmp_path):
    problem, large = idle_fleet(tmp_path).problem, UnsupportedError("too large a message")
    report, _ = draw(problem, ScheduleStatus.NOT_FOUND, large, large)
    assert (report.status, report.message) == (ScheduleStatus.ERROR, str(large))
    with pytest.raises(UnsupportedError, match="too large"):
        draw(problem, large)


def test_engines_are_not_told_of_places_and_plans_heed_them(tmp_path):
    """Robot 1 may come to where robot 0 stood once that is gone."""
    hall = idle_fleet(tmp_path)
    hall.move("follow", 1, "left1", "left0")
    place = rules.unary_place("left0", {"follow"}, {"go"}, True)
    report, (part,) = draw(hall.problem, refinements=[place])
    touched = {e.fluent.fluent().name for _, e, _ in part.all_effects()}
    assert touched
    assert not any(name.startswith("samp_free") for name in touched)
    times = report.schedule.times
    assert place.strength is Strength.PROVEN
    assert times["go"][0] < times["follow"][1]
    assert not part.quality_metrics


SMALL = ("jobshop-r2-j1-m4", "jobshop-r2-j1-m2", "logistics-do-oc-r2-i3")


@pytest.mark.skipif("aries" not in INSTALLED, reason="no aries")
@pytest.mark.parametrize("name", usually(SMALL[-1], of=SMALL))
def test_aries_schedules_what_it_cannot_even_read_whole(name):
    """A job shop with four machines is a message of 5 MB. The bound is ours, of the whole."""
    problem = instance(name).build("fluents", True)
    random.Random(name).shuffle(problem._activities)
    found = solve(problem, "aries", optimal=False, timeout=300, first_plan=False)
    assert validate_plan(problem, found.plan).valid
    assert "what our own scheduler drew" in found.metrics["handed_over"]
    own = solve(problem, "cpsat", optimal=True, timeout=300)
    assert found.status is own.status is Status.SOLVED_OPTIMALLY
    assert found.metrics["lower_bound"] == own.metrics["lower_bound"]
    assert any("was handed over" in m.message for m in found.log_messages)


@pytest.mark.skipif("aries" not in INSTALLED, reason="no aries")
@pytest.mark.long
def test_the_papers_loop_hands_over_the_whole(tmp_path):
    hall = idle_fleet(tmp_path)
    assert isinstance(hall.problem.quality_metrics[0], MinimizeMakespan)
    found = solve(hall.problem, "aries", preset="paper", first_plan=True)
    assert found.plan is not None
    assert "handed_over" not in found.metrics
