"""A job shop whose parts are carried from machine to machine by two robots.

Each machine works by itself, on one part at a time; parts are brought to one side of it and fetched
from the other, so that robots do not stand in each other's way. Run
``up-samp solve examples/shop.py --out shop-out``. ``up-samp import`` makes such problems of
JSPLIB's files.
"""

from itertools import pairwise
from pathlib import Path

from up_samp import Fleet

JOBS = {"gear": [("mill", 20), ("drill", 10)], "plate": [("drill", 15), ("mill", 10)]}
PLACES = {
    "store_gear": (3, 3), "store_plate": (3, 6), "exit_gear": (3, 13), "exit_plate": (3, 10),
    "mill_in": (25, 13), "mill_out": (25, 10), "drill_in": (25, 3), "drill_out": (25, 6),
    "home1": (10, 11), "home2": (10, 5),
}  # fmt: skip

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="shop")

fleet.add_robot_type("agv", footprint=(1.2, 0.8), turning_radius=0.8, v_max=2.0, a_max=1.0)
for name, (x, y) in PLACES.items():
    fleet.add_place(name, x, y)
fleet.add_resource("mill")
fleet.add_resource("drill")
fleet.add_robot("r1", "agv", start="home1")
fleet.add_robot("r2", "agv", start="home2")

for part, route in JOBS.items():
    ways = [f"store_{part}", *(machine for machine, _ in route), f"exit_{part}"]
    earlier: list[str] = []
    for step, (here, there) in enumerate(pairwise(ways)):
        carry = f"{part}_to_{there}"
        fetched = f"{here}_out" if step > 0 else here
        brought = f"{there}_in" if step < len(route) else there
        fleet.add_order(carry, pickup=fetched, delivery=brought, after=earlier)
        if step < len(route):
            machine, seconds = route[step]
            work = f"{machine}_{part}"
            fleet.add_task(work, duration=seconds, resources=machine, after=carry)
            earlier = [work]

problem = fleet.problem
