"""Show the validator and ``up-samp validate`` good plans: none may be refused.

    python benchmarks/reliability/good_plans.py --count 1000 --out good.json

Plans are schedules of small random worlds (two robots, rooms, a door; cars and omnidirectional
bodies), drawn at random from all that an exhaustive search finds, with trajectories of the motion
layer: most are far from optimal, and wait, take turns or drive at once. A run goes on where its
output file ended.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.soundness import worlds
from tests.soundness.coarse import Coarse
from up_samp.cli import commands
from up_samp.cli import main as command
from up_samp.io import plan_to_dict, write_plan
from up_samp.model import CandidateSchedule
from up_samp.system.files import write_whole
from up_samp.upio import build_plan
from up_samp.validation import validate_plan

HORIZON = 8
"""Units that a schedule may take."""


def judged(seed: int, folder: Path, count: int, seconds: float = 6.0) -> dict:
    """Judge up to ``count`` plans of a world; return how many, and what was said against any."""
    rooms = worlds.write_rooms(folder)
    world = worlds.random_world(seed)
    problem = worlds.build(world, rooms)
    coarse = Coarse(world, worlds.build(world, rooms))
    row: dict = {"seed": seed, "plans": 0, "refused": []}
    for times, trajectories in coarse.sample(HORIZON, count, seconds):
        plan = build_plan(problem, coarse.snapshot, CandidateSchedule(times), trajectories)
        row["plans"] += 1
        verdict = validate_plan(problem, plan, seconds_per_unit=worlds.SECONDS)
        if not verdict.valid:
            row["refused"].append(f"{times}: {verdict.violations[0]}")
            continue
        said = asked(problem, plan, folder)
        if said:
            row["refused"].append(f"{times}: up-samp validate: {said}")
    return row


def asked(problem, plan, folder: Path) -> str:
    """Return what ``up-samp validate`` says against the file of a plan, "" if it accepts it."""
    data = plan_to_dict(problem, plan, seconds_per_unit=worlds.SECONDS)
    file = write_plan(folder / "plan.json", data)
    said = io.StringIO()
    with (
        mock.patch.object(commands, "problem_of_plan", return_value=problem),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        code = command(["validate", "problem.py", str(file)])
    return "" if code == 0 else said.getvalue() or f"exit code {code}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--each", type=int, default=30, help="plans of a world at most")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("good.json"))
    args = parser.parse_args()
    rows = json.loads(args.out.read_text()) if args.out.exists() else []
    seed = max((r["seed"] + 1 for r in rows), default=args.first)
    with tempfile.TemporaryDirectory(prefix="good-") as folder:
        while sum(r["plans"] for r in rows) < args.count:
            rows.append(judged(seed, Path(folder), args.each))
            write_whole(args.out, json.dumps(rows))
            for line in rows[-1]["refused"]:
                print(f"world {seed}: {line}", flush=True)
            seed += 1
    refused = sum(len(r["refused"]) for r in rows)
    plans = sum(r["plans"] for r in rows)
    worlds_with = sum(r["plans"] > 0 for r in rows)
    print(f"{plans} plans of {worlds_with} worlds, {refused} refused")
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
