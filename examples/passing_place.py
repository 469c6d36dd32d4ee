"""Two robots change sides through a corridor in which only a bay lets one pass the other.

Nobody says who waits, or where: the motions do. Run
``up-samp solve examples/passing_place.py --out passing-out``.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "passing.yaml", name="passing")

fleet.add_robot_type("cart", footprint=(1.4, 1.0), model="omni", v_max=1.5, a_max=0.5)
fleet.add_place("west", 5, 2)
fleet.add_place("east", 35, 2)
fleet.add_robot("r1", "cart", start="west", end="east")
fleet.add_robot("r2", "cart", start="east", end="west")

problem = fleet.problem
