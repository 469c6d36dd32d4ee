"""The scripts of measurements start: each tells its options."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = [
    str(p.relative_to(ROOT))
    for p in sorted(ROOT.glob("benchmarks/*/*.py"))
    if "argparse" in p.read_text(encoding="utf-8")
]


def test_there_are_scripts():
    assert len(SCRIPTS) >= 5


@pytest.mark.long
@pytest.mark.parametrize("script", SCRIPTS)
def test_it_tells_its_options(script):
    command = [sys.executable, script, "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "usage:" in done.stdout
