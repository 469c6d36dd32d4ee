"""What every scheduler must solve, prove and refuse."""

from __future__ import annotations

import pytest

from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling import open_scheduler

from .problems import fetch_and_return

ENGINES = ("aries", "aries-opt")
SOLVED = (ScheduleStatus.FOUND, ScheduleStatus.OPTIMAL)


@pytest.fixture(params=ENGINES)
def solve(request):
    opened = []

    def run(problem, seconds=20.0, **arguments):
        scheduler = open_scheduler(request.param, problem)
        opened.append(scheduler)
        return scheduler.solve(Deadline.after(seconds), **arguments)

    run.engine = request.param
    yield run
    for scheduler in opened:
        scheduler.close()


def test_optional_activities_with_a_fluent(solve):
    report = solve(fetch_and_return())
    assert report.status in SOLVED
    assert set(report.schedule.times) == {"go", "pick", "back"}
    assert report.schedule.makespan >= 11
    if solve.engine != "aries":
        assert report.status is ScheduleStatus.OPTIMAL
        assert report.bound == report.schedule.makespan == 11
