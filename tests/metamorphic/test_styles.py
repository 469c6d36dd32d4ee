"""How a problem with motions is written changes neither whether it has a plan nor its optimum."""

import dataclasses

import pytest
from unified_planning.engines import PlanGenerationResultStatus as Status

from tests.metamorphic.answers import Answer, answer, contradictions
from tests.metamorphic.motions import ALIKE, OTHERS, MotionStyle, write
from tests.metamorphic.sites import FAMILIES, doors, haulage, kits, shop, store
from tests.usual import usually
from up_samp.model import MotionModel
from up_samp.motion.compile import precompile
from up_samp.upio import read_problem

ALL = [*ALIKE, *OTHERS]
SMALL = {
    "shop": lambda: shop(0, robots=2, jobs=1),
    "store": lambda: store(0, robots=1, items=1),
    "haulage": lambda: haulage(0, robots=1, items=1),
    "kits": lambda: kits(0, robots=1, parts=2),
    "doors": lambda: doors(1, robots=1),
}


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Compile all kernels first: time limits in these tests are meant for searching."""
    precompile([MotionModel.SE2])


@pytest.mark.parametrize("number", usually(3, 4, of=range(len(SMALL))), ids=list(SMALL))
def test_styles_of_a_small_site_agree(number, tmp_path):
    """Two styles that differ in much, of those that mean the same."""
    site = list(SMALL.values())[number]()
    styles = [ALIKE[number], ALIKE[number + 9 if number != 2 else 12]]
    answers = [answer(site, style, tmp_path) for style in styles]
    assert contradictions(answers) == []
    assert all(a.status is Status.SOLVED_OPTIMALLY for a in answers)


@pytest.mark.parametrize("family", usually("haulage", "kits", of=SMALL))
def test_every_style_is_read_as_the_same_motions(family, tmp_path):
    """Who drives from where to where, and which doors are where, does not hang on the style."""
    site, found = SMALL[family](), {}
    own = list(SMALL).index(family) % 2  # every style of two families, at least
    for style in [s for s in ALL if s.moves == "each"][own::2]:
        snapshot = read_problem(write(site, style, tmp_path))
        poses = snapshot.configurations
        drives = sorted(tuple(poses[term.name] for term in task.terms) for task in snapshot.tasks)
        leaves = sorted(poses[c.term.name] for c in snapshot.changes)
        found.setdefault((tuple(drives), tuple(leaves)), []).append(str(style))
    assert len(found) == 1


def test_contradictions_are_seen():
    """A bound above another's plan, two optima, or no plan beside one: but not across meanings."""
    plan = Answer(MotionStyle(), Status.SOLVED_OPTIMALLY, 20, 20, "", 1.0, 2.0)
    other = MotionStyle(alone="uses")
    worse = dataclasses.replace(plan, style=other, makespan=21, bound=21)
    assert len(contradictions([plan, worse])) == 2
    none = dataclasses.replace(
        plan, style=other, status=Status.UNSOLVABLE_PROVEN, makespan=None, bound=0
    )
    assert len(contradictions([plan, none])) == 1
    late = dataclasses.replace(plan, status=Status.SOLVED_SATISFICING, makespan=22, bound=19)
    assert contradictions([plan, late]) == []
    apart = dataclasses.replace(worse, style=MotionStyle(obstacles="none"))
    assert contradictions([plan, apart]) == []
    assert len(contradictions([dataclasses.replace(plan, refused="a collision")])) == 1


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("family", FAMILIES)
def test_all_styles_agree(family, seed, tmp_path):
    site = FAMILIES[family](seed)
    answers = [answer(site, style, tmp_path, timeout=30) for style in ALL]
    assert contradictions(answers) == []
