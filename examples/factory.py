"""A factory: pallets come from the store through a door that opens as robots come, a mould is
turned by two robots together, and nothing counts before everything is in time.

The door takes 3 s to open, and is shut for a delivery from 240 s to 300 s. Run
``up-samp solve examples/factory.py --timeout 60 --out factory-out``.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(
    Path(__file__).parent / "maps" / "two_rooms.yaml",
    name="factory",
    objective=["tardiness", "makespan", "driving"],
)
fleet.add_automatic_door(
    "rollup", [(14.2, 2), (15.8, 2), (15.8, 6), (14.2, 6)], opens_in=3, shut=(240, 300)
)
fleet.add_robot_type(
    "lifter", footprint=(1.2, 0.8), model="diff", v_max=1.5, a_max=0.8, omega_max=1.5
)
for name, x, y in (
    ("home1", 2.5, 3), ("home2", 2.5, 13), ("rack1", 25, 12), ("rack2", 25, 4),
    ("press1", 10, 12.5), ("press2", 10, 3.5), ("mould_left", 5.5, 8), ("mould_right", 8.5, 8),
):  # fmt: skip
    fleet.add_place(name, x, y)
fleet.add_robot("r1", "lifter", start="home1", end="home1")
fleet.add_robot("r2", "lifter", start="home2", end="home2")

pallet = {"footprint": (1.2, 1.0)}
fleet.add_order("steel", pickup="rack1", delivery="press1", attached=pallet, due=70)
fleet.add_order("brass", pickup="rack2", delivery="press2", attached=pallet, due=70, weight=2)
fleet.add_task("turn", at=["mould_left", "mould_right"], crew=2, duration=15, due=120)

problem = fleet.problem
