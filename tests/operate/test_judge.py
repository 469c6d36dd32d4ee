"""What the judge of days sees that no plan has: held against counting at each instant."""

import itertools
import random

import pytest

from tests.operate.sites import hall
from up_samp.execution.floor import Handled
from up_samp.operate.judge import judge_day
from up_samp.operate.records import DayOrder, OrderState, job_record

ROOM = {"item": 2, "box": 1}


def a_day(folder, rng):
    """A site, and orders and tasks that two robots did whenever they liked."""
    fleet = hall(folder, 2, capacity=ROOM)
    for name, most in (("gate", 1), ("lifts", 2)):
        fleet.add_resource(name, most)
    jobs, handled = {}, []
    for k in range(5):
        uses = [rng.sample(["gate", "lifts"], rng.randint(0, 1)) for _ in range(3)]
        stops = [
            {"at": at, "resources": u} for at, u in zip(("rack0", "dock0"), uses[:2], strict=True)
        ]
        load = rng.choice([{"item": 1}, {"item": 2}, {"box": 1}, {"item": 1, "box": 1}])
        order = {"id": f"o{k}", "pickup": stops[0], "delivery": stops[1], "load": load}
        task = {"id": f"t{k}", "at": ["rack1"], "duration": 5, "resources": uses[2]}
        for data in (order, task):
            jobs[data["id"]] = DayOrder(job_record(data), 0.0, OrderState.DONE)
        who, other = rng.sample(["r0", "r1"], 2)
        a, b, c, d = (float(t) for t in sorted(rng.sample(range(150), 4)))
        handled += [Handled("pick", f"o{k}", who, a, b), Handled("deliver", f"o{k}", who, c, d)]
        handled.append(Handled("task", f"t{k}", other, a, b + 3))
    rng.shuffle(handled)
    return fleet.records, jobs, handled


def counted(site, jobs, handled):
    """Return of what there was too much at some instant."""
    found = set()
    ends = sorted({t for h in handled for t in (h.start, h.end)})
    for now in ((a + b) / 2 for a, b in itertools.pairwise(ends)):
        used = []
        for h in handled:
            record = jobs[h.what].record
            stop = {"pick": "pickup", "deliver": "delivery"}.get(h.kind)
            if h.start < now < h.end:
                used += getattr(record, stop).resources if stop else record.resources
            if h.kind == "pick":
                (brought,) = [o for o in handled if o.what == h.what and o is not h]
                if h.end < now < brought.start:
                    used += [(h.robot, n) for n, by in record.load.items() for _ in range(by)]
        room = {(r, load): most for r in site.robots for load, most in ROOM.items()}
        room |= {name: resource.capacity for name, resource in site.resources.items()}
        found |= {what for what, most in room.items() if used.count(what) > most}
    return found


@pytest.mark.parametrize("seed", range(20))
def test_too_much_at_a_time_is_seen(tmp_path, seed):
    site, jobs, handled = a_day(tmp_path, random.Random(seed))
    initial = {n: site.places[r.start].pose for n, r in site.robots.items()}
    seen = set()
    for text in judge_day(site, jobs, initial, [], handled).overfull:
        name, what = text.split("'")[1], text.split("(")[1].split(")")[0]
        seen.add(name if what == "resource" else (name, what))
    assert seen == counted(site, jobs, handled)


def test_one_after_the_other_is_not_too_much(tmp_path):
    site, jobs, _ = a_day(tmp_path, random.Random(0))
    orders = [{"id": f"o{k}", "pickup": "rack0", "delivery": "dock0"} for k in range(3)]
    jobs = {o["id"]: DayOrder(job_record({**o, "load": {"box": 1}}), 0.0) for o in orders}
    handled = [
        handled
        for k in range(3)
        for handled in (
            Handled("pick", f"o{k}", "r0", 10.0 * k, 10.0 * k + 5),
            Handled("deliver", f"o{k}", "r0", 10.0 * k + 5, 10.0 * k + 10),
        )
    ]
    handled.append(Handled("pick", "o2", "r1", 28.0, 29.0))  # taken from it by hand
    initial = {n: site.places[r.start].pose for n, r in site.robots.items()}
    assert not judge_day(site, jobs, initial, [], handled).overfull
