"""What the README says is run, as it says it."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from up_samp.cli import main

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def blocks(language, text=README):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


COMMANDS = [line[2:] for block in blocks("console") for line in block.splitlines()]


def test_there_are_exactly_two_set_up_lines_and_all_agree():
    demo, test = (block.strip() for block in blocks("sh"))
    assert "\n" not in demo + test
    assert (ROOT / ".ci" / "run").read_text().splitlines()[-1] == test
    makefile = (ROOT / "Makefile").read_text().replace("$(VENV)", ".venv")
    for line in (demo, test):
        for step in line.split(" && "):
            assert step.replace("python3 -m", "$(PYTHON) -m") in makefile
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_the_snippets_run(tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "\n".join(blocks("python"))],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("SOLVED_")
    assert "leaves at" in done.stdout
    for name in ("plan.json", "gantt.png", "map.png", "animation.html"):
        assert (tmp_path / name).stat().st_size > 1000


@pytest.mark.long
def test_the_commands_run(tmp_path, monkeypatch, capsys):
    assert len(COMMANDS) >= 5
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for command in COMMANDS:
        program, *arguments = shlex.split(command)
        assert program == "up-samp"
        assert main(arguments) == 0, (command, capsys.readouterr())


def test_up_ini_makes_the_engines_known(tmp_path):
    (tmp_path / "up.ini").write_text(blocks("ini")[0])
    script = (
        "from unified_planning.shortcuts import *\n"
        "assert 'up_samp' not in open(__file__).read().replace(\"'up_samp'\", '')\n"
        "names = get_environment().factory.engines\n"
        "print(*[n for n in names if n in "
        "('cpsat', 'samp-validator', 'samp-refine[aries]', 'samp-refine[cpsat]')])\n"
    )
    (tmp_path / "script.py").write_text(script)
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert sorted(done.stdout.split()) == [
        "cpsat", "samp-refine[aries]", "samp-refine[cpsat]", "samp-validator",
    ]  # fmt: skip


def test_links_lead_somewhere():
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "CONTRIBUTING.md"):
        for target in re.findall(r"\]\(([^)#]+?)\)", page.read_text()):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_files_named_in_the_docs_exist():
    text = (ROOT / "docs" / "architecture.md").read_text()
    named = re.findall(r"`((?:[a-z_]+/)+(?:[a-z_]+\.py)?)", text)
    missing = [n for n in named if not ((ROOT / "up_samp" / n).exists() or (ROOT / n).exists())]
    assert not missing
