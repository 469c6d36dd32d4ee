"""Tests stand beside the room that they test, and what is said of rooms is there."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
WHOLE = {"docs", "extensions", "faults", "fuzz", "hostile", "metamorphic", "oracles", "soundness"}
"""Folders of tests/ that are about the whole package, told in CONTRIBUTING.md."""


def folders(top):
    return {p.parent.relative_to(ROOT / top) for p in (ROOT / top).rglob("*.py")}


def test_every_folder_of_tests_has_its_room():
    rooms = folders("up_samp")
    strange = {f for f in folders("tests") if f not in rooms and f.parts[0] not in WHOLE}
    assert not strange, "no room of up_samp/ is called so"
    told = (ROOT / "CONTRIBUTING.md").read_text()
    assert all(f"`{name}`" in told for name in WHOLE)


def test_every_folder_of_tests_is_a_package():
    missing = [f for f in folders("tests") if not (ROOT / "tests" / f / "__init__.py").exists()]
    assert not missing, "its modules would be found under two names"


def test_rooms_are_told_file_by_file():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    _, _, rooms = page.partition("## The rooms")
    rooms, _, _ = rooms.partition("## Where is")
    for part in rooms.split("\n### ")[1:]:
        room = part.partition("`: ")[0].removeprefix("`")
        told = re.findall(r"^\| `(\w+\.py)` \|", part, re.MULTILINE)
        there = {p.name for p in (ROOT / "up_samp" / room).glob("*.py")}
        assert sorted(told) == sorted(there - {"__init__.py", "tuning.py"}), room


def test_packages_are_told():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table, _, _ = page.partition("## A solve")
    there = {p.parent.name for p in (ROOT / "up_samp").glob("*/__init__.py")}
    assert {name for name in there if f"`{name}`" not in table} == set()


def check(*arguments):
    command = [sys.executable, str(ROOT / "scripts" / "check.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_rooms_that_are_called_fast_are_there():
    tree = ast.parse((ROOT / "scripts" / "check.py").read_text())
    values = {ast.unparse(n.targets[0]): n.value for n in tree.body if isinstance(n, ast.Assign)}
    fast = ast.literal_eval(values["FAST"])
    assert all(any((ROOT / "tests" / name).glob("test_*.py")) for name in fast)


def test_a_room_that_is_not_there_is_told():
    done = check("room", "nowhere")
    assert done.returncode == 1
    assert "tests/nowhere" in done.stderr


def test_a_room_of_the_package_has_its_tests_run():
    assert (
        "no tests ran" in check("room", "up_samp/refinement", "-k", "nothing_is_called_so").stdout
    )


def test_workflows_call_what_is_there():
    ci = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    assert {"lint", "test", "docs", "wheels"} == set(ci["jobs"])
    versions = ci["jobs"]["test"]["strategy"]["matrix"]["python-version"]
    asked = (ROOT / "pyproject.toml").read_text()
    assert all(f"Programming Language :: Python :: {v}" in asked for v in versions)
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    bin_folder = Path(sys.executable).parent
    assert all((bin_folder / hook["entry"].split()[0]).exists() for hook in hooks)
