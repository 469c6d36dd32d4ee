"""A graph in a plan file is valid if every execution that it allows is: what is broken is named."""

import copy
import re
from pathlib import Path

import pytest
from unified_planning.model import Fluent
from unified_planning.shortcuts import LE, LT, IntType, Or

from tests.execution import sites
from up_samp.cli import main
from up_samp.execution import dependencies_from_plan, dependency_faults, with_dependencies
from up_samp.export import export_plan
from up_samp.io import write_plan
from up_samp.model import ProblemError


def written(yaml):
    """Robots that cross, a zone for one that is handed over at one instant, a machine, a
    deadline, one motion that lists what it keeps clear of.
    """
    site = sites.Site(yaml)
    site.robot("r0", (2.0, 2.0, 0.0))
    site.robot("r1", (6.5, 9.0, -1.5707963))
    site.robot("r2", (2.0, 5.0, 0.0))
    inside = site.drive("in_r0", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 0)
    out = site.drive("out_r0", "r0", (5.0, 2.0, 0.0), [(4.0, 0.0)], inside)
    site.drive("past_r2", "r2", (2.0, 5.0, 0.0), [(8.0, 0.0)], 0)
    listed = ["r0", "r2"]
    site.drive("in_r1", "r1", (6.5, 9.0, -1.5707963), [(7.5, 0.0)], out, obstacles=listed)
    site.task("wash_r0", out, out + 2)
    site.task("dry_r1", out + 3, out + 5)
    room, p, x = Fluent("zone_room", IntType(0, 1)), site.problem, site.activities
    p.add_fluent(room, default_initial_value=1)
    for name in ("in_r0", "in_r1"):
        x[name].add_decrease_effect(x[name].start, room(), 1)
    x["out_r0"].add_increase_effect(x["out_r0"].end, room(), 1)
    p.add_constraint(LE(x["in_r0"].end, x["out_r0"].start))
    p.add_constraint(LT(1, x["wash_r0"].start))
    p.add_constraint(
        Or(LT(x["wash_r0"].end, x["dry_r1"].start), LT(x["dry_r1"].end, x["wash_r0"].start))
    )
    p.add_constraint(LE(x["dry_r1"].end, 60))
    return site


@pytest.fixture(scope="module")
def site(yaml):
    return written(yaml)


@pytest.fixture(scope="module")
def full(site):
    return with_dependencies(site.problem, site.data)


def edges(plan, kind=None):
    found = plan["dependencies"]["edges"]
    return [e for e in found if kind is None or e["kind"] == kind]


def motion(plan, name):
    return next(m for m in plan["motions"] if m["activity"] == name)


def drop(kind):
    def spoil(plan):
        gone = edges(plan, kind)
        assert gone
        plan["dependencies"]["edges"] = [e for e in edges(plan) if e not in gone]

    return spoil


def turn(kind):
    def spoil(plan):
        edge = edges(plan, kind)[0]
        edge["first"], edge["then"] = edge["then"], edge["first"]

    return spoil


def put(kind, /, **fields):
    return lambda plan: edges(plan, kind)[0].update(fields)


def bare(plan):
    plan["dependencies"]["edges"] = []


def ring(plan):
    plan["dependencies"]["edges"] += [
        {**e, "first": e["then"], "then": e["first"], "lag": 0} for e in edges(plan)
    ]


def later(plan):
    """Who lets whom pass is told for a point beyond the one where they would meet."""
    for edge in edges(plan, "meeting"):
        edge["then"][3] += 3.0


def far(plan):
    rows = motion(plan, "in_r1")["samples"]
    for row in rows:
        row[1] += 9e6


