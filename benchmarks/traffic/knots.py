"""Tight places: who gets everybody through, how fast, and how well.

Each case of ``up_samp/benchmarks/tight_places.py`` for each body for which it makes sense. CPU
seconds of one call in a warm process (kernels compiled); arrivals over the sum of everybody's
arrival alone. Every answer is judged by the independent validator's swept checks and limits.

    python benchmarks/traffic/knots.py [--cases pocket corner] [--bodies omni] [--seconds 60]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path as Folder

from up_samp.benchmarks import tight_places as tight
from up_samp.model import Deadline, Outcome
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.workspace import workspace_of
from up_samp.motion.service import MotionService

sys.path.insert(0, str(Folder(__file__).parents[2] / "tests" / "spacetime"))
from independent import judge


def alone(traffic) -> float:
    """Sum of arrivals (s) if nobody met anybody."""
    workspace = workspace_of(MotionService(traffic.grid))
    total = 0.0
    for m in traffic.query.motions:
        path = workspace.path(m.body, m.poses, (), Deadline.after(60))
        total += path.natural.duration if isinstance(path, Path) else float("nan")
    return total


def measured(traffic, seconds: float) -> tuple[str, float, float | None]:
    """Outcome, CPU seconds, and the sum of arrivals if everybody gets through."""
    service = MotionService(traffic.grid)
    began = time.process_time()
    report = coordinate(service, traffic.query, Deadline.after(seconds))
    cpu = time.process_time() - began
    if report.outcome is not Outcome.FOUND:
        return report.outcome.name, cpu, None
    with tempfile.TemporaryDirectory() as folder:
        return "FOUND", cpu, judge(traffic, report, Folder(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", nargs="*", default=list(tight.CASES))
    parser.add_argument("--bodies", nargs="*", default=list(tight.BODIES))
    parser.add_argument("--seconds", type=float, default=60.0)
    args = parser.parse_args()
    print("| case | body | outcome | CPU s | arrivals / alone |")
    print("|---|---|---|---|---|")
    for case in args.cases:
        for kind in args.bodies:
            if kind not in tight.CASES[case].bodies:
                continue
            traffic = tight.CASES[case].build(tight.BODIES[kind]())
            outcome, cpu, total = measured(traffic, args.seconds)
            ratio = "-" if total is None else f"{total / alone(traffic):.2f}"
            print(f"| {case} | {kind} | {outcome} | {cpu:.2f} | {ratio} |", flush=True)


if __name__ == "__main__":
    main()
