"""A shift in Nav2's warehouse, 30 x 50 m: four robots bring goods from shelves to three conveyors.

They look ahead only, one has charged too little, one has a break; two at a time drive in the middle
aisle, and what leaves with the first truck has priority. The map is ``maps/warehouse.yaml`` of the
ROS 2 package ``nav2_bringup``: ``NAV2_MAPS`` is the folder where it lies. Run
``up-samp solve examples/nav2_warehouse.py --timeout 60 --out nav2-out``.
"""

import os
from math import pi
from pathlib import Path

from up_samp import Fleet

WEST, NORTH = pi, pi / 2
PLACES = {
    "home1": (-13.5, 3), "home2": (-13.5, 1), "home3": (-13.5, -1), "home4": (-13.5, -3),
    "a_low": (-7, -11, WEST), "a_high": (-4, -8), "b_low": (0, -17, WEST), "b_high": (4.1, -7),
    "c_west": (0, 7.1, NORTH), "c_east": (4, 7.1, NORTH), "d": (-3, 16.1, NORTH),
    "truck1": (10.2, -14.9), "truck2": (10.2, -20.9), "packing": (6.8, 4.6),
}  # fmt: skip
"""Where robots stand: shelves a, b, c, d and the ends of three conveyors; m and rad."""
ORDERS = [
    ("tea", "a_low", "truck1"), ("rice", "b_high", "truck2"), ("oil", "c_west", "packing"),
    ("salt", "d", "packing"), ("flour", "b_low", "truck2"), ("soap", "c_east", "truck1"),
    ("paper", "a_high", "truck2"), ("ink", "c_west", "packing"),
]  # fmt: skip

MAPS = Path(os.environ.get("NAV2_MAPS", "/opt/ros/jazzy/share/nav2_bringup/maps"))

fleet = Fleet(MAPS / "warehouse.yaml", name="nav2_warehouse")

battery = {"capacity": 200, "per_metre": 1.0, "reserve": 10}
fleet.add_robot_type(
    "amr", footprint=(0.9, 0.7), model="diff", v_max=1.5, a_max=0.8, omega_max=1.5,
    reverse="never", battery=battery,
)  # fmt: skip
for name, pose in PLACES.items():
    fleet.add_place(name, *pose)
fleet.add_place("plug", -10, 2, charger={"per_second": 4.0, "step": 20})
for i in (1, 2, 3, 4):
    fleet.add_robot(
        f"r{i}",
        "amr",
        start=f"home{i}",
        end=f"home{i}",
        shift=(0, 600),
        level=60 if i == 3 else None,
        breaks=[{"duration": 30, "window": (0, 200)}] if i == 4 else [],
    )
fleet.add_zone("aisle", [(-0.9, -21), (5, -21), (5, -5), (-0.9, -5)], max_robots=2)
for name, shelf, conveyor in ORDERS:
    service = {"at": conveyor, "service": 5}
    fleet.add_order(name, shelf, service, priority=1 if conveyor == "truck1" else 0)

problem = fleet.problem
