"""What the pages on problems say is run, as they say it."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from up_samp.cli import main
from up_samp.fleet import Fleet, read_problem_file
from up_samp.fleet.batteries import Meter
from up_samp.fleet.files import write_starter
from up_samp.fleet.records import FleetRecords, Order, Task

ROOT = Path(__file__).parents[2]
FLEET = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
ORDERS = (ROOT / "docs" / "orders.md").read_text(encoding="utf-8")
FORMAT = (ROOT / "docs" / "problem-format.md").read_text(encoding="utf-8")


def blocks(language, text):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


@pytest.mark.long
def test_the_commands_and_snippets_of_the_guide(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    commands = [line[2:] for b in blocks("console", FLEET) for line in b.splitlines()]
    assert len(commands) == 4
    for command in commands:
        program, *arguments = shlex.split(command)
        assert program == "up-samp"
        assert main(arguments) == ("unsolvable" in command)
    out = capsys.readouterr().out
    for line in blocks("text", FLEET)[0].splitlines():
        assert line in out
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(blocks("python", FLEET))],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "only once door 'gate' is open" in done.stdout
    assert (tmp_path / "map.png").stat().st_size > 1000
    assert (tmp_path / "hall" / "map.yaml").is_file()
    assert Fleet.from_file(tmp_path / "mysite" / "mine.yaml").records.orders[0].id == "o1"


def test_the_snippets_on_orders_make_one_problem(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # how far robots drive, and past which doors, is not what is looked at
    monkeypatch.setattr(Meter, "_way", lambda *_: None)
    write_starter(tmp_path / "mysite")
    scope = {}
    exec("\n".join(blocks("python", ORDERS)), scope)
    fleet = scope["fleet"]
    assert len(fleet.records.orders) == 10
    assert {a.name for a in fleet.problem.activities} >= {
        "pick_pallet_r1",
        "open_gate_r1",
        "cut_saw1",
    }
    assert "carry_beam_o2_bench_to_truck_with_o1" in {
        a.name for a in scope["yard"].problem.activities
    }


@pytest.mark.long
def test_the_file_of_the_format_page_is_read_and_has_a_plan(tmp_path):
    write_starter(tmp_path)
    text = blocks("yaml", FORMAT)[0]
    file = tmp_path / "plant.yaml"
    file.write_text(text)
    records = read_problem_file(file)
    assert records.name == "plant"
    assert set(yaml.safe_load(text)) == set(FleetRecords.__dataclass_fields__)
    result = Fleet.from_file(file).solve(timeout=120, first_plan=True)
    assert result.plan is not None, result.explain()


@pytest.mark.parametrize("record", [FleetRecords, Order, Task])
def test_all_keys_are_in_the_page(record):
    for key in record.__dataclass_fields__:
        assert f"`{key}`" in FORMAT, key
