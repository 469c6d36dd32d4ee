"""Orders on a real ROS map: set ``ROS_MAP`` to the ``map_server`` YAML of your own.

Places are looked for on the map: free floor, as far from walls as there is, and apart from each
other. Run ``ROS_MAP=map.yaml up-samp solve examples/ros_map.py --out ros-out``, or, without
``ROS_MAP``, ``up-samp solve examples/ros_map.py`` on the map of the other examples.
"""

import os
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from up_samp import Fleet
from up_samp.geometry import load_map

HERE = Path(__file__).parent
MAP = Path(os.environ.get("ROS_MAP", HERE / "maps" / "two_rooms.yaml"))

ROOM = 0.4
"""Distance of a place from everything that is not free floor, m."""


def roomy_places(count: int) -> list[tuple[float, float]]:
    """Return points of the largest free part of the map, the roomiest first, m.

    They lie as far apart as ``count`` of them can, with room for the robot around each.
    """
    grid = load_map(MAP)
    parts, _ = label(~grid.blocked)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    clearance = distance_transform_edt(parts == sizes.argmax()) * grid.resolution
    order = np.argsort(-clearance, axis=None, kind="stable")
    cells = [np.unravel_index(i, clearance.shape) for i in order if clearance.flat[i] > ROOM]
    points = [grid.point_of(row, col) for row, col in cells]
    for apart in (2.0, 1.5, 1.0, 0.8):
        found: list[tuple[float, float]] = []
        for point in points:
            if all(np.hypot(point[0] - x, point[1] - y) > apart for x, y in found):
                found.append(point)
                if len(found) == count:
                    return found
    raise SystemExit(f"'{MAP}' has no room for {count} places")


fleet = Fleet(MAP, name="ros_map")
fleet.add_robot_type("tb", footprint=(0.35, 0.35), model="omni", v_max=0.8, a_max=0.5)
for i, (x, y) in enumerate(roomy_places(6)):
    fleet.add_place(f"p{i}", x, y)
fleet.add_robot("r1", "tb", start="p0")
fleet.add_robot("r2", "tb", start="p1")
fleet.add_order("o1", pickup="p2", delivery="p3")
fleet.add_order("o2", pickup="p4", delivery="p5")

problem = fleet.problem
