"""Rules of driving: slow among people, slow backwards, lanes, no turning near shelves, an aisle.

A truck and a cart bring parts from one hall into the other. Run
``up-samp solve examples/traffic_rules.py --out rules-out``.
"""

import math
from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="rules")

fleet.add_robot_type(
    "truck",
    footprint=(1.6, 0.9),
    turning_radius=1.2,
    v_max=2.0,
    a_max=0.8,
    reverse="slow",
    reverse_v_max=0.4,
)
fleet.add_robot_type("cart", footprint=(0.9, 0.7), model="diff", v_max=1.5, a_max=0.8)
fleet.add_place("home_truck", 3, 12)
fleet.add_place("home_cart", 3, 4)
fleet.add_place("dock", 10, 12)
fleet.add_place("rack", 26, 12)
fleet.add_place("shelf", 26, 3)
fleet.add_robot("truck1", "truck", start="home_truck", end="home_truck")
fleet.add_robot("cart1", "cart", start="home_cart", end="home_cart")

# people walk in front of the dock; the truck is heavy and slow on the ramp between the halls
fleet.add_zone("people", [(8, 9), (12, 9), (12, 11), (8, 11)], v_max=0.3)
fleet.add_zone("ramp", [(14, 0), (16, 0), (16, 16), (14, 16)], v_max=0.6, robot_types="truck")
# through the gap between the halls: east in the lower lane, west in the upper one
fleet.add_zone("eastbound", [(14, 2), (16, 2), (16, 4), (14, 4)], one_way=0.0)
fleet.add_zone("westbound", [(14, 4), (16, 4), (16, 6), (14, 6)], one_way=math.pi)
# nobody is kept out of the picking area, but who goes round it is welcome
fleet.add_zone("pickers", [(18, 6.5), (22, 6.5), (22, 10), (18, 10)], avoid=10)
# the way round the picking area that everybody knows
fleet.add_lane("aisle", [(17, 4), (24, 4), (24, 12)], width=1.6, prefer=2)
fleet.add_zone("racks", [(25, 1), (29, 1), (29, 5), (25, 5)], pivoting="never")

fleet.add_order("parts1", pickup="rack", delivery="dock")
fleet.add_order("parts2", pickup="shelf", delivery="dock")

problem = fleet.problem
