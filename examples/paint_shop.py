"""A paint shop: a booth that is set up for colours, an oven that bakes in batches, racks of limited
room, and a gateway in which nobody stops.

The robots turn on the spot nowhere. Run
``up-samp solve examples/paint_shop.py --timeout 60 --out paint-out``.
"""

from pathlib import Path

from up_samp import Fleet

fleet = Fleet(Path(__file__).parent / "maps" / "two_rooms.yaml", name="paint_shop")
fleet.add_robot_type(
    "cart", footprint=(1.0, 0.7), model="diff", v_max=1.5, omega_max=1.5, pivoting="never"
)
fleet.add_zone("gateway", [(13.5, 2), (16.5, 2), (16.5, 6), (13.5, 6)], stopping="never")
for name, x, y in (("home1", 3, 3), ("home2", 3, 13), ("store", 25, 4), ("shipping", 25, 12)):
    fleet.add_place(name, x, y)
fleet.add_place("booth_in", 6, 5, room=1)
fleet.add_place("oven_in", 6, 11, room=2)
fleet.add_place("oven_out", 10, 11)
fleet.add_robot("r1", "cart", start="home1")
fleet.add_robot("r2", "cart", start="home2")

fleet.add_resource("booth", setup={"red": {"blue": 12}, "blue": {"red": 20}}, kind="red")
fleet.add_resource("oven", capacity=2, batches=True)
for part, colour in (("door", "blue"), ("hood", "red"), ("wing", "blue")):
    booth = {"duration": 8, "input": "booth_in", "resources": "booth"}
    oven = {"duration": 15, "input": "oven_in", "output": "oven_out", "resources": "oven"}
    fleet.add_task(f"paint_{part}", modes={"booth": booth}, kind=colour)
    fleet.add_task(f"bake_{part}", modes={"oven": oven})
    fleet.add_order(f"raw_{part}", pickup="store", delivery={"task": f"paint_{part}"})
    fleet.add_order(
        f"wet_{part}", pickup={"task": f"paint_{part}"}, delivery={"task": f"bake_{part}"}
    )
fleet.add_order("ship", pickup={"task": "bake_wing"}, delivery="shipping")

problem = fleet.problem
