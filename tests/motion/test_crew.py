"""Motion queries done by workers: the same answers, whoever is first and whoever is lost."""

import os
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from tests.motion.fleet import tight_places as tight
from tests.oracles.odd_executors import Backwards, Killing
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery
from up_samp.motion.crew import Crew, can_be_sent
from up_samp.motion.service import MotionService
from up_samp.system.workers import Workers


def errands(count=8):
    traffic = tight.errands(tight.pillars(), tight.omni(), count, 3)
    return traffic.grid, [PathQuery(m.body, m.poses) for m in traffic.query.motions]


def answers(service, queries):
    reports = [service.plan(q, Deadline.never()) for q in queries]
    assert all(r.outcome is Outcome.FOUND for r in reports)
    return [(r.trajectory.times, r.trajectory.poses) for r in reports]


def same(one, two):
    return all(
        np.array_equal(a, b)
        for x, y in zip(one, two, strict=True)
        for a, b in zip(x, y, strict=True)
    )


@pytest.mark.parametrize(
    "executor",
    [Backwards(), Backwards(lost={0}, error=RuntimeError), None],
    ids=["reversed", "one lost", "threads"],
)
def test_answers_do_not_depend_on_the_workers(executor):
    grid, queries = errands()
    alone = answers(MotionService(grid), queries)
    service = MotionService(grid)
    crew = Crew(Workers(executor or ThreadPoolExecutor(2)), service)
    assert crew.plan_ahead(queries, Deadline.never()) == len(queries)
    assert (crew.workers.lost > 0) == bool(executor is not None and executor.lost)
    # they are in the cache: no time is needed any more
    found = [service.plan(q, Deadline.after(5.0)) for q in queries]
    assert all(report.complete for report in found)
    assert same(alone, answers(service, queries))


def test_groups_come_back_in_the_order_asked():
    build = tight.CASES["ring of four"].build
    groups = [build(tight.omni()), build(tight.differential())]
    grid = groups[0].grid
    service = MotionService(grid)
    crew = Crew(Workers(Backwards()), service)
    queries = [g.query for g in groups]
    deadlines = [Deadline.after(100.0), Deadline.after(120.0)]
    found = crew.coordinate(queries, deadlines, seed=0)
    for query, (report, cut_short) in zip(queries, found, strict=True):
        mine = MotionService(grid).coordinate(query, Deadline.after(100.0))
        assert not cut_short
        assert report.outcome is mine.outcome is Outcome.FOUND
        for name, trajectory in mine.trajectories.items():
            assert np.array_equal(report.trajectories[name].poses, trajectory.poses)


def test_nothing_is_waited_for_past_the_deadline():
    grid, queries = errands(2)
    began = time.monotonic()
    with ThreadPoolExecutor(1) as pool:
        held = threading.Event()
        pool.submit(held.wait, 20.0)  # the only worker is busy
        crew = Crew(Workers(pool), MotionService(grid))
        assert crew.plan_ahead(queries, Deadline.after(0.3)) == 0
        held.set()
    assert time.monotonic() - began < 10.0
    assert crew.workers.lost == 0


def test_flyers_and_laws_of_motion_stay_here():
    assert can_be_sent(tight.car())
    assert not can_be_sent(Body((), Kinematics(MotionModel.SE3), mesh="drone.stl"))


@pytest.mark.long
def test_a_pool_whose_worker_is_killed():
    grid, queries = errands(20)
    alone = answers(MotionService(grid), queries)
    service = MotionService(grid)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        crew = Crew(Workers(Killing(pool, pool.submit(os.getpid).result())), service)
        assert crew.plan_ahead(queries, Deadline.never()) == len(queries)
    assert crew.workers.lost > 0
    assert same(alone, answers(service, queries))


@pytest.mark.long
def test_a_dask_cluster_whose_worker_is_killed_on_the_way():
    distributed = pytest.importorskip("distributed")
    grid, queries = errands(20)
    alone = answers(MotionService(grid), queries)
    service = MotionService(grid)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        victim = next(iter(client.run(os.getpid).values()))
        crew = Crew(Workers(Killing(client.get_executor(), victim)), service)
        assert crew.plan_ahead(queries, Deadline.never()) == len(queries)
        assert victim not in client.run(os.getpid).values()
    assert same(alone, answers(service, queries))
