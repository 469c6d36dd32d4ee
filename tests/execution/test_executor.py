"""The hall of ``handmade``: r0 drives to a button, opens the door and drives through it."""

import pytest

from tests import handmade
from up_samp.execution import At, Do, Executor, Go, Heard, Hold, Reply, dependencies_of
from up_samp.execution.reports import TAKEN
from up_samp.io import plan_to_dict
from up_samp.model import ProblemError

TO_BUTTON, OPEN, TO_ITEM = "move_r0_depot0_to_button", "open_door_r0", "move_r0_button_to_item"
CORNER = "move_r1_depot1_to_corner"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return handmade.make(tmp_path_factory.mktemp("hall"))


@pytest.fixture
def executor(made):
    return Executor(made.plan, made.problem)


def test_the_door_opens_before_anybody_passes(made):
    """The plan's geometry: a gate before the door, which waits for the end of the opening."""
    plan = plan_to_dict(made.problem, made.plan)
    graph = dependencies_of(made.problem, plan).graph
    found = [(e.then, e) for e in graph.edges if e.first.activity == OPEN and e.then.at is At.LEAVE]
    assert len(found) == 1
    gate, edge = found[0]
    assert gate.activity == TO_ITEM
    # the door's leaf begins at x = 14.5, the robot's nose at 13 m when it starts
    assert 1.0 < gate.progress < 1.5
    assert "r0 and door would meet near" in edge.why


def test_what_everybody_is_told(executor):
    told = executor.commands(0.0)
    assert told["r0"] == Go(TO_BUTTON, 8.0)
    assert told["r1"] == Go(CORNER, pytest.approx(7.0 + 0.5 * 3.141593, abs=1e-4))
    executor.update("r0", progress=8.0, now=9.5, motion=TO_BUTTON)
    told = executor.commands(9.5)
    assert executor.phase(TO_BUTTON).value == "done"
    assert told["r0"] in (Go(TO_ITEM, pytest.approx(1.2, abs=0.3)), Do(OPEN))
    assert isinstance(told["r1"], Go)


def test_a_gate_says_what_it_waits_for_and_opens(executor):
    executor.commands(0.0)
    executor.update("r0", progress=8.0, now=9.0)
    told = executor.commands(9.1)
    gate = told["r0"]
    assert isinstance(gate, Go)
    assert gate.motion == TO_ITEM
    assert gate.until < 1.5
    assert told[OPEN] == Do(OPEN)  # the problem does not say that the robot has to do it
    executor.update("r0", progress=gate.until, now=12.0)
    held = executor.commands(12.0)["r0"]
    assert isinstance(held, Hold)
    assert OPEN in held.waiting_for[0]
    assert executor.waits_for("r0") == (OPEN,)
    executor.done(OPEN, 13.0)
    assert executor.commands(13.0)["r0"] == Go(TO_ITEM, 13.0)


def test_lateness_slack_and_what_will_be_missed(executor):
    executor.commands(0.0)
    planned = max(t.planned[1] for t in executor.state.graph.tasks.values())
    assert executor.predicted_makespan() <= planned + 0.5
    for robot in ("r0", "r1"):
        executor.update(robot, progress=0.0, now=30.0)
    assert executor.predicted_makespan() > planned + 10.0
    assert executor.late()[TO_BUTTON] > 20.0
    assert executor.missed()[f"duration of {TO_BUTTON}"] > 10.0
    slack = executor.slack()
    assert min(slack.values()) < 0.0  # its longest duration cannot be kept any more
    # nobody waits for r1, but it may take 40 s at most, and has not moved for 30
    assert 0.0 < slack[CORNER] < 5.0


def test_what_cannot_be_over_is_not(executor):
    executor.commands(0.0)
    assert executor.done("nothing") == Reply(Heard.IGNORED, "the plan has no activity 'nothing'")
    early = executor.done("pick_r0_item")  # it takes 2 s
    assert early.heard is Heard.AGAIN
    assert "'pick_r0_item' may not end yet: it waits for" in early.why
    assert "'move_r0_button_to_item' cannot be over" in executor.done(TO_ITEM).why
    assert "its motion is not at its end" in executor.done(TO_BUTTON).why
    assert executor.phase(TO_BUTTON).value == "running"
    other = executor.update("r0", progress=1.0, now=1.0, motion=TO_ITEM)
    assert (other.heard, other.why) == (
        Heard.HELD, f"it tells of '{TO_ITEM}' while in '{TO_BUTTON}'",
    )  # fmt: skip
    held = executor.commands(1.0)["r0"]
    assert isinstance(held, Hold)
    assert held.waiting_for[0] == other.why
    assert executor.update("r0", progress=1.0, now=1.2, motion=TO_BUTTON) == TAKEN
    assert executor.commands(1.2)["r0"] == Go(TO_BUTTON, 8.0)
    with pytest.raises(ProblemError, match="only together with its problem"):
        Executor(executor_plan(executor))


def executor_plan(executor):
    """A UP plan without its problem."""
    from up_samp.io import plan_from_dict

    return plan_from_dict(executor.problem, executor.plan)
