"""A plan on a floor with delays: robots are slower than planned, stop, and wait for each other.

Run ``up-samp solve examples/delays.py --out delays-out``, and then
``up-samp simulate delays-out/plan.json --delays 30% --runs 10``; or this file itself, which does
both and draws one run.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="delays")

fleet.add_robot_type("agv", footprint=(1.2, 0.8), model="diff", v_max=1.5, a_max=0.8)
for name, x, y in (("west1", 3, 4), ("west2", 3, 12), ("east1", 27, 4), ("east2", 27, 12)):
    fleet.add_place(name, x, y)
fleet.add_robot("r1", "agv", start="west1", end="east2")
fleet.add_robot("r2", "agv", start="west2", end="east1")
fleet.add_robot("r3", "agv", start="east1", end="west2")
fleet.add_robot("r4", "agv", start="east2", end="west1")

problem = fleet.problem
