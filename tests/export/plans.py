"""Small plans, written by hand."""

import math


def straight(start, end, x0, x1, y=2.0, theta=0.0, steps=20):
    """Return samples of a drive along x, slow at both ends."""
    rows = []
    for k in range(steps + 1):
        share = 0.5 - 0.5 * math.cos(math.pi * k / steps)
        rows.append([start + (end - start) * k / steps, x0 + share * (x1 - x0), y, theta])
    return rows


def door_plan():
    """Return a robot that drives to a button, opens a door, backs off and waits; another stands."""
    box = [[-0.5, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.5, 0.3]]

    def movable(name, kind, x):
        return {
            "name": name, "type": kind, "footprint": box, "model": "REEDSSHEPP",
            "turning_radius": 1, "v_max": 2, "a_max": 1, "initial": [x, 2.0, 0.0],
        }  # fmt: skip

    return {
        "format": "up-samp-plan", "version": 1, "problem": "door", "engine": "by hand",
        "status": "SOLVED_SATISFICING", "makespan": 12, "lower_bound": None,
        "seconds_per_unit": 2, "map": {"yaml": None},
        "objects": [movable("r0", "robot", 1.0), movable("r1", "robot", 20.0),
                    movable("door", "door", 10.0)],
        "activities": [
            {"name": "go_r0", "start": 0, "end": 4}, {"name": "open_door_r0", "start": 4, "end": 5},
            {"name": "back_r0", "start": 6, "end": 9}, {"name": "go_r1", "start": 6, "end": 12},
        ],
        "motions": [
            {"activity": "go_r0", "object": "r0", "samples": straight(0.5, 7.5, 1.0, 8.0)},
            {"activity": "back_r0", "object": "r0", "samples": straight(12.0, 17.0, 8.0, 5.0)},
            {"activity": "go_r1", "object": "r1",
             "samples": straight(12.0, 23.5, 20.0, 11.0, theta=math.pi)},
        ],
        "changes": [
            {"activity": "open_door_r0", "object": "door", "time": 10,
             "configuration": [10.0, 9.0, 0.0]}
        ],
    }  # fmt: skip
