"""A mast that is too long for one robot: two carry it in formation, as one body, from one room to
the other, while a third one brings a crate.

Whoever carries the mast moves in any direction: who drives at the far end of what turns drives
sideways. Which two of the three carry it, and which of them is at which end, is decided with all
else. Run ``up-samp solve examples/formation.py --out formation-out``.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="formation")

fleet.add_robot_type("omni", footprint=(0.9, 0.7), model="omni", v_max=1.2, a_max=0.6)
for number, y in enumerate((3, 6, 13), 1):
    fleet.add_place(f"home{number}", 2.5, y)
    fleet.add_robot(f"r{number}", "omni", start=f"home{number}", end=f"home{number}")
fleet.add_place("bench", 5, 10)
fleet.add_place("yard", 24, 3.5, 1.57)
fleet.add_place("shelf", 25, 13)
fleet.add_place("dock", 8, 3)

mast = {"footprint": (4.6, 0.4), "offset": (1.8, 0, 0), "carriers": [(3.6, 0, 3.14159)]}
fleet.add_order("mast", {"at": "bench", "service": 8}, {"at": "yard", "service": 8}, attached=mast)
fleet.add_order("crate", pickup="shelf", delivery="dock")

problem = fleet.problem
