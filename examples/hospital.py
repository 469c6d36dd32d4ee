"""A hospital with two floors: carts bring medicine and meals up by the lift, and rest in a break.

The pharmacy and the kitchen are on the ground, the wards above them. Both floors have two rooms
with an opening between; the lift is in the right one and takes one cart at a time. Run
``up-samp solve examples/hospital.py --timeout 60 --out hospital-out``.
"""

from pathlib import Path

from up_samp import Fleet

MAP = Path(__file__).parent / "maps" / "two_rooms.yaml"

fleet = Fleet(MAP, name="hospital")
fleet.add_floor("wards", MAP, height=4.2)
fleet.add_lift("lift", {"ground": (25, 8, 0), "wards": (25, 8, 0)}, seconds=30)

fleet.add_robot_type("cart", footprint=(0.9, 0.6), model="diff", v_max=1.2, a_max=0.6)
fleet.add_place("base1", 2.5, 3)
fleet.add_place("base2", 2.5, 13)
fleet.add_place("pharmacy", 9, 3)
fleet.add_place("kitchen", 9, 13)
fleet.add_place("ward_a", 19, 12, floor="wards")
fleet.add_place("ward_b", 9, 12, floor="wards")
fleet.add_robot("c1", "cart", start="base1", end="base1")
fleet.add_robot(
    "c2",
    "cart",
    start="base2",
    end="base2",
    breaks=[{"duration": 60, "window": (0, 400)}],  # its battery is looked at
)

fleet.add_order("drugs", pickup="pharmacy", delivery="ward_b", priority=1)
fleet.add_order("lunch", pickup={"at": "kitchen", "service": 20}, delivery="ward_a")
fleet.add_order("dishes", pickup="ward_a", delivery="kitchen", after="lunch")

problem = fleet.problem
