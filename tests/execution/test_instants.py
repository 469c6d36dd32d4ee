"""One instant is an order: what a schedule has at one time happens on the floor in an order that
the problem's meaning needs, however late anybody is.
"""

import json
import random

import pytest
from unified_planning.model import Fluent, OpenTimeInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import (
    LE,
    BoolType,
    Equals,
    IntType,
)

from tests.execution import instants, sites
from up_samp.execution import (
    At,
    Delays,
    Event,
    dependencies_of,
    shown_with_dependencies,
    simulate,
    with_dependencies,
)
from up_samp.execution.judge import broken_rules
from up_samp.export import export_plan
from up_samp.io import plan_from_dict, plan_to_dict
from up_samp.model import UnsupportedError
from up_samp.validation import validate_plan, validate_schedule


def attacked(seeds, runs):
    """Run random executions of random schedules; return how many were judged, and how many
    schedules no executive can keep.
    """
    judged = refused = 0
    for seed in seeds:
        made = instants.Instants(seed)
        assert validate_schedule(made.problem, made.schedule).valid
        try:
            found = dependencies_of(made.problem, made.plan)
        except UnsupportedError:
            refused += 1
            continue
        for k in range(runs):
            record = instants.executed(found, made.plan, random.Random(k))
            broken, _ = broken_rules(found, record)
            assert broken == (), (seed, k)
            judged += 1
    return judged, refused


def test_every_execution_keeps_what_is_asked():
    judged, refused = attacked(range(40), 3)
    assert judged >= 105
    assert refused <= 5


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_three_thousand_schedules(block):
    judged, refused = attacked(range(1000 + 300 * block, 1300 + 300 * block), 6)
    assert refused <= 15
    assert judged >= 285 * 6


def test_the_judge_sees_what_is_missing():
    """Without the orders of one fluent some execution breaks it, by name."""
    seen = set()
    for seed in range(30):
        made = instants.Instants(seed)
        try:
            found = dependencies_of(made.problem, made.plan)
        except UnsupportedError:
            continue
        kept = tuple(e for e in found.graph.edges if e.kind not in ("fluent", "constraint"))
        loose = type(found)(
            type(found.graph)(
                found.graph.tasks, found.graph.events, found.graph.times, kept, found.graph.bounds
            ),
            {}, (), (), problem=made.problem,
        )  # fmt: skip
        for k in range(4):
            record = instants.executed(loose, made.plan, random.Random(k))
            seen |= {text.split(":")[0] for text in broken_rules(loose, record)[0]}
    assert seen >= {"bounds", "interference", "constraint"}


def two_tasks(times, state):
    problem = SchedulingProblem("two")
    tasks = {name: problem.add_activity(name, end - start) for name, (start, end) in times.items()}
    state(problem, tasks)
    values = {}
    for name, (start, end) in times.items():
        values[tasks[name].start], values[tasks[name].end] = start, end
    return problem, plan_to_dict(problem, Schedule(list(tasks.values()), values))


def test_who_swaps_two_units_at_one_instant_is_told():
    """Each takes what the other one gives back at that instant: in whatever order, one is short."""

    def state(problem, x):
        for name, gives in (("left", "a"), ("right", "b")):
            room = Fluent(name, IntType(0, 1))
            problem.add_fluent(room, default_initial_value=0)
            for task in x:
                change = (
                    x[task].add_increase_effect if task == gives else x[task].add_decrease_effect
                )
                change(x[task].start, room(), 1)

    problem, plan = two_tasks({"a": (1, 2), "b": (1, 2)}, state)
    with pytest.raises(UnsupportedError, match=r"start of [ab] and start of [ab] .* one instant"):
        dependencies_of(problem, plan)
    shown, why = shown_with_dependencies(problem, plan)  # who only looks at it loses nothing
    assert shown == plan
    assert "one instant" in why


def test_who_puts_down_and_takes_up_by_turns_at_one_instant_has_an_order():
    """A table for two has one thing on it: two put and two take at once, which neither all puts
    nor all takes before the others keep within its room.
    """
    problem = SchedulingProblem("table")
    table = Fluent("table", IntType(0, 2))
    problem.add_fluent(table, default_initial_value=1)
    times, tasks = {}, []
    for name in ("take one", "put one", "put two", "take two"):
        task = problem.add_activity(name, 2)
        change = task.add_increase_effect if name.startswith("put") else task.add_decrease_effect
        change(task.start, table(), 1)
        times[task.start], times[task.end] = 1, 3
        tasks.append(task)
    schedule = Schedule(tasks, times)
    assert validate_schedule(problem, schedule).valid
    plan = plan_to_dict(problem, schedule)
    found = dependencies_of(problem, plan)
    for seed in range(10):
        record = instants.executed(found, plan, random.Random(seed))
        assert broken_rules(found, record)[0] == ()


@pytest.mark.parametrize("turned", [False, True])
def test_meeting_in_one_instant_is_no_cycle(turned):
    """``b`` starts when ``a`` ends, in whatever order that is said."""

    def state(problem, x):
        sides = (x["b"].start, x["a"].end)
        problem.add_constraint(Equals(*(sides[::-1] if turned else sides)))
        lamp = Fluent("lamp", BoolType())
        problem.add_fluent(lamp, default_initial_value=False)
        x["a"].add_effect(x["a"].end, lamp, True)
        span = OpenTimeInterval(Timing(0, x["b"].start), Timing(0, x["b"].end))
        x["b"].add_condition(span, lamp)

    graph = dependencies_of(*two_tasks({"a": (0, 2), "b": (2, 5)}, state)).graph
    ends = {(str(e.first), str(e.then)) for e in graph.edges}
    assert ("end of a", "start of b") in ends
    assert ("start of b", "end of a") not in ends


