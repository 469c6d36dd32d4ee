"""A request that a client would send."""

import base64

import yaml

from up_samp.fleet.files import write_starter


def starter_request(folder):
    """The starter problem with one order."""
    problem_file, map_file, image = write_starter(folder)
    problem = yaml.safe_load(problem_file.read_text())
    del problem["map"]
    problem["orders"] = problem["orders"][:1]
    said = yaml.safe_load(map_file.read_text())
    upload = {
        "image": base64.b64encode(image.read_bytes()).decode(),
        "resolution": said["resolution"],
        "origin": said["origin"],
    }
    return {"problem": problem, "map": upload, "timeout": 60, "first_plan": True}
