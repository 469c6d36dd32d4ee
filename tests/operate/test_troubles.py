"""Days full of trouble, drawn at random: robots break down and come back, some of them brought home
by hand, are held and released, areas are blocked for a while, orders are cancelled and changed, and
the process is stopped and goes on. Nobody meets anybody, and every order is done as it was said
last.
"""

import random
from pathlib import Path

import pytest

from tests.operate.abroad import abroad
from tests.operate.days import Day
from tests.operate.sites import anywhere, hall
from tests.operate.wire import AgvFloor
from up_samp.execution.floor import Delays
from up_samp.operate.records import OrderState, Settings
from up_samp.operate.simulated import Mishaps

MAPS = Path(__file__).parents[3] / "shared" / "data" / "maps"
NOTICED = 3.0
KINDS = ("broken", "broken", "held", "blocked", "cancelled", "changed", "restart")
FREE = (OrderState.WAITING, OrderState.PLANNED)


class TroubledDay:
    """``minutes`` of a day with ``robots`` robots, on a site that ``site(folder, rng, robots)``
    makes; everything else follows from ``seed``.
    """

    def __init__(self, folder, seed, minutes, robots, site=anywhere, floor=None):
        self.rng, self.seed, self.end = random.Random(f"trouble {seed}"), seed, 60.0 * minutes
        fleet = site(folder, random.Random(f"site {seed}"), robots)
        self.names = [*fleet.records.robots]
        drawn = sorted(self.drawn(), key=lambda e: e[0])
        self.events = [e for e in drawn if e[1] != "broken"]
        broken = tuple((when, who, lasts) for when, what, who, lasts in drawn if what == "broken")
        delays = Delays.of_share(0.3)
        mishaps = Mishaps(delays, lost=0.05, twice=0.05, breakdowns=broken)
        self.day = Day(
            folder, fleet=fleet, seed=seed, mishaps=mishaps,
            settings=Settings(stretch=5.0, tick=0.4), floor=floor,
        )  # fmt: skip
        self.places = [*fleet.records.places]
        self.number, self.next_order = 0, 0.0
        self.by_hand = {}
        self.holds, self.areas = {}, {}

    def drawn(self):
        """(when, what, who, how long), until the day ends."""
        now, found = self.rng.uniform(5, 25), []
        while now < self.end:
            what, who = self.rng.choice(KINDS), self.rng.choice(self.names)
            found.append((now, what, who, self.rng.uniform(10, 60)))
            now += self.rng.expovariate(1 / 30.0)
        return found

    @property
    def operation(self):
        return self.day.operation

    def run(self):
        """Live the day, and let everything be done; return the judge's verdict."""
        try:
            late = self.end + 900.0
            while self.day.clock.now() < self.end or (self.left() and self.day.clock.now() < late):
                self.happen(self.day.clock.now())
                self.day.step()
            self.story = self.day.story(30000)
            return self.day.verdict()
        finally:
            self.operation.close()

    def left(self):
        return self.day.robots.broken or self.operation.away or not self.operation.idle

    def happen(self, now):
        if now >= self.next_order and now < self.end:
            self.add(f"o{self.number}")
            self.number += 1
            self.next_order = now + self.rng.expovariate(len(self.names) / 60.0)
        while self.events and self.events[0][0] <= now:
            _, what, who, lasts = self.events.pop(0)
            getattr(self, what)(who, now, lasts)
        for who, until in [*self.holds.items()]:
            if until <= now:
                del self.holds[who]
                self.operation.release(who)
        for who, until in [*self.areas.items()]:
            if until <= now:
                del self.areas[who]
                self.operation.unblock(f"at {who}")
        self.break_down(now)

    def break_down(self, now):
        """See who has broken down, after a while, and who is repaired."""
        robots = self.day.robots
        for who, until in robots.broken.items():
            if who not in self.operation.away and now >= self.since(who, until) + NOTICED:
                self.operation.leave(who, "broken down")
                self.by_hand[who] = self.rng.random() < 0.3
        for who in [w for w in self.operation.away if w not in robots.broken]:
            home = self.day.fleet.records.robots[who].start
            pose = self.day.fleet.records.places[home].pose
            if self.by_hand.pop(who, False) and self.clear(who, pose):
                robots.put(who, pose)
                self.operation.join(who, pose)
            else:
                self.operation.join(who)

    def since(self, who, until):
        return max(
            w for w, n, s in self.day.robots.mishaps.breakdowns if n == who and w + s <= until
        )

    def clear(self, who, pose):
        """Whether nobody is near a pose, or on the way to it: who carries a robot there looks."""
        others = [self.day.robots.pose(n) for n in self.names if n != who]
        cut = self.operation.cut()
        others += [cut.poses[n] for n in self.names if n != who]
        near = any(max(abs(o[0] - pose[0]), abs(o[1] - pose[1])) < 2.5 for o in others)
        return not near and not any(
            self.passes(n, pose) for n in self.names if n != who and n not in self.operation.away
        )

    def passes(self, who, pose):
        """Whether a robot may drive by a pose by what it is told already."""
        executor = self.operation.executor
        way = executor and executor.state.of_object.get(who)
        if way is None:
            return False
        path = executor.drives[way.activity, who].path
        rows = path.poses_at([way.progress + 0.2 * k for k in range(100)])
        return any(max(abs(x - pose[0]), abs(y - pose[1])) < 2.5 for x, y, _ in rows)

    # ------------------------------------------------------------------ what happens

    def add(self, name):
        """Take an order, or change it."""
        ends = [p for p in self.places if not p.startswith(("home", "button", "now"))]
        pickup, delivery = self.rng.sample(ends, 2)
        options = {}
        if self.rng.random() < 0.3:
            options["due"] = self.day.clock.now() + self.rng.uniform(30, 300)
        self.day.order(name, pickup, delivery, **options)

    def held(self, who, now, lasts):
        self.holds[who] = now + lasts
        self.operation.hold(who)

    def blocked(self, who, now, lasts):
        if who not in self.areas:
            x, y, _ = self.day.fleet.records.places[self.rng.choice(self.places)].pose
            x, y = x + self.rng.uniform(-4, 4), y + self.rng.uniform(-4, 4)
            self.areas[who] = now + lasts
            corners = [(x, y), (x + 2, y), (x + 2, y + 2), (x, y + 2)]
            self.operation.block(f"at {who}", corners)

    def free(self):
        return [j.id for j in self.operation.jobs.values() if j.state in FREE]

    def cancelled(self, who, now, lasts):
        for name in self.rng.sample(self.free(), min(1, len(self.free()))):
            self.operation.cancel(name)

    def changed(self, who, now, lasts):
        for name in self.rng.sample(self.free(), min(1, len(self.free()))):
            self.add(name)

    def restart(self, who, now, lasts):
        self.day.restart()


