"""A car, a cart that drives in any direction, and a fork truck with the shape of an L.

Each has skills and capacities of its own. Run
``up-samp solve examples/mixed_fleet.py --out mixed-out``.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="mixed")

fleet.add_robot_type("car", footprint=(2.0, 1.0), turning_radius=1.5, v_max=2.5, a_max=0.8)
fleet.add_robot_type(
    "cart", footprint=(0.9, 0.9), model="omni", v_max=1.5, a_max=0.8, capacity={"item": 2}
)
fleet.add_robot_type(
    "fork",
    footprint=[(-0.8, -0.6), (1.2, -0.6), (1.2, -0.2), (0.2, -0.2), (0.2, 0.8), (-0.8, 0.8)],
    model="omni",
    v_max=1.0,
    a_max=0.5,
    capacity={"pallet": 1},
)
fleet.add_place("home_car", 3, 12)
fleet.add_place("home_cart", 3, 8)
fleet.add_place("home_fork", 3, 4)
fleet.add_place("dock", 10, 12)
fleet.add_place("ramp", 10, 3)
fleet.add_place("rack", 26, 12)
fleet.add_place("pallets", 26, 3)
fleet.add_robot("r_car", "car", start="home_car", skills="drive_fast")
fleet.add_robot("r_cart", "cart", start="home_cart")
fleet.add_robot("r_fork", "fork", start="home_fork")

fleet.add_order("parts1", pickup="rack", delivery="dock")
fleet.add_order("parts2", pickup="rack", delivery="dock")
fleet.add_order("pallet", pickup="pallets", delivery="ramp", load={"pallet": 1})
fleet.add_task("count", at="rack", duration=10, skills="drive_fast")

problem = fleet.problem
