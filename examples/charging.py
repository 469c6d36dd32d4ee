"""A robot whose battery does not last for both orders: it charges in between.

Drives take 1 % a metre; a plug gives 2 % a second, in steps of 10 s. Run
``up-samp solve examples/charging.py --out charging-out``.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="charging")

fleet.add_robot_type(
    "agv",
    footprint=(1.2, 0.8),
    model="diff",
    v_max=2.0,
    a_max=1.0,
    omega_max=2.0,
    battery={"capacity": 100, "level": 60, "per_metre": 1.0, "reserve": 5},
)
fleet.add_place("home", 2, 3)
fleet.add_place("plug", 2, 12.5, charger={"per_second": 2.0, "step": 10})
fleet.add_place("dock", 12, 12)
fleet.add_place("shelf", 7, 3)
fleet.add_place("store", 25, 4)
fleet.add_robot("r1", "agv", start="home", end="home")
fleet.add_order("near", pickup="shelf", delivery="dock")
fleet.add_order("far", pickup="store", delivery="dock")

problem = fleet.problem

if __name__ == "__main__":
    result = fleet.solve()
    print(result.explain())
