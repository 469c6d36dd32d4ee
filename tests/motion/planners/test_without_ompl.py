"""Where OMPL is not installed, everything but its planners works, and what needs it says so."""

import json
import subprocess

from up_samp.system import child

CODE = """
import json, math, sys
sys.modules["ompl"] = None  # as if it were not installed
import numpy as np
from up_samp.geometry import OccupancyGrid
from up_samp.model import Body, Deadline, Kinematics, MotionModel, PathQuery, UnsupportedError
from up_samp.motion import MotionService
import up_samp.search.loop

cells = np.zeros((60, 60), dtype=bool)
service = MotionService(OccupancyGrid(cells, 0.2))
box = ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))
told = {}
for model in (MotionModel.REEDSSHEPP, MotionModel.SE2, MotionModel.CONTROL, "RRTConnect"):
    planner = service
    if model == "RRTConnect":
        planner, model = MotionService(service.grid, planner=model), MotionModel.REEDSSHEPP
    query = PathQuery(Body(box, Kinematics(model)), ((3.0, 3.0, 0.0), (9.0, 9.0, 1.0)))
    key = f"{planner.planner} {model.name}"
    try:
        told[key] = planner.plan(query, Deadline.after(20)).outcome.name
    except UnsupportedError as error:
        told[key] = str(error)
print(json.dumps(told))
"""


def test_without_ompl():
    done = subprocess.run(
        child.command(CODE), env=child.environment(), capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["default REEDSSHEPP"] == "FOUND"
    assert told["default SE2"] == "FOUND"
    for key in ("default CONTROL", "RRTConnect REEDSSHEPP"):
        assert told[key].startswith("OMPL is not installed"), told
    assert "no second opinions" in done.stderr
