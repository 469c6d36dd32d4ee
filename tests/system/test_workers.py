"""Tasks behind an executor: answers in the order asked, and a lost worker costs its tasks only."""

import logging
import operator
import signal
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

import pytest

from up_samp.system.workers import Workers, WorkItem

FOREVER = partial(float, "inf")


def power(base, here):
    """A task: the square of a number, as the remaining time of 2 s says."""

    def now(seconds):
        here.append(base)
        return base**seconds

    return WorkItem(operator.pow, (base,), now, lambda: 2)


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals there")
def test_a_pool_whose_process_dies(caplog):
    here = []
    # it gets the signal whose number is its remaining time
    deadly = WorkItem(signal.raise_signal, (), lambda seconds: -1, lambda: int(signal.SIGKILL))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        workers = Workers(pool)
        assert workers.answers([power(3, here)], FOREVER) == [9]
        assert (here, workers.lost) == ([], 0)
        tasks = [power(4, here), deadly, power(5, here), power(6, here)]
        assert workers.answers(tasks, FOREVER) == [16, -1, 25, 36]
        assert workers.lost == 1 + len(here)
        assert here in ([5, 6], [4, 5, 6])  # a pool that breaks may lose what is not fetched yet
        # the pool is gone: all is done here from now on
        assert workers.answers([power(7, here)], FOREVER) == [49]
    told = [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]
    assert len(told) == 1
    assert "a worker is lost" in told[0]


def test_the_first_question_is_answered_first():
    def late(number, seconds):
        time.sleep(0.2 / (1 + number))
        return number

    tasks = [WorkItem(late, (k,), partial(late, k), lambda: 9.0) for k in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert Workers(pool).answers(tasks, FOREVER) == [0, 1, 2, 3]


def test_nobody_is_waited_for_past_the_end():
    gate = threading.Event()
    tasks = [
        WorkItem(lambda seconds: gate.wait(20.0), (), lambda seconds: False, lambda: 0.1),
        WorkItem(lambda seconds: True, (), lambda seconds: False, lambda: 0.1),
    ]
    began = time.monotonic()
    with ThreadPoolExecutor(1) as pool:
        workers = Workers(pool)
        assert workers.answers(tasks, lambda: 0.1) == [None, None]
        gate.set()
    assert time.monotonic() - began < 10.0
    assert workers.lost == 0


def test_what_is_lost_too_late_is_not_done_here():
    class Refusing(ThreadPoolExecutor):
        def submit(self, *given, **named):
            raise RuntimeError("no more tasks")

    with Refusing(1) as pool:
        workers = Workers(pool)
        none, two = (
            WorkItem(int, (), lambda seconds: 2, lambda left=left: left) for left in (0.0, 1.0)
        )
        assert workers.answers([none, two], FOREVER) == [None, 2]
        assert workers.lost == 2
