"""Who goes first in a plan of two is decided by what orders' ends cost, and the times say so."""

import numpy as np
import pytest

from tests.execution import floors
from up_samp.execution import dependencies_of
from up_samp.execution.judge import contacts_of
from up_samp.execution.lives import lives_of
from up_samp.execution.meetings import meetings_of
from up_samp.execution.reorder import Goal
from up_samp.operate.order import Ordering


@pytest.fixture(scope="module")
def crossed(tmp_path_factory):
    problem, plan = floors.crossing(floors.hall(tmp_path_factory.mktemp("hall")))
    return plan, dependencies_of(problem, plan)


def ends(plan):
    names = {m["activity"]: m["object"] for m in plan["motions"]}
    return {names[a["name"]]: a["end"] for a in plan["activities"]}


@pytest.mark.parametrize("first", ["r0", "r1"])
def test_whose_end_costs_most_goes_first(crossed, first):
    plan, told = crossed
    goals = {
        m["activity"]: Goal(20.0 if m["object"] == first else 1.0, 0.0, 0.0)
        for m in plan["motions"]
    }
    made = Ordering(goals=goals)(plan, told)
    found = ends(made)
    assert min(found, key=found.get) == first
    assert not contacts_of(made)
    (meeting,) = meetings_of(lives_of(made), localisation=0.05)
    assert np.all(meeting.one_first == (meeting.one.object == first))


def test_what_cannot_be_told_in_time_stays(crossed):
    plan, told = crossed
    goals = {
        m["activity"]: Goal(20.0 if m["object"] == "r1" else 1.0, 0.0, 0.0) for m in plan["motions"]
    }
    found = ends(Ordering(goals=goals, lead=60.0)(plan, told))
    assert min(found, key=found.get) == "r0"
