"""Rules of driving in pictures of plans."""

import numpy as np
import pytest

from up_samp.io.plan_dict import AREA
from up_samp.plotting.background import LANE_FILL, ground_of, rules_of, tinted, told
from up_samp.plotting.map_picture import plot_map
from up_samp.plotting.style import AREA_FILL, OCCUPIED, rgb

SQUARE = [[2.0, 2.0], [4.0, 2.0], [4.0, 4.0], [2.0, 4.0]]
LANE = {"polygon": [[0.0, 3.0], [8.0, 3.0], [8.0, 5.0], [0.0, 5.0]], "prefer": 2.0}
SLOW = {"polygon": SQUARE, "v_max": 0.3, "pivots": False}
EXTENT = (0.0, 10.0, 0.0, 6.0)


def colour_at(pixels, x, y):
    left, right, bottom, top = EXTENT
    row = int((top - y) / (top - bottom) * pixels.shape[0])
    return tuple(pixels[row, int((x - left) / (right - left) * pixels.shape[1])])


@pytest.mark.parametrize("rules", [[LANE, SLOW], [SLOW, LANE]])
def test_free_floor_is_tinted_and_walls_stay(rules):
    floor = np.full((6, 10, 3), 255, dtype=np.uint8)
    floor[2:4, 2] = OCCUPIED  # y 2 to 4, x 2 to 3
    pixels = tinted(floor, EXTENT, rules)
    assert colour_at(pixels, 3.5, 2.5) == rgb(AREA_FILL)
    assert colour_at(pixels, 3.5, 3.5) == rgb(AREA_FILL)  # over the lane
    assert colour_at(pixels, 6.5, 4.5) == rgb(LANE_FILL)
    assert colour_at(pixels, 2.5, 3.5) == OCCUPIED
    assert colour_at(pixels, 6.5, 1.5) == (255, 255, 255)
    assert tinted(floor, EXTENT, []) is floor


def test_an_arrow_says_which_way():
    floor = np.full((6, 10, 3), 255, dtype=np.uint8)
    plain, east, west = (
        tinted(floor, EXTENT, [{"polygon": SQUARE, **more}])
        for more in ({}, {"one_way": 0.0}, {"one_way": np.pi})
    )
    assert (east != plain).any()
    assert (east != west).any()
    assert np.abs((east != plain).sum() - (west != plain).sum()) < 0.1 * (east != plain).sum()


def plan_with(*zones):
    robot = {"type": "cart", "footprint": [[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3]]}
    return {
        "problem": "ruled",
        "engine": "",
        "status": "",
        "makespan": 10,
        "lower_bound": None,
        "seconds_per_unit": 1.0,
        "objects": [
            {**robot, "name": f"r{k}", "initial": [k + 1.0, 1.0, 0.0], "zones": list(zones)}
            for k in range(2)
        ],
        "motions": [],
        "changes": [],
        "map": {},
        "activities": [],
    }


def test_rules_are_told_once_whoever_keeps_them():
    slow = {**SLOW, "polygon": [[0.5, 0.5], [2.0, 0.5], [2.0, 1.5]]}
    plan = plan_with(LANE, slow)
    assert rules_of(plan) == [LANE, slow]
    assert [told(zone) for zone in rules_of(plan)] == ["", "0.3 m/s, no turning"]
    axes = plot_map(plan)
    assert "0.3 m/s, no turning" in {text.get_text() for text in axes.texts}
    keys = {text.get_text() for text in axes.get_figure().legends[0].get_texts()}
    assert {"rules of driving", "preferred lane"} <= keys
    bare = plot_map(plan_with())
    assert not {"rules of driving", "preferred lane"} & {
        text.get_text() for text in bare.get_figure().legends[0].get_texts()
    }


@pytest.mark.parametrize("turn", [1, -1])
def test_all_that_is_asked_in_one_place_is_told(turn):
    place = [[0.5, 0.5], [2.0, 0.5], [2.0, 1.5]]
    zones = [{"polygon": place, "v_max": 0.3}, {"polygon": place[::-1], "stops": False}][::turn]
    area = {"footprint": place, "initial": [0.0, 0.0, 0.0], "type": AREA}
    plan = plan_with(*zones)
    plan["objects"] += [{**area, "name": name} for name in ("wet", "busy")[::turn]]
    told_there = {text.get_text() for text in plot_map(plan).axes.texts}
    names, asked = [", ".join(some[::turn]) for some in (("wet", "busy"), ("0.3 m/s", "no stop"))]
    assert f"{names}: {asked}" in told_there


def test_where_there_is_no_map_rules_are_drawn_all_the_same():
    laid = ground_of(plan_with({**SLOW, "polygon": [[0.5, 0.5], [2.0, 0.5], [2.0, 1.5]]}))
    assert (laid.pixels == rgb(AREA_FILL)).all(axis=-1).any()
