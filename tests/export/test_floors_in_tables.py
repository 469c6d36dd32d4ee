"""Plans on several floors as tables: each pose says which map it is on."""

import csv

import numpy as np
import pytest

from up_samp.export import export_plan
from up_samp.fleet import Fleet
from up_samp.geometry import write_map
from up_samp.model import UnsupportedError


def test_tables_say_on_which_floor_a_pose_is(tmp_path):
    low, high = (
        str(write_map(tmp_path, name, np.zeros((80, 120), dtype=bool), 0.1))
        for name in ("low", "high")
    )
    fleet = Fleet(low)
    fleet.add_floor("first", high, height=4.0)
    fleet.add_lift("lift", {"ground": (9, 4, 0), "first": (9, 4, 0)}, seconds=5)
    fleet.add_robot_type("cart", (0.8, 0.6), model="omni")
    fleet.add_place("home", 3, 4)
    fleet.add_place("ward", 4, 5, floor="first")
    fleet.add_robot("r", "cart", "home")
    fleet.add_task("look", at="ward", duration=2)
    result = fleet.solve(timeout=60, first_plan=True)
    assert result.plan is not None, result.explain()
    export_plan(result.data, "csv", tmp_path / "out")
    with (tmp_path / "out" / "trajectories.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    floors = {row["activity"]: row["map"] for row in rows}
    assert "low" in next(m for a, m in floors.items() if a.startswith("move_r_home"))
    assert "high" in next(m for a, m in floors.items() if a.endswith("_to_ward"))
    with (tmp_path / "out" / "changes.csv").open(encoding="utf-8") as file:
        (ride,) = csv.DictReader(file)
    assert "high" in ride["map"]
    assert len({row["map"] for row in rows}) == 2
    with pytest.raises(UnsupportedError, match="holds one map"):
        export_plan(result.data, "nav2", tmp_path / "legs")
