"""A warehouse with its orders, as the problem file of its fleet would say it."""

from up_samp import Fleet
from up_samp.benchmarks.builders.warehouse import A_MAX, OMEGA_MAX, V_MAX, draw_orders, store
from up_samp.benchmarks.places import drawn_map


def fleet_of(robots, orders):
    """Return a fleet of cars and robots that move in any direction, without latest ends."""
    plan = store(robots)
    fleet = Fleet(str(drawn_map(f"warehouse-{robots}", plan.size, plan.walls)))
    limits = {"v_max": V_MAX, "a_max": A_MAX}
    fleet.add_robot_type("car", (1.2, 0.8), model="car", turning_radius=1.0, **limits)
    fleet.add_robot_type("omni", (1.2, 0.8), model="omni", omega_max=OMEGA_MAX, **limits)
    drawn = draw_orders(plan, orders, 0)
    places = {f"dock{i}": pose for i, pose in enumerate(plan.docks)}
    places |= {f"station{i}": pose for i, pose in enumerate(plan.stations)}
    places |= {f"slot{o.slot}": plan.slots[o.slot] for o in drawn}
    for name, pose in places.items():
        fleet.add_place(name, *pose)
    for r in range(robots):
        fleet.add_robot(f"r{r}", ("car", "omni")[r % 2], start=f"dock{r}", end=f"dock{r}")
    for k, o in enumerate(drawn):
        pickup = {"at": f"slot{o.slot}", "service": o.service[0]}
        fleet.add_order(f"o{k}", pickup, {"at": f"station{o.station}", "service": o.service[1]})
    return fleet
