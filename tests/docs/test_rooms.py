"""Tests stand beside the room that they test, and what is said of rooms is there."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
WHOLE = {
    "docs", "extensions", "faults", "fuzz", "hostile", "metamorphic", "oracles", "ros", "soundness",
}  # fmt: skip
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
        assert sorted(told) == sorted(there - {"__init__.py"}), room


def test_packages_are_told():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table, _, _ = page.partition("## A solve")
    there = {p.parent.name for p in (ROOT / "up_samp").glob("*/__init__.py")}
    assert {name for name in there if f"`{name}`" not in table} == set()


@pytest.fixture(scope="module")
def check():
    spec = importlib.util.spec_from_file_location("check", ROOT / "scripts" / "check.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_rooms_that_are_called_fast_are_there(check):
    assert all(any((ROOT / "tests" / name).glob("test_*.py")) for name in check.FAST)


def test_a_room_that_is_not_there_is_told(check):
    with pytest.raises(SystemExit, match="tests/nowhere"):
        check.commands(["room", "nowhere"])


def test_a_room_of_the_package_has_its_tests_run(check):
    (command,) = check.commands(["room", "up_samp/refinement", "-k", "name"])
    assert command[1:3] == ["-m", "pytest"]
    assert command[-3:] == [str(Path("tests", "refinement")), "-k", "name"]


def test_workflows_call_what_is_there():
    ci = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    assert {"lint", "test", "docs", "wheels"} == set(ci["jobs"])
    versions = ci["jobs"]["test"]["strategy"]["matrix"]["python-version"]
    asked = (ROOT / "pyproject.toml").read_text()
    assert all(f"Programming Language :: Python :: {v}" in asked for v in versions)
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    bin_folder = Path(sys.executable).parent
    assert all((bin_folder / hook["entry"].split()[0]).exists() for hook in hooks)
