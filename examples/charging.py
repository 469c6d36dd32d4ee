"""A robot whose battery does not last for both orders: it charges in between.

Drives take 1 % a metre; a plug gives 2 % a second, in steps of 10 s. The robot comes straight to
the plug and to the dock. Run
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
# in reverse and slowly onto the plug, straight up to the dock
plug = {"metres": 1.0, "v_max": 0.3, "backwards": True}
fleet.add_place("plug", 2, 12.5, charger={"per_second": 2.0, "step": 10}, docking=plug)
fleet.add_place("dock", 12, 12, docking={"metres": 1.5, "v_max": 0.5})
fleet.add_place("shelf", 7, 3)
fleet.add_place("store", 25, 4)
fleet.add_robot("r1", "agv", start="home", end="home")
fleet.add_order("near", pickup="shelf", delivery="dock")
fleet.add_order("far", pickup="store", delivery="dock")

problem = fleet.problem

if __name__ == "__main__":
    result = fleet.solve()
    print(result.explain())
