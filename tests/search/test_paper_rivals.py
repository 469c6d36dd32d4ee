"""The paper's temporal cut gives way to a door that opens while the group drives."""

from types import SimpleNamespace

import pytest

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import Overlap
from up_samp.search import cuts
from up_samp.search.facts import just_this


def failure(opening):
    """A late motion at 0 to 10 and a door at 'shut', that 'opens' opens at a time (or not)."""
    times = {"drive": (0, 10)} | ({} if opening is None else {"opens": opening})
    poses = ((0.0, 0.0, 0.0), (9.0, 0.0, 0.0))
    motion = ScheduledMotion("drive", 0, "r", ("a", "b"), poses, 0, 10)
    snapshot = SimpleNamespace(
        moved=lambda: {"r", "door"},
        by_activity={"drive": [SimpleNamespace(activity="drive", object="r")]},
        changes=[SimpleNamespace(activity="opens", object="door")],
    )
    return SimpleNamespace(
        facts=SimpleNamespace(snapshot=snapshot),
        group=(motion,),
        found=True,
        itinerary=SimpleNamespace(
            place_at=lambda *_: "shut", schedule=SimpleNamespace(times=times)
        ),
        arrivals=lambda _: {"drive": 15},
    )


@pytest.mark.parametrize(
    ("opening", "rivals"), [(None, {"opens"}), ((12, 14), {"opens"}), ((4, 6), set())]
)
def test_a_door_that_may_open_meanwhile(opening, rivals):
    (cut,) = cuts.PaperCuts(just_this).group(failure(opening))
    assert {x.rival for x in cut.statement.literals if isinstance(x, Overlap)} == rivals
