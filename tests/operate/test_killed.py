"""An operation is killed (SIGKILL) at random instants of a day, and started again: it goes on."""

import multiprocessing
import os
import random
import signal
import time
from pathlib import Path

import pytest

from tests.operate.days import Here
from tests.operate.sites import hall
from up_samp.operate.judge import judge_day
from up_samp.operate.loop import Operation
from up_samp.operate.records import Settings
from up_samp.operate.simulated import SimulatedRobots
from up_samp.operate.store import Store

SETTINGS = Settings(stretch=20.0, tick=0.4)


class Far:
    """Robots, orders and the clock are in another process, which is not killed."""

    waits = True

    def __init__(self, pipe):
        self.pipe = pipe
        self.levels, self.faults = {}, []

    def _ask(self, *what):
        self.pipe.send(what)
        return self.pipe.recv()

    def now(self):
        return self._ask("now")

    def sleep(self, seconds):
        self._ask("sleep", seconds)

    def reports(self, now):
        return self._ask("reports", now)

    def tell(self, commands, now):
        self._ask("tell", commands, now)

    def follow(self, executor):
        self._ask("follow", executor)

    def orders(self):
        return self._ask("orders")


def operate(folder, pipe):
    """Operate until nothing is left to do (the child's whole life)."""
    far = Far(pipe)
    store = Store(Path(folder) / "day.db", durable=False)
    day = Operation(
        hall(Path(folder), 2), store=store, robots=far, clock=far, planner=Here(), settings=SETTINGS
    )
    while True:
        for order in far.orders():
            if order["id"] not in day.jobs:
                day.add(order)
        day.step()
        if day.idle and len(day.jobs) == ORDERS:
            break
    day.close()
    pipe.send(("end",))


ORDERS = 3


class Floor:
    """The robots, and what they are asked and told."""

    def __init__(self, folder):
        site = hall(Path(folder), 2).records
        self.site, self.time, self.ended = site, 0.0, False
        poses = {n: site.places[r.start].pose for n, r in site.robots.items()}
        self.robots = SimulatedRobots(poses)

    def verdict(self, jobs):
        robots = self.robots
        return judge_day(self.site, jobs, robots.initial, robots.drives, robots.handled)

    def answer(self, what, *given):
        if what == "now":
            return self.time
        if what == "sleep":
            for _ in range(4):
                self.robots.step(self.time, given[0] / 4)
                self.time = round(self.time + given[0] / 4, 6)
        if what in ("reports", "tell", "follow"):
            return getattr(self.robots, what)(*given)
        if what == "orders":
            wanted = [(0, "shelf0", "dock1"), (15, "rack2", "dock0"), (30, "shelf2", "dock2")]
            return [
                {"id": f"o{k}", "pickup": p, "delivery": d, "due": 100.0 + t}
                for k, (t, p, d) in enumerate(wanted)
                if t <= self.time
            ]
        self.ended |= what == "end"
        return None


def story(folder):
    store = Store(Path(folder) / "day.db", write=False)
    return "\n".join(" ".join(map(str, row)) for row in store.notes(most=80))


def day_with_kills(folder, kills, seed):
    """Run a day whose process is killed so often; return the floor and the orders."""
    rng, floor = random.Random(seed), Floor(folder)
    context = multiprocessing.get_context("fork")
    killed = 0
    while not floor.ended:
        here, there = context.Pipe()
        child = context.Process(target=operate, args=(folder, there))
        child.start()
        there.close()
        at = rng.randrange(5, 400) if killed < kills else None
        spare = rng.random() * 0.02
        count = 0
        try:
            while not floor.ended:
                asked = here.recv()
                count += 1
                assert floor.time < 900.0, story(folder)
                if count == at:
                    time.sleep(spare)  # it waits, or writes, or plans
                    os.kill(child.pid, signal.SIGKILL)
                    killed += 1
                    break
                said = floor.answer(*asked)
                if not floor.ended:
                    here.send(said)
        except EOFError:
            pytest.fail(f"the operation ended by itself with {child.exitcode}")
        child.join(60)
        here.close()
        for _ in range(20):  # robots drive on to where they may, and stand
            floor.answer("sleep", 0.4)
    floor.robots.close()
    store = Store(Path(folder) / "day.db", write=False)
    jobs = store.jobs()
    store.close()
    return floor, jobs, killed


@pytest.mark.parametrize("seed", [0])
def test_a_killed_day_goes_on(tmp_path, seed):
    floor, jobs, killed = day_with_kills(tmp_path, 4, seed)
    assert killed == 4
    verdict = judge_day(
        floor.site, jobs, floor.robots.initial, floor.robots.drives, floor.robots.handled
    )
    assert verdict.good, verdict
    assert {j.state.value for j in jobs.values()} == {"done"}


@pytest.mark.long
def test_two_hundred_kills(tmp_path):
    killed = 0
    for seed in range(1, 200):
        folder = tmp_path / str(seed)
        folder.mkdir()
        floor, jobs, count = day_with_kills(folder, 8, seed)
        verdict = judge_day(
            floor.site, jobs, floor.robots.initial, floor.robots.drives, floor.robots.handled
        )
        assert verdict.good, (seed, verdict)
        killed += count
        if killed >= 200:
            return
    pytest.fail(f"only {killed} kills")
