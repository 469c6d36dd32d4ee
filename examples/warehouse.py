"""Three orders, two robots, and a door that one of them has to open: the front door's ``Fleet``.

Run ``up-samp solve examples/warehouse.py --out warehouse-out``, or this file itself.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="warehouse")

fleet.add_robot_type("agv", footprint=(1.2, 0.8), turning_radius=0.8, v_max=2.0, a_max=0.5)
fleet.add_place("home1", 3, 4)
fleet.add_place("home2", 3, 12)
fleet.add_place("button", 11, 9)
fleet.add_place("shelfA", 25, 11)
fleet.add_place("shelfB", 25, 5)
fleet.add_place("dock1", 8, 3)
fleet.add_place("dock2", 8, 12)
fleet.add_robot("r1", "agv", start="home1", end="home1")
fleet.add_robot("r2", "agv", start="home2", end="home2")
fleet.add_door(
    "gate", leaf=(1, 3.8), closed=(15, 4, 0), open=(15, 8, 0), opened_from="button", seconds=2
)

fleet.add_order("o1", pickup="shelfA", delivery="dock1")
fleet.add_order("o2", pickup=["shelfA", "shelfB"], delivery={"at": "dock2", "service": 3})
fleet.add_order("o3", pickup="shelfB", delivery={"at": ["dock1", "dock2"], "window": (0, 300)})

problem = fleet.problem  # the ordinary UP problem

if __name__ == "__main__":
    result = fleet.solve(timeout=60)
    print(result.explain())
    result.show()
