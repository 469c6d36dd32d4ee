"""Many robots at once: ejection and large-neighbourhood search over motions."""

from dataclasses import replace

import numpy as np
import pytest

from tests.motion.fleet import tight_places as tight
from tests.motion.fleet.independent import judge
from up_samp.model import Deadline, GroupQuery, GroupReport, Outcome
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.neighbourhoods import MovingGroup, first_runs, improve
from up_samp.motion.fleet.workspace import workspace_of
from up_samp.motion.protocol import WorkBudget
from up_samp.motion.service import MotionService


def planned(traffic, plans):
    service = MotionService(traffic.grid)
    workspace = workspace_of(service)
    motions = {m.name: m for m in traffic.query.motions}
    ways = {n: [workspace.path(m.body, m.poses, (), Deadline.never())] for n, m in motions.items()}
    budget = WorkBudget(Deadline.never(), 200)
    problem = MovingGroup(workspace, motions, (), budget, ways)
    runs = first_runs(problem)
    problem.used = problem.budget.used
    problem.budget = WorkBudget(Deadline.never(), plans)
    return problem, runs, improve(problem, runs, list(runs), seed=1) if plans else runs


def test_arrivals_get_earlier_and_the_plan_stays_valid(tmp_path):
    traffic = tight.errands(tight.pillars(), tight.omni(), 8, 2)
    problem, runs, better = planned(traffic, 60)
    before, after = (sum(problem.cost(n, r.arrival) for n, r in f.items()) for f in (runs, better))
    assert after <= before
    assert problem.budget.used >= 60
    found = {name: run.timing.trajectory for name, run in better.items()}
    judge(traffic, GroupReport(Outcome.FOUND, found), tmp_path)


def test_same_seed_same_plan():
    traffic = tight.errands(tight.pillars(), tight.omni(), 5, 4)
    (_, _, first), (_, _, second) = planned(traffic, 30), planned(traffic, 30)
    for name, run in first.items():
        assert np.array_equal(run.timing.trajectory.times, second[name].timing.trajectory.times)


def test_nobody_is_moved_who_may_not_be():
    traffic = tight.errands(tight.pillars(), tight.omni(), 6, 5)
    problem, runs, _ = planned(traffic, 0)
    problem.budget = WorkBudget(Deadline.never(), 30)
    better = improve(problem, runs, ["go0", "go1"])
    assert all(better[name] is runs[name] for name in runs if name not in ("go0", "go1"))


@pytest.mark.parametrize("seed", [1, 2])
def test_who_ejects_each_other_again_and_again_makes_way(seed, tmp_path):
    traffic = tight.errands(tight.aisles(), tight.omni(), 6, seed)
    _, runs, _ = planned(traffic, 0)
    assert runs is not None
    found = {name: run.timing.trajectory for name, run in runs.items()}
    judge(traffic, GroupReport(Outcome.FOUND, found), tmp_path)


def test_two_who_come_to_one_place_do_not_take_turns_at_ejecting_each_other(tmp_path):
    """One rests there for long, the other comes a bit too soon after it: who comes first rests, so
    that ejecting it gains as much as the rest lasts, and loses it again.
    """
    body, plug = tight.differential(tight.SMALL), (15.0, 5.0, 0.0)
    grid = tight.hall(20, 10, [(0.5, 0.5, 19.5, 9.5)])
    legs = [((3.0, 2.0, 0.0), plug), (plug, (18.0, 8.0, 0.0)), ((3.0, 8.0, 0.0), plug)]
    first, on, second = tight.drives(body, legs).motions
    on = replace(on, object=first.object, release=400.0, present_from=400.0, due=430.0)
    first = replace(first, due=30.0, present_until=400.0)
    second = replace(second, due=401.0, present_until=800.0)
    query = GroupQuery((first, on, second))
    problem, runs, _ = planned(tight.Traffic("plug", grid, query), 0)
    assert runs[first.name].arrival < 30.0
    assert 400.0 < runs[second.name].arrival < 410.0
    assert problem.used < 40


def test_who_may_only_leave_later_is_passed_where_it_stands(tmp_path):
    body = tight.omni()
    grid = tight.hall(20, 10, [(0.5, 0.5, 19.5, 9.5)])
    first, later = tight.drives(
        body, [((2.0, 5.0, 0.0), (18.0, 5.0, 0.0)), ((10.0, 5.0, 0.0), (10.0, 8.0, 0.0))]
    ).motions
    query = GroupQuery((first, replace(later, release=40.0)))
    report = coordinate(MotionService(grid), query, Deadline.after(60))
    assert report.outcome is Outcome.FOUND
    assert report.trajectories[first.name].end < 40.0
    judge(tight.Traffic("later", grid, query), report, tmp_path)
