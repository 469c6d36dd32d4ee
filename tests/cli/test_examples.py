"""Every example solves, as its docstring says."""

import json
from pathlib import Path

import pytest

from up_samp.cli import main

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda f: f.stem)
def test_the_example_has_a_valid_plan(example, tmp_path, capsys):
    assert f"up-samp solve examples/{example.name}" in example.read_text(encoding="utf-8")
    assert main(["solve", str(example), "--out", str(tmp_path), "--no-gif"]) == 0
    assert "valid: the independent validator found nothing wrong" in capsys.readouterr().out
    plan = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    assert plan["makespan"] >= 1
    assert (tmp_path / "animation.html").exists()


def test_there_are_examples():
    assert {e.stem for e in EXAMPLES} >= {"door", "drones", "swap"}
