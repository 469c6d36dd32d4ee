"""``up-samp solve --from PLAN --at SECONDS``: what is left of a plan, planned anew."""

import pytest

from tests.fleet.test_rules import one_room
from up_samp.cli import main
from up_samp.io import read_plan


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Return the folder with a problem file and its plan: two robots, an order each, and nobody
    in another's way.
    """
    folder = tmp_path_factory.mktemp("site")
    fleet = one_room(2)
    fleet.add_place("d", 12, 3)
    fleet.add_order("o0", "a", "d")
    fleet.add_order("o1", "b", "c")
    fleet.add_zone("slow", [(0.2, 0.2), (0.6, 0.2), (0.6, 0.6)], v_max=0.5)
    fleet.save(folder / "problem.yaml")
    assert main(["solve", str(folder / "problem.yaml"), "--first", "--out", str(folder)]) == 0
    return folder


def go_on(folder, *more):
    return main(["solve", str(folder / "problem.yaml"), "--from", str(folder / "plan.json"), *more])


def test_the_rest_begins_where_robots_stop(planned, tmp_path, capsys):
    assert go_on(planned, "--at", "8", "--first", "--out", str(tmp_path)) == 0
    said = capsys.readouterr()
    assert "valid: the independent validator" in said.out
    told = said.err.partition("s of its clock\n")[2].splitlines()
    assert [line.split()[0] for line in told if " at (" in line] == ["r0", "r1"]
    before, after = read_plan(planned / "plan.json"), read_plan(tmp_path / "plan.json")
    homes = {o["name"]: o["initial"] for o in before["objects"]}
    here = {o["name"]: o["initial"] for o in after["objects"]}
    assert any(here[name] != homes[name] for name in homes)
    assert after["makespan"] <= before["makespan"] - 3


def test_who_is_out_of_order_does_nothing_more(planned, tmp_path):
    assert go_on(planned, "--at", "0", "--broken", "r1", "--first", "--out", str(tmp_path)) == 0
    rest = read_plan(tmp_path / "plan.json")
    assert {m["object"] for m in rest["motions"]} == {"r0"}
    assert sum(a["name"].startswith("deliver_") for a in rest["activities"]) == 2


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ((), "--from needs a time"),
        (("--at", "nan"), "--at nan: give seconds"),
        (("--at", "1e6"), "nothing is left at 1e+06 s"),
        (("--at", "3", "--broken", "r9"), "'r9' cannot break down"),
        (("--at", "3", "--cancel", "x"), "cancelled 'x' is no activity"),
        (("--at", "3", "--margin", "0.1"), "keeps the plan's unit of time and its margin"),
    ],
)
def test_mistakes_are_named(planned, capsys, more, said):
    assert go_on(planned, *more) != 0
    assert said in capsys.readouterr().err


def test_a_time_without_a_plan_is_a_mistake(planned, capsys):
    assert main(["solve", str(planned / "problem.yaml"), "--at", "3"]) != 0
    assert "--at speaks of a plan" in capsys.readouterr().err
