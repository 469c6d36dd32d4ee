"""A job shop whose parts are carried from machine to machine by two robots.

Each machine works by itself, on one part at a time. Run
``up-samp solve examples/shop.py --out shop-out``. ``up-samp import`` makes such problems of
JSPLIB's files.
"""

from itertools import pairwise
from pathlib import Path

from up_samp import Fleet

JOBS = {"gear": [("mill", 20), ("drill", 10)], "plate": [("drill", 15), ("mill", 10)]}

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="shop")

fleet.add_robot_type("agv", footprint=(1.2, 0.8), turning_radius=0.8, v_max=2.0, a_max=1.0)
fleet.add_place("store", 3, 3)
fleet.add_place("exit", 3, 13)
fleet.add_place("at_mill", 25, 12)
fleet.add_place("at_drill", 25, 4)
fleet.add_place("home1", 10, 11)
fleet.add_place("home2", 10, 5)
fleet.add_resource("mill")
fleet.add_resource("drill")
fleet.add_robot("r1", "agv", start="home1")
fleet.add_robot("r2", "agv", start="home2")

for part, route in JOBS.items():
    stops = ["store", *(f"at_{machine}" for machine, _ in route), "exit"]
    earlier: list[str] = []
    for step, (here, there) in enumerate(pairwise(stops)):
        carry = f"{part}_to_{there.removeprefix('at_')}"
        fleet.add_order(carry, pickup=here, delivery=there, after=earlier)
        if step < len(route):
            machine, seconds = route[step]
            work = f"{machine}_{part}"
            fleet.add_task(work, duration=seconds, resources=machine, after=carry)
            earlier = [work]

problem = fleet.problem