# ------------------------------------------------------------------ on the floor


def test_who_is_set_somewhere_drives_on_at_that_instant(yaml, tmp_path):
    """A lift: its rider is up at 12 s, and drives off at 12 s; others cross below and above."""
    site = sites.Site(yaml)
    site.robot("r0", (2.0, 2.0, 0.0))
    site.robot("r1", (9.0, 6.0, 1.5708))
    there = site.drive("to_lift", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 0)
    up = site.lift("ride", "r0", (6.0, 8.0, 0.0), there, there + 4)
    back = site.drive("off", "r0", (6.0, 8.0, 0.0), [(4.0, 0.0)], up)
    site.drive("across", "r1", (9.0, 6.0, 1.5708), [(4.0, 0.0)], back)
    x = site.activities
    site.problem.add_constraint(LE(x["to_lift"].end, x["ride"].start))
    site.problem.add_constraint(LE(x["ride"].end, x["off"].start))
    rng = random.Random(1)
    for key in ("activities", "motions", "changes", "objects"):
        rng.shuffle(site.data[key])
    verdict = validate_plan(site.problem, plan_from_dict(site.problem, site.data))
    assert [v for v in verdict.violations if v.kind == "collision"] == []
    found = dependencies_of(site.problem, site.data)
    ends = {(e.first, e.then) for e in found.graph.edges}
    assert (Event(At.END, "ride"), Event(At.START, "off")) in ends
    for seed in range(3):
        run = simulate(found, site.data, Delays(slow=0.5, stops=3.0, late=1.0), seed)
        assert run.finished
        assert run.contacts == ()
        assert run.broken == ()
    full = with_dependencies(site.problem, site.data)
    written = export_plan(full, "vda5050", tmp_path)
    releases = json.loads(written[-1].read_text())["messages"]
    waits = [c["event"] for m in releases if m["serialNumber"] == "r0" for c in m["after"]]
    assert releases
    assert ["end", "across"] not in waits


def test_a_zone_is_given_over_at_one_instant(yaml, tmp_path):
    """A zone for one: who leaves it at 14 s lets in who comes at 14 s, however late it is."""
    site = sites.Site(yaml)
    site.robot("r0", (2.0, 2.0, 0.0))
    site.robot("r1", (2.0, 9.0, 0.0))
    inside = site.drive("in0", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 0)
    out = site.drive("out0", "r0", (5.0, 2.0, 0.0), [(3.0, 0.0)], inside + 1)
    site.drive("in1", "r1", (2.0, 9.0, 0.0), [(3.0, 0.0)], out)
    room = Fluent("zone_room", IntType(0, 1))
    site.problem.add_fluent(room, default_initial_value=1)
    x = site.activities
    for name in ("in0", "in1"):
        x[name].add_decrease_effect(x[name].start, room(), 1)
    x["out0"].add_increase_effect(x["out0"].end, room(), 1)
    found = dependencies_of(site.problem, site.data)
    for seed in range(3):
        run = simulate(found, site.data, Delays(slow=0.6, stops=4.0), seed)
        assert run.finished
        assert run.broken == ()
        spans = {a["name"]: (a["start"], a["end"]) for a in run.record["activities"]}
        assert spans["out0"][1] <= spans["in1"][0]
    timed = simulate(found, site.data, Delays(slow=0.6, stops=4.0), 0, policy="timed")
    assert any("zone_room becomes -1" in text for text in timed.broken)
    full = with_dependencies(site.problem, site.data)
    releases = json.loads(export_plan(full, "vda5050", tmp_path)[-1].read_text())["messages"]
    waits = [c["event"] for m in releases if m["serialNumber"] == "r1" for c in m["after"]]
    assert ["end", "out0"] in waits


def test_where_a_motion_leads_is_known_before_it_begins(yaml):
    """A goal that a fluent names is read at the drive's start: who sets it comes first, and who
    sets it anew at that very instant comes later.
    """
    site = sites.Site(yaml)
    site.robot("r0", (2.0, 2.0, 0.0))
    spot = Fluent("spot", site.kind)
    site.problem.add_fluent(spot, default_initial_value=site.place("nowhere", (9.0, 9.0, 0.0)))
    site.drive("go", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 4, goal=spot())
    for name, start, end in (("choose", 1, 3), ("again", 2, 4)):
        task = site.problem.add_activity(name, end - start)
        goal = "go_1" if name == "choose" else "nowhere"
        task.add_effect(task.end, spot, site.problem.object(goal))
        site.timed(name, task, start, end)
    graph = dependencies_of(site.problem, site.data).graph
    ends = {(e.first, e.then) for e in graph.edges}
    go = Event(At.START, "go")
    assert (Event(At.END, "choose"), go) in ends
    later = (Event(At.END, "again"), Event(At.START, "again"))
    assert any((go, then) in ends for then in later)