def good(folder, seed, minutes, robots, site=anywhere, floor=None):
    """Live a day and judge it."""
    day = TroubledDay(folder, seed, minutes, robots, site, floor)
    verdict = day.run()
    assert verdict.good, (seed, verdict, day.story[-4000:])
    assert day.number > minutes * robots / 3


def test_a_short_day_of_troubles(tmp_path):
    good(tmp_path, 0, 1, 2)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(40))
def test_days_of_troubles_anywhere(tmp_path, seed):
    good(tmp_path, seed, 8, 2 + seed % 4)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(10))
def test_days_of_troubles_in_the_hall(tmp_path, seed):
    good(tmp_path, seed, 10, 2 + seed % 4, hall_drawn)


def over_a_wire(site, mishaps, seed):
    """AGVs of VDA 5050: messages are lost both ways, late and twice, and nothing arrives at all for
    a while now and then.
    """
    rng, cuts, now = random.Random(f"cuts {seed}"), [], 0.0
    while now < 3600.0:
        now += rng.expovariate(1 / 120.0)
        cuts.append((now, now + rng.uniform(1, 10)))
    return AgvFloor(site, mishaps, seed, cuts=cuts)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_days_of_troubles_of_agvs(tmp_path, seed):
    good(tmp_path, seed, 6, 2 + seed % 4, floor=over_a_wire)


def hall_drawn(folder, rng, robots):
    return hall(folder, robots)


@pytest.mark.skipif(not MAPS.is_dir(), reason="the maps of others are not there")
@pytest.mark.parametrize(
    ("seed", "minutes"), [(1, 1), *(pytest.param(n, 6, marks=pytest.mark.long) for n in range(40))]
)
def test_days_of_troubles_on_floors_of_others(tmp_path, seed, minutes):
    good(tmp_path, seed, minutes, 2 + seed % 4, abroad(MAPS))
