"""Pallets that stand on the floor, ride with the robots that carry them, and stand where they are
put down: robot and load are one body meanwhile, and others keep clear of both.

Two pallets have a choice of docks and cannot both stand at one; the beam is nearly as long as the
opening between the rooms is wide (4 m). Run
``up-samp solve examples/pallets.py --out pallets-out``.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="pallets")

fleet.add_robot_type(
    "lifter", footprint=(1.2, 0.8), model="diff", v_max=1.5, a_max=0.8, omega_max=1.5
)
fleet.add_place("home1", 2.5, 3)
fleet.add_place("home2", 2.5, 13)
fleet.add_place("rack1", 25, 12)
fleet.add_place("rack2", 25, 4)
fleet.add_place("rack3", 20, 12)
fleet.add_place("dock1", 8, 11)
fleet.add_place("dock2", 11, 11)
fleet.add_place("dock3", 8, 4)
fleet.add_robot("r1", "lifter", start="home1", end="home1")
fleet.add_robot("r2", "lifter", start="home2", end="home2")

pallet = {"footprint": (1.2, 1.0)}
beam = {"footprint": (3.6, 0.6)}
fleet.add_order("o1", pickup="rack1", delivery=["dock1", "dock2"], attached=pallet)
fleet.add_order("o2", pickup="rack2", delivery=["dock1", "dock2"], attached=pallet)
fleet.add_order("beam", pickup="rack3", delivery="dock3", attached=beam)

problem = fleet.problem
