"""Shifts and breaks over a day: nobody drives or does anything outside its shift, everybody rests
in its breaks, and what cannot be done before a shift ends is left to others.
"""

import random

import pytest

from tests.operate.days import Day
from tests.operate.sites import hall
from up_samp.operate.simulated import driven_until
from up_samp.operate.upkeep import OFF


@pytest.fixture
def days(tmp_path):
    made = []

    def begin(fleet, **options):
        made.append(Day(tmp_path, fleet=fleet, **options))
        return made[-1]

    yield begin
    for day in made:
        day.operation.close()


def hall_of(folder, **robots):
    """A hall whose robots have these shifts and breaks; all of them end where they start."""
    fleet = hall(folder, 0)
    for k, (name, options) in enumerate(robots.items()):
        fleet.add_place(f"home{k}", 1.5, 1.5 + 1.6 * k)
        fleet.add_robot(name, "agv", start=f"home{k}", end=f"home{k}", **options)
    return fleet


def spans(day, robot):
    """When a robot drove or did something (s)."""
    day.robots.close()
    driven = [(d.rows[0][0], driven_until(d.rows)) for d in day.robots.drives if d.robot == robot]
    return driven + [(h.start, h.end) for h in day.robots.handled if h.robot == robot]


def test_a_robot_rests_at_home_in_its_break_and_goes_on(days, tmp_path):
    rest = {"duration": 30, "window": (10, 150)}
    day = days(hall_of(tmp_path, r0={"breaks": [rest]}))
    for k in range(3):
        day.order(f"o{k}", "rack0", "dock0")
    day.run()
    (done,) = [h for h in day.robots.handled if h.what == "break.r0.1"]
    assert done.start >= 10
    assert done.end <= 150
    assert done.end - done.start == pytest.approx(30, abs=1.0)
    assert [day.state(f"o{k}") for k in range(3)] == ["done"] * 3
    assert max(h.end for h in day.robots.handled) > done.end
    assert day.verdict().good, day.story()


def test_nobody_drives_before_its_shift_or_after_it(days, tmp_path):
    day = days(hall_of(tmp_path, early={"shift": (0, 100)}, late={"shift": (60, 900)}))
    for k in range(2):
        day.order(f"o{k}", "rack0", "dock0")
    day.until(lambda: day.clock.now() >= 85)
    day.order("o2", "rack1", "dock0")  # too long for who goes home soon
    day.run()
    assert all(day.state(f"o{k}") == "done" for k in range(3))
    assert day.operation.jobs["o2"].robot == "late"
    assert max(end for _, end in spans(day, "early")) <= 100
    assert min(start for start, _ in spans(day, "late")) >= 60
    assert day.operation.away == {"early": OFF}
    assert day.verdict().good, day.story()


def test_what_nobody_can_do_before_its_shift_ends_waits_for_the_next(days, tmp_path):
    day = days(hall_of(tmp_path, r0={"shift": (0, 60)}))
    day.until(lambda: day.clock.now() >= 30)
    day.order("o", "rack2", "dock0")
    day.until(lambda: day.operation.away == {"r0": OFF}, 90)
    day.restart()  # it is off its shift still
    assert day.operation.away == {"r0": OFF}
    day.until(lambda: day.clock.now() >= 120)
    assert day.state("o") == "waiting"
    assert not spans(day, "r0")


def test_who_is_out_of_order_does_not_come_back_with_its_shift(days, tmp_path):
    day = days(hall_of(tmp_path, r0={"shift": (20, 600)}))
    day.step()
    day.operation.leave("r0", "broken")
    day.order("o", "rack0", "dock0")
    day.until(lambda: day.clock.now() >= 40)
    assert day.operation.away == {"r0": "broken"}
    day.operation.join("r0")
    day.run()
    assert day.state("o") == "done"
    assert day.verdict().good, day.story()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_shifts_and_breaks_are_kept_whatever_comes_when(days, tmp_path, seed):
    rng = random.Random(seed)
    shifts = {f"r{k}": (rng.choice((0, 40, 90)), rng.choice((250, 320, 900))) for k in range(3)}
    shifts["r3"] = (0, 2000)  # somebody is there at last
    opens = {n: (begins + 20, min(ends, begins + 200)) for n, (begins, ends) in shifts.items()}
    rests = {n: {"duration": 20, "window": window} for n, window in opens.items()}
    robots = {n: {"shift": shifts[n], "breaks": [rests[n]]} for n in shifts}
    names = [*robots]
    rng.shuffle(names)
    day = days(hall_of(tmp_path, **{n: robots[n] for n in names}), seed=seed)
    comes = sorted(rng.uniform(0, 330) for _ in range(10))
    while comes or not day.operation.idle:
        while comes and comes[0] <= day.clock.now():
            day.order(f"o{len(comes)}")
            comes.pop(0)
        day.step()
        assert day.clock.now() < 1500, day.story()
    assert all(job.state.value == "done" for job in day.operation.jobs.values())
    for name, (begins, ends) in shifts.items():
        assert all(begins <= a and b <= ends for a, b in spans(day, name)), (name, spans(day, name))
        (done,) = [h for h in day.robots.handled if h.what == f"break.{name}.1"]
        assert done.start >= rests[name]["window"][0]
    assert day.verdict().good, day.story()
