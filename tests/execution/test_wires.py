"""Robots behind a bad wire: what they tell comes late, several times, out of order or never, and
what they are told comes late. Nobody meets anybody, and every rule of the problem is kept, also
where orders are decided again from what was known a while ago, and where the executor is restored.
"""

import heapq
import itertools
import random

import pytest

from tests.execution.test_localisation import PLANS, check
from up_samp.execution import Delays, Executor, dependencies_of
from up_samp.execution.simulate import Floor, simulation_of

FAMILIES = (("rounds", 0), ("rounds", 3), ("rounds", 5), ("ways", 0), ("ways", 1), ("ways", 5))


class WiredFloor(Floor):
    """A floor whose messages take up to ``late`` s, and commands up to ``slow`` s."""

    def __init__(self, executor, delays, seed, late, slow, lost):
        super().__init__(executor, delays, seed)
        self.rng, self.late, self.slow, self.lost = random.Random(f"wire {seed}"), late, slow, lost
        self.told, self.number, self.commands = [], itertools.count(), []

    def send(self, tell):
        """Let something be told to the executor, once or more often, or never."""
        for _ in range(self.rng.choice((1, 1, 1, 2, 3))):
            if self.rng.random() >= self.lost:
                when = self.now + self.late * self.rng.random()
                heapq.heappush(self.told, (when, next(self.number), tell))

    def step(self):
        before, last = self._state(), max((when for when, _ in self.commands), default=0.0)
        when = max(last, self.now + self.slow * self.rng.random())
        self.commands.append((when, self.executive.commands(self.now)))
        while self.commands[0][0] <= self.now:
            self.tell(self.commands.pop(0)[1], self.now)
            if not self.commands:
                break
        disturbed = any(self.now < robot.held_until for robot in self.robots.values())
        self.drive(self.now, self.tick)
        for robot in self.robots.values():
            for report in self.told_by(robot, self.now):
                self.send(report)
        for activity in self.done(self.now):
            self.send((activity, self.now))
        while self.told and self.told[0][0] <= self.now:
            self.hear(heapq.heappop(self.told)[2])
        awaited = disturbed or self.executive.awaits_time or self.told
        still = not awaited and not self._may and before == self._state()
        self.idle = self.idle + self.tick if still else 0.0

    def hear(self, tell):
        if isinstance(tell, tuple):
            self.executive.done(*tell)
        elif tell.done:
            self.executive.done(tell.activity, tell.time, tell.robot)
        else:
            told = {"progress": tell.progress, "motion": tell.activity, "now": tell.time}
            self.executive.update(tell.robot, **told)


def wired(yaml, family, base, seeds):
    """Carry a plan out behind wires of some seeds; see that nothing is wrong."""
    problem, plan = PLANS[family](base, yaml)
    found = dependencies_of(problem, plan)
    for seed in seeds:
        rng = random.Random(f"wired {family} {base} {seed}")
        late, slow, lost = rng.choice((0, 0.2, 1.0)), rng.choice((0, 0.2, 0.5)), 0.5 * rng.random()
        delays = Delays(
            slow=rng.choice((0, 0.3, 0.6)), stops=rng.choice((0, 3.0)), stop_seconds=4.0,
            late=rng.choice((0, 0.5)), bias=rng.choice((0, 0.03)), noise=rng.choice((0, 0.02)),
        )  # fmt: skip
        known = {"dependencies": found, "latency": late + slow, "ahead": rng.choice((None, 2.0))}
        executor, proposed = Executor(plan, problem, **known), None
        floor = WiredFloor(executor, delays, seed, late, slow, lost)
        while floor.goes_on:
            floor.step()
            if proposed is None and rng.random() < 0.05:
                proposed = executor.propose_order()
            elif rng.random() < 0.1:
                executor.adopt(proposed)
                proposed = None
            if rng.random() < 0.01:
                executor = Executor.restore(plan, executor.save(), problem, **known)
                floor.executive = executor
        check(simulation_of(floor, plan, "wired", seed))


@pytest.mark.parametrize(("family", "base"), FAMILIES[3:])
def test_a_bad_wire_does_no_harm(yaml, family, base):
    wired(yaml, family, base, range(2))


@pytest.mark.long
@pytest.mark.parametrize(("family", "base"), FAMILIES)
def test_bad_wires_do_no_harm_in_many_runs(yaml, family, base):
    wired(yaml, family, base, range(100, 130))