def leap(plan):
    rows = motion(plan, "in_r1")["samples"]
    rows[len(rows) // 2][1] = 9e6


def swapped(plan):
    """A choice that the problem does not leave: who crosses first."""
    edge = edges(plan, "meeting")[0]
    ways = [{k: edge[k] for k in ("first", "then", "lag")}] * 2
    plan["dependencies"].setdefault("choices", []).append(
        {"ways": ways, "kind": "constraint", "why": "?"}
    )


def more(plan):
    edge = {"first": ["end", "dry_r1"], "then": ["end", "in_r1"], "lag": 500}
    plan["dependencies"]["edges"].append({**edge, "kind": "constraint", "why": "?"})


def double(plan):
    mine = motion(plan, "in_r1")
    mine["progress"] = [2 * v for v in mine["progress"]]


def tasks(plan):
    return plan["dependencies"]["tasks"]


BROKEN = {
    "all edges removed": (
        bare,
        "start of in_r1 does not wait",
    ),
    "no order of fluents": (drop("fluent"), "start of in_r1 does not wait for end of out_r0"),
    "no constraints": (drop("constraint"), "does not wait for"),
    "no durations": (drop("duration"), r"end of \w+ does not wait for .* s after start of"),
    "nobody lets pass": (drop("meeting"), "r1 and r2 would meet"),
    "an edge turned round": (
        turn("fluent"),
        "start of in_r1 does not wait for|cycle",
    ),
    "a meeting turned round": (turn("meeting"), "would meet|cycle"),
    "a lag of -100": (
        put("duration", lag=-100),
        r"'lag' of entry \d+ of 'edges' of .* cannot be -100: it must be a number from 0",
    ),
    "a lag too small": (put("duration", lag=0.0), r"does not wait for \d+ s after"),
    "no lag": (lambda p: edges(p)[0].pop("lag"), "entry 0 of 'edges' .*lacks 'lag'"),
    "an edge of nobody": (
        put("fluent", first=["end", "nobody"]),
        "nobody, which is not in",
    ),
    "an edge of no event": (
        put("fluent", first=["stop", "in_r0"]),
        "'first' of .*must be an event",
    ),
    "a motion that is none": (
        put("fluent", first=["reach", "wash_r0", "r0", 1.0]),
        "r0 reaches 1.00 m in wash_r0, which is not driven",
    ),
    "beyond the path": (
        put("meeting", first=["reach", "past_r2", "r2", 99.0]),
        "whose path has 8 m",
    ),
    "a gate too late": (later, "r1 and r2 would meet"),
    "an order as a meeting": (
        put("fluent", kind="meeting"),
        "start of in_r1 does not wait",
    ),
    "an unknown kind": (put("fluent", kind="habit"), "'kind' of .*must be one of meeting"),
    "a cycle": (ring, "cycle: nobody could go first of"),
    "an edge that the plan breaks": (
        more,
        "the plan itself does not keep that end of in_r1 waits for end of dry_r1",
    ),
    "progress all 0": (
        lambda p: motion(p, "in_r1").update(progress=[0.0] * len(motion(p, "in_r1")["samples"])),
        "motion of 'r1' in activity 'in_r1' has progress 0 m",
    ),
    "progress backwards": (
        lambda p: motion(p, "in_r1")["progress"].reverse(),
        "progress that goes back",
    ),
    "progress off the path": (
        double,
        "motion of 'r1' in activity 'in_r1' has progress 15 m",
    ),
    "progress for fewer samples": (
        lambda p: motion(p, "in_r0")["progress"].pop(),
        "values of progress for",
    ),
    "no progress": (lambda p: motion(p, "in_r0").pop("progress"), "'in_r0' has no progress"),
    "avoid emptied": (
        lambda p: motion(p, "in_r1").update(avoid=[]),
        r"in activity 'in_r1' keeps clear of \[\], by the problem of \['r0', 'r2'\]",
    ),
    "avoid made up": (
        lambda p: motion(p, "in_r0").update(avoid=[]),
        "in activity 'in_r0' keeps clear of .* by the problem of everything",
    ),
    "no deadline": (
        lambda p: p["dependencies"].update(bounds=[]),
        "no bound says that end of dry_r1",
    ),
    "a later deadline": (
        lambda p: [b.update(most=b["most"] + 9) for b in p["dependencies"]["bounds"]],
        "no bound says that end of dry_r1 is at most 60 s",
    ),
    "a task of somebody else": (
        lambda p: [t.update(who=["r1"]) for t in tasks(p) if t["activity"] == "wash_r0"],
        "the task 'wash_r0' is done by r1 in the file, by r0 in the problem",
    ),
    "a task too short": (
        lambda p: [t.update(expected=0.5) for t in tasks(p) if t["activity"] == "wash_r0"],
        "the task 'wash_r0' lasts 0.5 s in the file",
    ),
    "a task missing": (lambda p: tasks(p).pop(), "times among the tasks"),
    "a choice that is none": (swapped, "the choice '.' is none that the problem leaves"),
    "motions far away": (far, "begins at|far from the map"),
    "a leap": (leap, "faster than it can drive|far from the map"),
}


def test_the_graph_is_valid_as_it_is_written(site, full):
    assert dependency_faults(site.problem, full) == []
    kinds = {e["kind"] for e in edges(full)}
    assert kinds >= {"fluent", "constraint", "duration", "meeting"}
    assert full["dependencies"]["choices"]


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_named(site, full, name):
    spoil, said = BROKEN[name]
    plan = copy.deepcopy(full)
    spoil(plan)
    assert re.search(said, "\n".join(dependency_faults(site.problem, plan))), name


BY_ITSELF = (
    "all edges removed", "nobody lets pass", "a meeting turned round", "a lag of -100", "no lag",
    "an edge of nobody", "an edge of no event", "a motion that is none", "beyond the path",
    "a gate too late", "an unknown kind", "a cycle", "progress all 0", "progress backwards",
    "no progress", "a task missing", "motions far away", "a leap",
)  # fmt: skip
"""What is seen without the problem."""


@pytest.mark.parametrize("name", BY_ITSELF)
def test_without_the_problem_what_the_motions_need_is_asked_for(full, name, tmp_path):
    plan = copy.deepcopy(full)
    BROKEN[name][0](plan)
    with pytest.raises(ProblemError, match=r"cannot be followed|cycle"):
        dependencies_from_plan(plan)
    with pytest.raises(ProblemError, match=r"cannot be followed|cycle"):
        export_plan(plan, "vda5050", tmp_path)


def test_commands_refuse_what_is_broken(full, yaml, tmp_path, capsys):
    script = tmp_path / "crossing.py"
    here = [str(Path(__file__).parents[2])]
    script.write_text(
        f"import sys\nsys.path[:0] = {here}\n"
        "from tests.execution.test_broken_graphs import written\n"
        f"problem = written({str(yaml)!r}).problem\n"
    )
    good = str(write_plan(tmp_path / "good.json", full))
    problem = ["--problem", str(script)]
    assert main(["validate", str(script), good]) == 0
    assert main(["export", good, "--to", "vda5050", "--out", str(tmp_path / "o"), *problem]) == 0
    assert main(["simulate", good, "--runs", "1", "--policy", "staircase", *problem]) == 0
    capsys.readouterr()
    for name in ("all edges removed", "an edge turned round", "a lag of -100", "an edge of nobody",
                 "progress all 0", "avoid emptied", "motions far away"):  # fmt: skip
        plan = copy.deepcopy(full)
        BROKEN[name][0](plan)
        bad = str(write_plan(tmp_path / "bad.json", plan))
        assert main(["validate", str(script), bad]) == 1, name
        said = capsys.readouterr().out
        assert "INVALID" in said
        assert re.search(BROKEN[name][1], said), (name, said)
        assert main(["simulate", bad, "--runs", "1", *problem]) == 2, name
        assert main(["export", bad, "--to", "vda5050", "--out", str(tmp_path), *problem]) == 2, name
        said = capsys.readouterr().err
        assert len(re.findall(BROKEN[name][1], said)) >= 2, (name, said)


def test_where_nobody_drives_nothing_is_simulated_or_exported(full, tmp_path, capsys):
    plan = {**full, "motions": []}
    still = str(write_plan(tmp_path / "still.json", plan))
    assert main(["simulate", still]) == 2
    for form in ("csv", "vda5050", "nav2", "mcap"):
        assert main(["export", still, "--to", form, "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("has no motions: nobody drives") == 5


def test_a_plan_of_another_problem_is_refused_by_name(yaml, full):
    other = sites.Site(yaml)
    other.robot("r0", (2.0, 2.0, 0.0))
    other.drive("alone_r0", "r0", (2.0, 2.0, 0.0), [(3.0, 0.0)], 0)
    with pytest.raises(
        ProblemError, match=r"is not the plan's problem: it has no activity 'in_r0'"
    ):
        dependency_faults(other.problem, full)


@pytest.mark.parametrize("key", ["v_max", "a_max", "turning_radius"])
def test_a_robot_without_a_limit_is_named(full, key):
    plan = copy.deepcopy(full)
    del plan["objects"][0][key]
    with pytest.raises(ProblemError, match=f"'r0' lacks '{key}'"):
        dependencies_from_plan(plan)
