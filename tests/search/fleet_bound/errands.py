"""Random errands of robots, written by hand in mixed styles: drives begin where a fluent says or at
a place, orders are stated, with gaps, or left to the fluents, and everything is listed anyhow.
"""

import itertools
import random

from unified_planning.model import ClosedTimeInterval, Timing
from unified_planning.shortcuts import (
    LE,
    LT,
    And,
    Equals,
    GlobalEndTiming,
    Implies,
    Not,
    Or,
)

from tests.search.fleet_bound.test_jobs_bound import told_apart
from tests.search.test_assumptions import PLACES, Site
from tests.shuffled import shuffled

TOWNS = tuple(name for name in PLACES if not name.startswith("home"))


class Errands(Site):
    """A site and what is to be done there, as a seed says."""

    def __init__(self, seed):
        self.rng = rng = random.Random(f"errands {seed}")
        super().__init__(rng.choice([1, 2, 2]))
        self.silent = rng.choice([0.2, 0.2, 0.2, 0.7])
        self.made = 0
        for _ in range(rng.choice([1, 1, 2])):
            self.job(
                [(rng.choice(TOWNS), rng.choice([0, 1, 6])) for _ in range(rng.choice([1, 2, 3]))]
            )
        for r in range(len(self.robot)):
            for to in rng.sample(TOWNS, rng.choice([0, 0, 1, 2])):
                self.drive(self.name("aside"), r, to, hand=rng.random() < 0.9)
            if rng.random() < 0.2:
                self.drive(self.name("back"), r, f"home{r}")
                home = Equals(self.at[r], self.place[f"home{r}"])
                self.problem.add_condition(GlobalEndTiming(), home)

    def name(self, what):
        self.made += 1
        return f"{what}{self.made}"

    def job(self, stops):
        """Add a job that one of the robots does, or one robot in one of two ways."""
        ways = [self.way(r, stops) for r in range(len(self.robot)) for _ in range(2)]
        every = [w for w in ways if self.rng.random() < 0.7]
        self.one_of(*map(self.rng.choice, every if len(every) > 1 else ways))

    def way(self, r, stops):
        """Return all that is done in one way to do a job."""
        rng, here, found = self.rng, f"home{r}", []
        for at, units in stops:
            if at != here:
                origin = rng.choice([None, None, here, rng.choice(TOWNS)])
                to = self.drive(self.name("go"), r, at, origin if origin != at else here)
                found.append(to)
            if units or at == here:
                found.append(self.work(self.name("do"), r, units or 2, at))
                self.stay(found[-1], r, at)
            here = at
        for pair in itertools.pairwise(found):
            self.tie(*pair)
        return found

    def stay(self, a, r, at):
        """Say now and then that it is done there from its start to its end."""
        if self.rng.random() < 0.3:
            span = ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))
            a.conditions.clear()
            a.add_condition(span, Equals(self.at[r], self.place[at]))

    def tie(self, first, then):
        """State that both are there if one is, and perhaps their order."""
        rng = self.rng
        for one, other in ((first, then), (then, first)):
            styles = (
                (other.present, [one]),
                (Implies(one.present, other.present), []),
                (Or(other.present, Not(one.present)), []),
            )
            said, scope = rng.choice(styles)
            self.state(said, *scope)
        if rng.random() < self.silent:
            return
        before = LT(first.end, then.start) if rng.random() < 0.7 else LE(first.end + 4, then.start)
        if rng.random() < 0.5:
            self.state(before, first, then)
        else:
            self.state(Implies(And(then.present, first.present), before))


def errands(seed):
    """Return the problem of a seed."""
    problem = shuffled(Errands(seed).problem, seed).problem
    told_apart(problem)
    return problem
