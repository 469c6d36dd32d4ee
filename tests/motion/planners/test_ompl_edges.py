"""The compiled edge checks against shapely: never free where shapely sees a collision."""

import math

import numpy as np
import pytest

from tests.motion.planners import ompl_oracle as oracle
from tests.motion.planners.ompl_oracle import CAR, CRATE, DOOR, OMNI
from up_samp.motion.curves.reeds_shepp import shortest
from up_samp.motion.planners.ompl import PlanarWorld

SCENE = oracle.hall_scene()
ITEMS = (CRATE, DOOR)
SOLID = oracle.walls(SCENE.grid).union(oracle.obstacles_of(ITEMS))


def poses_along(world, a, b):
    """Many poses of the edge that the planner means."""
    if not world.car:
        turn = math.remainder(b[2] - a[2], 2 * math.pi)
        shares = np.linspace(0, 1, 40)[:, None]
        return np.array(a) + shares * np.array([b[0] - a[0], b[1] - a[1], turn])
    from up_samp.geometry.kernels import advance

    rows, pose = [], tuple(a)
    for kappa, s in shortest(a, b, world.radius)[1]:
        rows += [advance(*pose, kappa, part) for part in np.linspace(0, s, 12)]
        pose = advance(*pose, kappa, s)
    return np.array(rows)


@pytest.mark.parametrize("body", [CAR, OMNI], ids=["car", "omni"])
@pytest.mark.parametrize("count", [150, pytest.param(5000, marks=pytest.mark.long)])
def test_edges_agree_with_shapely(body, count):
    world = PlanarWorld(SCENE, body, (), ITEMS)
    rng = np.random.default_rng(5)
    free = 0
    for _ in range(count):
        a = (rng.uniform(1, 19), rng.uniform(1, 11), rng.uniform(-math.pi, math.pi))
        b = tuple(np.array(a) + rng.normal(size=3) * (2.0, 2.0, 1.0))
        if not world.pose_free(*a):
            continue
        says = world.edge_free(*a, *b)
        seen = min(oracle.placed(body, p).distance(SOLID) for p in poses_along(world, a, b))
        free += says
        if says:
            assert seen >= SCENE.margin
        else:  # it may refuse what comes close to the margin
            assert seen < SCENE.margin + 0.03
    assert free > count / 10


def test_hits_name_what_is_in_the_way():
    world = PlanarWorld(SCENE, OMNI, (), ITEMS)
    world.hits = set()
    assert not world.edge_free(8.0, 6.0, 0.0, 12.0, 6.0, 0.0)
    assert world.hits == {"door"}
    assert not world.edge_free(8.0, 3.0, 0.0, 12.0, 3.0, 0.0)  # the wall beside it
    assert world.hits == {"door"}
