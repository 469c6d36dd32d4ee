"""A door that has to be opened first: by a robot, once, and everybody drives through afterwards."""

import numpy as np

from tests.operate.days import Day
from up_samp import Fleet
from up_samp.geometry.maps import write_map


def two_rooms(folder):
    cells = np.zeros((100, 200), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    cells[:, 99:102] = True
    cells[30:60, 99:102] = False
    fleet = Fleet(write_map(folder, "rooms", cells, 0.1), name="rooms", margin=0.12)
    fleet.add_robot_type("agv", (0.8, 0.6), model="diff", v_max=1.5, a_max=0.7, omega_max=1.5)
    for k in range(2):
        fleet.add_place(f"home{k}", 1.5, 1.5 + 2.0 * k)
        fleet.add_robot(f"r{k}", "agv", start=f"home{k}", end=f"home{k}")
    fleet.add_place("button", 7.5, 7.5)
    fleet.add_place("dock0", 5.0, 8.5)
    fleet.add_place("rack0", 15.0, 3.0)
    fleet.add_place("rack1", 15.0, 7.0)
    fleet.add_door(
        "gate", leaf=(0.3, 2.8), closed=(10.05, 4.5, 0), open=(9.0, 8.2, 0), opened_from="button",
        seconds=2,
    )  # fmt: skip
    return fleet


def test_a_door_is_opened_once_and_stays_open(tmp_path):
    day = Day(tmp_path, fleet=two_rooms(tmp_path))
    try:
        day.order("o0", "rack0", "dock0")
        day.until(lambda: day.state("o0") == "begun", 300)
        day.order("o1", "rack1", "dock0")
        day.run()
        assert day.verdict().good, day.story()
        opened = [h for h in day.robots.handled if h.kind == "open"]
        assert len(opened) == 1
    finally:
        day.operation.close()
