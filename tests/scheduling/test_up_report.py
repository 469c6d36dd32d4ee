"""Unified Planning's own engine report finds no error with our engines."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "scheduling" / "up_report.py"
PACKAGE = ["-p", "unified_planning.test", "-f", "sched"]
MODES = ["-m", "oneshot", "anytime", "validation"]


def report(engines, seconds):
    """Return the report's exit code, and its lines as (engine, status, verdict)."""
    command = [sys.executable, str(SCRIPT), *engines, *PACKAGE, *MODES, "-t", str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
    plain = re.sub(r"\x1b\[\d+m", "", done.stdout)
    lines = [line.split() for line in plain.splitlines() if line.startswith("|")]
    return done.returncode, [(w[1], w[2], " ".join(w[4:])) for w in lines], plain + done.stderr


def judge(engines, seconds, cases):
    code, lines, text = report(engines, seconds)
    assert code == 0, text
    for engine in engines:
        mine = [line for line in lines if line[0] == engine]
        assert len(mine) == cases[engine], text
        assert all("OK" in verdict or "WARN" in verdict for _, _, verdict in mine), text
    return lines


@pytest.mark.parametrize(
    "engines",
    [
        {"samp-refine[cpsat]": 16, "samp-validator": 7},
        pytest.param({"cpsat": 16}, marks=pytest.mark.long),
    ],
    ids=",".join,
)
def test_own_engines_have_no_error(engines):
    lines = judge([*engines], 30, engines)
    proven = [e for e, status, _ in lines if status == "SOLVED_OPTIMALLY"]
    assert len(proven) == 4  # of one engine: two modes, two problems with a metric


@pytest.mark.long
def test_aries_has_no_error_behind_its_compilers():
    judge(["samp-refine[aries]"], 30, {"samp-refine[aries]": 8})


@pytest.mark.long
def test_aries_opt_has_no_error_when_its_time_runs_out():
    lines = judge(["samp-refine[aries-opt]"], 5, {"samp-refine[aries-opt]": 8})
    assert {status for _, status, _ in lines} <= {
        "SOLVED_SATISFICING",  # problems without a metric
        "SOLVED_OPTIMALLY",
        "TIMEOUT",
    }
