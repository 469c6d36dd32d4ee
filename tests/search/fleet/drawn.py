"""Fleets with a draw of what may be asked of them."""

import random

from tests.search.fleet.test_carrying import MAP
from up_samp.fleet import Fleet

FEATURES = (
    *("slots", "capacity", "battery", "crew", "after", "due", "optional", "together"),
    *("breaks", "ends", "priority", "alternatives"),
)
"""What a fleet may be asked for: see :func:`drawn_fleet`."""
MODELS = ({"model": "omni"}, {"model": "diff"}, {"model": "car", "turning_radius": 0.6})


def drawn_fleet(seed, features=None, chance=0.25):
    """Return a fleet that brings some ten orders from three shelves to a few docks.

    :param features: of :data:`FEATURES`; drawn, each with a ``chance``, where none are given.
    """
    rng = random.Random(f"fleet {seed}")
    some = {f for f in FEATURES if rng.random() < chance} if features is None else {*features}
    weights = {"makespan": 1, "tardiness": 2} if "due" in some else "makespan"
    fleet = Fleet(MAP, objective=weights)
    robots, docks = rng.randint(3, 7), rng.randint(1, 3)
    kind = dict(rng.choice(MODELS))
    if "capacity" in some:
        kind["capacity"] = {"item": 2}
    if "battery" in some:
        kind["battery"] = {"capacity": 100, "per_metre": 1.0}
    fleet.add_robot_type("agv", (0.5, 0.4), v_max=1.5, a_max=0.5, **kind)
    _add_places(fleet, robots, docks, rng, some)
    for k in rng.sample(range(robots), robots):
        end = {"end": f"h{k}"} if "ends" in some else {}
        rests = [{"duration": 10, "window": (20, 120)}] * ("breaks" in some and k % 2)
        fleet.add_robot(f"r{k}", "agv", f"h{k}", breaks=rests, **end)
    _add_orders(fleet, docks, rng, some)
    for k in range(2 * ("crew" in some)):
        fleet.add_task(f"t{k}", at=["a", "b"], duration=5, crew=2)
    return fleet


def _add_places(fleet, robots, docks, rng, some):
    places = {"a": (3, 3), "b": (3, 6), "c": (5, 6)}
    places |= {f"dock{k}": (8, 3 + 2 * k) if k < 2 else (6, 3) for k in range(docks)}
    places |= {f"h{k}": (1.0 + 0.9 * k, 1.0) for k in range(robots)}
    chargers = {f"charger{k}": (7.3 + k, 1.0) for k in range(2 * ("battery" in some))}
    places |= chargers
    for name in rng.sample([*places], len(places)):
        charger = {"charger": {"times": 2, "per_second": 4, "step": 10}} if name in chargers else {}
        fleet.add_place(name, *places[name], **charger)


def _add_orders(fleet, docks, rng, some):
    gap, width = rng.choice((8, 12, 20)), rng.choice((20, 30, 60))
    how = rng.choice(("delivery", "pickup", "both", "release"))
    before = None
    for k in range(rng.randint(8, 16)):
        pickup, delivery = {"at": rng.choice("abc")}, {"at": f"dock{rng.randrange(docks)}"}
        asked = {}
        opens = 30 + gap * k
        if "slots" in some and rng.random() < 0.7:
            if how in ("delivery", "both"):
                delivery["window"] = opens, opens + width
            if how == "pickup" or (how == "both" and rng.random() < 0.3):
                pickup["window"] = opens - 15, opens + width - 10
            asked |= {"release": float(opens)} if how == "release" else {}
        if "alternatives" in some:
            delivery["at"] = sorted({delivery["at"], f"dock{rng.randrange(docks)}"})
        if "due" in some and rng.random() < 0.5:
            asked["due"] = float(rng.randint(30, 150))
        if "after" in some and k and rng.random() < 0.3:
            asked["after"] = f"o{rng.randrange(k)}"
        if "optional" in some and rng.random() < 0.3:
            asked |= {"optional": True, "penalty": 50}
        if "priority" in some and "slots" not in some and rng.random() < 0.2:
            asked["priority"] = 1
        if "together" in some and k % 5 == 4 and docks > 1:
            # two robots need two places at each end
            pickup = {"at": next(p for p in "abc" if p != before[0]["at"])}
            if isinstance(before[1]["at"], str) and "release" not in asked:
                free = {f"dock{n}" for n in range(docks)} - {before[1]["at"]}
                delivery, asked = {"at": min(free)}, {"together": f"o{k - 1}"}
        before = pickup, delivery
        fleet.add_order(f"o{k}", pickup=pickup, delivery=delivery, **asked)
