"""Where jobs are assigned, less may happen than in the whole problem, and less is left to choice:
who does nothing is surely where it was at first.
"""

import logging
import random

import pytest
from unified_planning.shortcuts import LE, TRUE, OneshotPlanner, get_environment

from tests.search.test_assumptions import Site, errand
from tests.shuffled import shuffled
from up_samp.validation import validate_plan


def with_parking(seed):
    """Return errands of robots that all have to drive to where they start, from wherever they are,
    listed anyhow.
    """
    rng, site = random.Random(f"parking {seed}"), Site()
    parks = [site.drive(f"park{r}", r, f"home{r}") for r in range(2)]
    for park in parks:
        park._optional, park._present = False, TRUE()
    for n, at in enumerate(rng.sample("BCD", rng.choice([1, 1, 2]))):
        for (_, do), park in zip(errand(site, at, 3, name=f"{n}by"), parks, strict=True):
            if rng.random() < 0.7:
                site.problem.add_constraint(LE(do.end, park.start), [do.present])
    return shuffled(site.problem, seed, rename=False).problem


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(s, marks=pytest.mark.long) for s in range(1, 9))]
)
def test_who_gets_no_job_drives_from_where_it_is_at_first(seed, caplog):
    get_environment().credits_stream = None
    problem = with_parking(seed)
    params = {"first_plan": True, "tuning": {"large": 1}}
    with (
        caplog.at_level(logging.ERROR),
        OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner,
    ):
        result = planner.solve(problem, timeout=120)
    assert not caplog.records
    assert result.metrics["rounds"] == "0", "it came from what was assigned"
    assert validate_plan(problem, result.plan).valid
