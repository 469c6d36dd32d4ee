"""A simulated day on a small site, step by step."""

import random
from pathlib import Path

from tests.operate.sites import hall
from up_samp.motion.protocol import MotionCache
from up_samp.operate.clock import SimulatedClock
from up_samp.operate.horizon import Opened
from up_samp.operate.judge import judge_day
from up_samp.operate.loop import Operation
from up_samp.operate.planner import answer
from up_samp.operate.records import Settings
from up_samp.operate.simulated import Mishaps, SimulatedRobots, SteppedClock
from up_samp.operate.store import Store

NONE = Mishaps()
PATIENT = Settings(stretch=20.0)
"""The planner has 40 s of real time, however busy the machine is."""


class Here:
    """A planner in the same process: it is killed with it, and keeps motions as long."""

    busy = False

    def __init__(self):
        self.cache = MotionCache()

    def ask(self, question):
        self.said = answer(question, self.cache)

    def taken(self, wait=False):
        return self.said

    def close(self):
        pass


class Day:
    """An operation with simulated robots, in ``folder``; ``planner`` is the one of this process by
    default, and one in a process of its own where it is ``None``. ``floor(site, mishaps, seed)``
    makes other robots.
    """

    def __init__(
        self,
        folder,
        robots=2,
        mishaps=NONE,
        settings=PATIENT,
        seed=0,
        fleet=None,
        planner=Here,
        floor=None,
    ):
        self.fleet = fleet or hall(Path(folder), robots)
        site, self.folder, self.planner = self.fleet.records, Path(folder), planner
        self.settings = settings
        poses = {n: site.places[r.start].pose for n, r in site.robots.items()}
        self.robots = (
            floor(site, mishaps, seed) if floor else SimulatedRobots(poses, mishaps, seed, site)
        )
        self.clock = SteppedClock(SimulatedClock(), self.robots)
        self._operate()
        self.random = random.Random(f"day {seed}")

    def _operate(self):
        self.store = Store(self.folder / "day.db", durable=False)
        self.operation = Operation(
            self.fleet, store=self.store, robots=self.robots, clock=self.clock,
            settings=self.settings, planner=self.planner and self.planner(),
        )  # fmt: skip

    def restart(self):
        """Stop the process that operates, and begin another that goes on: all that has happened is
        known there.
        """
        before = self.operation.executor
        self.operation.close()
        if hasattr(self.robots, "restart"):
            self.robots.restart()
        self._operate()
        after = self.operation.executor
        assert before is None or before.state.fired.keys() <= after.state.fired.keys()

    def order(self, name, pickup=None, delivery=None, **options):
        rng = self.random
        pickup = pickup or f"{rng.choice(['shelf', 'rack'])}{rng.randrange(3)}"
        delivery = delivery or f"dock{rng.randrange(3)}"
        end = {"at": delivery, "service": 2}
        return self.operation.add({"id": name, "pickup": pickup, "delivery": end, **options})

    def until(self, good, most=600.0):
        stop = self.clock.now() + most
        while not good():
            assert self.clock.now() < stop, self.story()
            self.step()

    def step(self):
        """Let a tick pass; now and then see that a plan can be cut."""
        self.operation.step()
        if self.random.random() < 0.05:
            cut = self.operation.cut(dict.fromkeys(self.operation.there(), Opened.ALL))
            meanings, ended = self.operation.meanings, set()
            assert len(set(cut.kept)) == len(cut.kept)
            for name in cut.kept:  # in each robot's order
                assert meanings[name].robot not in ended, (name, cut)
                ended |= {meanings[name].robot} if name in cut.stops else set()

    def run(self, most=600.0):
        self.until(lambda: self.operation.idle, most)

    def state(self, name):
        return self.operation.jobs[name].state.value

    def verdict(self):
        self.robots.close()
        return judge_day(
            self.fleet.records, self.operation.jobs, self.robots.initial, self.robots.drives,
            self.robots.handled,
        )  # fmt: skip

    def story(self, most=60):
        lines = [" ".join(map(str, row)) for row in self.store.notes(most=most)]
        return "\n".join(lines)
