"""What comes after an order on board of a robot that does nothing waits for it, and what is brought
from where that stands then is not brought before its time.
"""

import random

import pytest

from tests.operate.days import Day
from tests.operate.sites import hall


@pytest.mark.parametrize("seed", [0, 3])
def test_nothing_begins_before_what_it_comes_after_or_its_window(tmp_path, seed):
    rng = random.Random(f"after {seed}")
    fleet = hall(tmp_path, 0)
    for k in rng.sample(range(2), 2):
        fleet.add_place(f"home{k}", 1.5, 1.5 + 1.6 * k)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}")
    day = Day(tmp_path, fleet=fleet, seed=seed)
    opens = rng.choice((90, 140))
    first = {"pickup": "rack0", "robots": ["r0"]}
    first["delivery"] = {"at": "dock0", "window": [[opens, opens + 200]]}
    then = {"pickup": "shelf2", "delivery": "dock2", "after": ["first"], "robots": ["r1"]}
    last = {"at": "dock1", "duration": 3, "after": ["then", "first"]}
    later = [("then", then), ("last", last), ("free", {"at": "rack2", "duration": 2})]
    early = rng.random() < 0.5  # they are in a plan before r0 leaves, or come after that
    try:
        day.operation.add(dict(rng.sample([("id", "first"), *first.items()], 4)))
        day.until(lambda: day.operation.on_board() or early, 60)
        for name, record in rng.sample(later, 3):
            day.operation.add({"id": name, **record})
        day.until(day.operation.on_board, 60)
        day.operation.leave("r0")
        day.until(lambda: day.state("free") == "done", 60)
        day.operation.leave("r0", "moved", here := (3.0, 6.0, 1.0))
        day.robots.put("r0", here)
        day.operation.join("r0", here)
        day.run()
        ends = {h.what: h.end for h in day.robots.handled if h.kind != "pick"}
        assert [*sorted(ends, key=ends.get)][1:] == ["first", "then", "last"]
        assert day.verdict().good, (day.verdict(), day.story())
    finally:
        day.operation.close()


def test_what_comes_before_may_come_later(tmp_path):
    day = Day(tmp_path, robots=2)
    try:
        day.order("then", "rack0", "dock0", after=["first"])
        assert "it comes after 'first': not known yet" in day.story()
        day.until(lambda: day.clock.now() >= 12.0)
        assert day.state("then") == "waiting"
        day.order("first", "shelf1", "dock1")
        day.run()
        assert [h.what for h in day.robots.handled] == ["first", "first", "then", "then"]
        assert day.verdict().good, (day.verdict(), day.story())
    finally:
        day.operation.close()


@pytest.mark.parametrize("seed", range(2))
def test_what_is_on_board_is_not_brought_between_two_windows(tmp_path, seed):
    """Its robot broke down before the first one was over; what is late waits for the next one."""
    rng = random.Random(f"windows {seed}")
    day = Day(tmp_path, robots=2, seed=seed)
    gap = rng.choice((19, 21)), rng.choice((110, 130))
    windows = [[gap[1], gap[1] + 200], [rng.choice((0, 5)), gap[0]]]
    try:
        end = {"at": "dock0", "window": windows if seed else windows[::-1]}
        day.operation.add({"id": "bin", "pickup": "shelf0", "delivery": end, "robots": ["r0"]})
        day.until(day.operation.on_board, 60)
        day.operation.leave("r0")
        day.robots.put("r0", here := (3.0, 6.0, 1.0))
        day.operation.leave("r0", "moved", here)
        day.operation.join("r0", here)
        day.run()
        (brought,) = [h for h in day.robots.handled if h.kind == "task"]
        assert gap[1] <= brought.start < gap[1] + 2, (gap, brought)
        assert day.verdict().good, (day.verdict(), day.story())
    finally:
        day.operation.close()


@pytest.mark.parametrize("seed", range(3))
def test_what_is_too_late_for_its_windows_is_not_planned_again_and_again(tmp_path, seed):
    """It was asked for as long as the day lasted, and its log said nothing of why it waits."""
    rng = random.Random(f"too late {seed}")
    day = Day(tmp_path, robots=2, seed=seed)
    windows = [[0, 2.5], [4, 6.2]][: rng.choice((1, 2))]
    stop = {"at": "rack0", "service": 2, "window": rng.sample(windows, len(windows))}
    shapes = ({"pickup": stop}, {"delivery": stop}, {"at": "rack0", "window": windows})
    shape = {"pickup": "shelf1", "delivery": "dock0", **shapes[seed]}
    names = ("at", "duration", "window") if "at" in shape else ("pickup", "delivery")
    late = {k: {"duration": 2, **shape}[k] for k in names}
    try:
        day.operation.add({"id": "late", **late})
        day.order("o0", "rack1", "dock1")
        day.until(lambda: day.state("o0") == "done")
        asked = len(day.operation.costs)
        stop = day.clock.now() + 120.0
        day.until(lambda: day.clock.now() > stop)
        assert len(day.operation.costs) == asked
        assert day.state("late") == "waiting"
        assert day.story(500).count("its windows are over") == 1
        day.restart()
        day.step()
        assert day.story(500).count("its windows are over") == 1
    finally:
        day.operation.close()
