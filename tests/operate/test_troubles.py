"""Days full of trouble, drawn at random: robots break down one after the other and come back, are
held and released, areas are blocked for a while, orders are cancelled. Nobody meets anybody.
"""

import random

import pytest

from tests.operate.days import Day
from tests.operate.sites import hall
from up_samp.execution.simulate import Delays
from up_samp.operate.records import OrderState
from up_samp.operate.settings import Settings
from up_samp.operate.simulated import Mishaps

NOTICED = 3.0


def troubles(seed, minutes, robots):
    """(when, what, who or where, until when), by time."""
    rng, found, end = random.Random(f"troubles {seed}"), [], 60.0 * minutes
    now = rng.uniform(5, 25)
    while now < end:
        what = rng.choice(("broken", "broken", "held", "blocked", "cancelled"))
        who = rng.choice(robots)
        found.append((now, what, who, now + rng.uniform(10, 60)))
        now += rng.expovariate(1 / 30.0)
    return found


def area(rng):
    """A square anywhere in the middle of the hall."""
    x, y = rng.uniform(6, 18), rng.uniform(3, 11)
    return [(x, y), (x + 2, y), (x + 2, y + 2), (x, y + 2)]


def day_of_troubles(folder, seed, minutes, robots=4):
    rng = random.Random(f"orders {seed}")
    names = [f"r{k}" for k in range(robots)]
    events = troubles(seed, minutes, names)
    broken = tuple(
        (when, who, until - when) for when, what, who, until in events if what == "broken"
    )
    day = Day(
        folder, fleet=hall(folder, robots), seed=seed,
        mishaps=Mishaps(Delays.of_share(0.3), lost=0.05, twice=0.05, breakdowns=broken),
        settings=Settings(stretch=5.0, tick=0.4),
    )  # fmt: skip
    do, number, next_order = [], 0, 0.0
    for when, what, who, until in events:
        late = NOTICED if what == "broken" else 0.0
        do += [(when + late, what, who), (until, f"not {what}", who)]
    do.sort()
    operation = day.operation
    try:
        while day.clock.now() < 60.0 * minutes or day.robots.broken:
            now = day.clock.now()
            if now >= next_order:
                day.order(f"o{number}")
                number, next_order = number + 1, now + rng.expovariate(robots / 60.0)
            while do and do[0][0] <= now:
                _, what, who = do.pop(0)
                act(operation, rng, day, what, who)
            for who in [r for r in operation.away if r not in day.robots.broken]:
                operation.join(who)
            operation.step()
        for who in names:
            operation.release(who)
        verdict = day.verdict()
        wrong = (*verdict.contacts, *verdict.twice, *verdict.elsewhere)
        assert not wrong, (seed, verdict)
        done = [j for j in operation.jobs.values() if j.state.value == "done"]
        assert len(done) > number // 5, (seed, len(done), number, day.story())
    finally:
        operation.close()


def act(operation, rng, day, what, who):
    if what == "broken" and who in day.robots.broken and who not in operation.away:
        operation.leave(who, "broken down")
    elif what == "held":
        operation.hold(who)
    elif what == "not held":
        operation.release(who)
    elif what == "blocked":
        operation.block(f"at {who}", area(rng))
    elif what == "not blocked" and f"at {who}" in operation.areas:
        operation.unblock(f"at {who}")
    elif what == "cancelled":
        free = (OrderState.WAITING, OrderState.PLANNED)
        for job in [j for j in operation.jobs.values() if j.state in free][:1]:
            operation.cancel(job.id)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(40))
def test_days_of_troubles(tmp_path, seed):
    day_of_troubles(tmp_path, seed, 10, robots=2 + seed % 4)
