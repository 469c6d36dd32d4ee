"""However a problem is written, the same is recognised in what is stated before the first schedule:
routes, lengths, doors that are needed open, places for one, tasks and who may do them.
"""

from dataclasses import replace
from functools import cache, partial

import pytest

from tests.metamorphic.motions import ALIKE, OTHERS, MotionStyle
from tests.metamorphic.sites import FAMILIES, doors, haulage, kits, shop, store
from tests.metamorphic.structures import service_of, structures
from tests.usual import usually
from up_samp.model import MotionModel
from up_samp.motion.compile import precompile

SMALL = {
    "shop": lambda: shop(0, jobs=1),
    "store": lambda: store(0, robots=1, items=1),
    "haulage": lambda: haulage(0, robots=1, items=1),
    "kits": lambda: kits(0, robots=1),
    "doors": lambda: doors(1, robots=1),
}
FEW = [
    MotionStyle(),
    MotionStyle(one_of="inside", order="inside", at="parameter", shuffled=1),
    MotionStyle(moves="leave"),
    MotionStyle(moves="leave", alone="uses", team="presences", shuffled=6),
]
BUSY = [
    MotionStyle(alone="strictly", machine="strictly", arrive="end", obstacles="lists"),
    MotionStyle(alone="busy", machine="held", arrive="end", obstacles="mixed", shuffled=3),
]


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile all kernels first."""
    precompile([MotionModel.SE2])


@pytest.fixture(scope="module")
def look(tmp_path_factory):
    """Return what is recognised in a small site in a style, each looked at once."""
    folder = tmp_path_factory.mktemp("small")
    service = cache(lambda family: service_of(SMALL[family](), folder))
    return cache(lambda family, style: structures(SMALL[family](), style, folder, service(family)))


def differing(styles, look):
    """Return the styles of one meaning in which not the same is recognised."""
    found = {}
    for style in styles:
        seen = look(style)
        found.setdefault(style.units, {}).setdefault(seen, []).append(str(style))
    return [list(some.values()) for some in found.values() if len(some) > 1]


@pytest.mark.parametrize("family", usually("haulage", "doors", of=SMALL))
def test_the_same_is_recognised_in_styles_that_mean_the_same(family, look):
    assert differing(FEW + BUSY, partial(look, family)) == []


@pytest.mark.parametrize("family", usually("haulage", "doors", of=SMALL))
def test_moves_whose_ends_are_both_parameters_are_recognised(family, look):
    """But that each of them keeps still the doors which it does not go through."""
    plain, free = (look(family, style) for style in (MotionStyle(), MotionStyle(moves="go")))
    same = [
        replace(some, routes=frozenset((*r[:5], *r[6:]) for r in some.routes))
        for some in (plain, free)
    ]
    assert same[0] == same[1]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_is_recognised_in_all_styles(family, seed, tmp_path):
    site = FAMILIES[family](seed)
    assert differing([*ALIKE, *OTHERS], lambda style: structures(site, style, tmp_path)) == []
