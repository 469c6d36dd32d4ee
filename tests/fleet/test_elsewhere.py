"""Fleets on floors that are laid elsewhere in the world, with bodies whose reference point lies
anywhere: whoever answers may not contradict what is said of the same fleet where it was.
"""

import random

import pytest

from tests.fleet.buildings import built
from tests.fleet.elsewhere import Elsewhere
from tests.fleet.modern import Modern
from tests.fleet.test_buildings import Answer, contradictions
from up_samp.fleet import FleetError

SEEDS = (7, 15)
OUTLINE = ((-0.35, -0.25), (0.35, -0.25), (0.35, 0.25), (-0.35, 0.25))


def told(seed, folder):
    """Return what is wrong with the answers to a random fleet, here and elsewhere; every second
    one's robots have their reference point off their middle, or beside them.
    """
    spec, rng = Modern(seed, folder).spec, random.Random(seed)
    if seed % 2:
        ahead, aside = rng.uniform(-0.8, 0.8), rng.uniform(-0.4, 0.4)
        outline = [[ahead + x, aside + y] for x, y in OUTLINE]
        spec["types"]["agv"]["footprint"] = outline
    answers = []
    for fleet in (spec, Elsewhere(seed).spec(spec)):
        try:
            answers.append(Answer(fleet, built(fleet), 3, 15.0))
        except FleetError as error:
            answers.append(error)
    refused = [isinstance(answer, FleetError) for answer in answers]
    if any(refused):
        return [] if all(refused) else [f"refused in one place only: {answers}"]
    return [*answers[0].wrong, *answers[1].wrong, *contradictions(*answers)]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_floor_may_lie_anywhere(seed, tmp_path):
    assert told(seed, tmp_path) == []


@pytest.mark.long
@pytest.mark.parametrize("first", range(100, 200, 25))
def test_many_floors_may_lie_anywhere(first, tmp_path):
    findings = {seed: told(seed, tmp_path) for seed in range(first, first + 25)}
    assert {seed: found for seed, found in findings.items() if found} == {}
