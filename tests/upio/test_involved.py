"""Who needs which robot, and where robots are told to be, however a problem is written."""

import dataclasses

import pytest

from tests.metamorphic.motions import ALIKE, OTHERS, MotionWriter
from tests.metamorphic.sites import FAMILIES
from up_samp.benchmarks import instance
from up_samp.benchmarks.instances import ENCODINGS
from up_samp.upio.movers import Involved, whereabouts


def sites():
    """Every style, in a turn of families, with its listing shuffled; every second one, and the
    largest, only where the slow tests are run.
    """
    for number, style in enumerate([*ALIKE, *OTHERS]):
        style = dataclasses.replace(style, shuffled=style.shuffled or number % 3 * 50)
        slow = number % 2 or number in (18, 24)
        yield pytest.param(number, style, marks=[pytest.mark.long] if slow else [])


@pytest.mark.parametrize(("number", "style"), list(sites()))
def test_every_style_says_who_does_what_and_where_robots_are(number, style, tmp_path):
    family = list(FAMILIES)[number % len(FAMILIES)]
    writer = MotionWriter(FAMILIES[family](number), style, tmp_path)
    involved = Involved(writer.problem, whereabouts(writer.problem))
    truth = {a.name: writer.bodies[r].name for r, a in writer._doings()}
    for activity in writer.problem.activities:
        mine = {b.name for b in writer.bodies if involved.needs(activity.name, b.name)}
        assert mine == {truth[n] for n in (activity.name,) if n in truth}, activity.name
    if style.fluents == "precedences":
        assert involved.told == {}
        return
    bodies = {body.name: at for body, at in zip(writer.bodies, writer.at, strict=True)}
    assert {who: f for f, who in involved.told.items() if who in bodies} == bodies


def test_a_fluent_that_something_else_sets_tells_nothing(tmp_path):
    writer = MotionWriter(FAMILIES["haulage"](0), ALIKE[0], tmp_path)
    other = writer.problem.add_activity("other", 1, optional=True)
    other.add_effect(other.end, writer.at[0], writer.spots[0])
    assert set(whereabouts(writer.problem).values()) == {"r1"}
    loose = MotionWriter(FAMILIES["haulage"](0), ALIKE[0], tmp_path)
    drive = next(m for r, m, *_ in loose.moves if r == 1)
    drive._effects.clear()
    drive.add_effect(drive.end, loose.at[1], loose.spots[loose.site.starts[0]])
    assert set(whereabouts(loose.problem).values()) == {"r0"}


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", ["logistics-do-oc-r2-i2", "jobshop-r2-j1-m1"])
def test_published_forms(name, encoding):
    """Each activity is one robot's; places called after another robot do not make it that one's."""
    problem = instance(name).build(encoding, True)
    robots = {m.object().name for m, _ in problem.initial_configuration if m.type.name == "robot"}
    involved = Involved(problem, whereabouts(problem))
    for activity in problem.activities:
        mine = {r for r in robots if involved.needs(activity.name, r)}
        said = next((w for w in activity.name.split("_")[:2] if w in robots), None)
        assert len(mine) == 1, activity.name
        assert said is None or mine == {said}, activity.name
