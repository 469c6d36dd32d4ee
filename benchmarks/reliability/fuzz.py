"""Hunt for invalid plans, false proofs, exceptions, lateness and leftovers among random problems.

    python benchmarks/reliability/fuzz.py --first 0 --count 1000 --out fuzz.json
    python benchmarks/reliability/fuzz.py --merge fuzz.json more.json

Every finding is printed with its seed, which makes it again. A run goes on where its output file
ended. ``--merge`` makes one table of several files.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import up_samp  # noqa: F401  (registers the engines)
from tests.faults.watch import Watch
from tests.fuzz.attack import ATTACKERS, Findings, attack
from tests.fuzz.problems import random_case
from tests.fuzz.wide import wide_case
from tests.soundness import decisions, judge, worlds
from tests.soundness.test_decisions import judge as judge_decisions
from up_samp.model import MotionModel
from up_samp.motion.compile import precompile
from up_samp.search.params import ABLATIONS
from up_samp.system.files import write_whole

warnings.simplefilter("ignore")
ENGINES = ("cpsat", "aries", "cpsat", "aries-opt", "cpsat")
PRESETS = ("default",) * 12 + ("paper", "sequential", *ABLATIONS)
"""For the package's own scheduler; others run the default preset."""
SORTS = ("wide",) * 8 + ("decisions", "coarse")
"""``wide`` and ``first`` are attacked by other engines, seeds and parameters; ``decisions`` with
every choice of values made; ``coarse`` by an exhaustive search of a coarse model.
"""


def run(args: argparse.Namespace) -> list[dict]:
    rows = json.loads(args.out.read_text()) if args.out.exists() else []
    known = {r["seed"] for r in rows}
    stop = time.monotonic() + args.minutes * 60
    precompile(MotionModel)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        tempfile.tempdir = os.environ["TMPDIR"] = folder  # so that what is left behind is ours
        here = Path(folder) / "maps"
        here.mkdir()
        for seed in range(args.first, args.first + args.count):
            if time.monotonic() > stop:
                break
            if seed in known:
                continue
            row = one(seed, here, args)
            rows.append(row)
            write_whole(args.out, json.dumps(rows))
            for line in row["wrong"]:
                print(f"seed {seed} {row['sort']} {row['engine']}: {line}", flush=True)
            for line in row["faster"]:
                print(f"seed {seed} {row['engine']}: (another seed is faster) {line}", flush=True)
            if row.get("refused"):
                print(f"seed {seed} {row['engine']}: (refused) {row['refused']}", flush=True)
    return rows


def one(seed: int, folder: Path, args: argparse.Namespace) -> dict:
    """Return the row of a seed."""
    sort = args.sorts[seed % len(args.sorts)]
    engine = args.engines[seed % len(args.engines)]
    if sort in ("decisions", "coarse"):
        return _against_truth(seed, sort, folder)
    case = random_case(seed) if sort == "first" else wide_case(seed, args.maps)
    preset = PRESETS[seed // 7 % len(PRESETS)] if engine == "cpsat" else "default"
    attackers = [ATTACKERS[(seed + k) % len(ATTACKERS)] for k in range(args.attacks)]
    found = attack(
        case, folder, engine=engine, timeout=args.timeout, attackers=attackers, preset=preset
    )
    return asdict(found) | {
        "sort": sort,
        "style": asdict(case.style),
        "robots": len(case.robots),
        "bodies": sorted({r.moves for r in case.robots}),
        "map": case.floor.kind,
        "loads": len(case.loads),
    }


def _against_truth(seed: int, sort: str, folder: Path) -> dict:
    """Hold a small world against all of its decisions, or against a coarse exhaustive search."""
    found, watch = Findings(seed, "cpsat"), Watch()
    rooms = worlds.write_rooms(folder)
    if sort == "decisions":
        found.engine = "aries-opt" if seed % 3 == 0 else "cpsat"
        verdict = judge_decisions(decisions.random_world(seed), rooms, found.engine)
        found.status, found.makespan = verdict.status, verdict.makespan
        found.wrong, found.attacks = list(verdict.wrong), verdict.attacks
    else:
        told = judge.judge(worlds.random_world(seed), rooms, samples=10, seconds=4.0)
        found.status, found.makespan = told.status, told.makespan
        found.wrong, found.attacks = told.wrong + told.motion, told.plans
    found.seconds = watch.seconds
    return asdict(found) | {"sort": sort}


HEAD = (
    "problems",
    "statuses",
    "attacked",
    "attacks",
    "plans accepted",
    "wrong",
    "faster by seed",
    "late",
    "s",
)


def report(rows: list[dict]) -> None:
    """Print what came of the rows: by engine, and how often what was tried."""
    for row in rows:
        row.setdefault("sort", "first")
        row.setdefault("preset", "default")
        row.setdefault("accepted", 0)
    titles = {"wide": "", "first": "", "decisions": ", all decisions", "coarse": ", coarse search"}
    groups: dict[str, list[dict]] = {}
    for row in rows:
        groups.setdefault(row["engine"] + titles[row["sort"]], []).append(row)
    print("| engine | " + " | ".join(HEAD) + " |")
    print("|---" * (len(HEAD) + 1) + "|")
    for name in sorted(groups):
        print(f"| {name} | " + " | ".join(map(str, _line(groups[name]))) + " |")
    print(f"| all | {' | '.join(map(str, _line(rows)))} |")
    print()
    for key, told in (("preset", "presets"), ("map", "maps"), ("robots", "robots")):
        counts = Counter(str(r[key]) for r in rows if key in r)
        print(f"{told}: " + ", ".join(f"{n} {c}" for n, c in counts.most_common()))
    bodies = Counter(b for r in rows for b in r.get("bodies", ()))
    print("bodies: " + ", ".join(f"{n} {c}" for n, c in bodies.most_common()))
    for name in sorted({k for r in rows for k in r.get("style", {})}):
        counts = Counter(str(r["style"][name]) for r in rows if name in r.get("style", {}))
        print(f"{name}: " + ", ".join(f"{n} {c}" for n, c in counts.most_common()))


def _line(rows: list[dict]) -> tuple:
    statuses = Counter(_status(r) for r in rows)
    return (
        len(rows),
        ", ".join(f"{n} {s}" for s, n in statuses.most_common()),
        sum(r["attacks"] > 0 for r in rows),
        sum(r["attacks"] for r in rows),
        sum(r.get("accepted", 0) for r in rows),
        sum(any("late by" not in w for w in r["wrong"]) for r in rows),
        sum(bool(r["faster"]) for r in rows),
        sum(any("late by" in w for w in r["wrong"]) for r in rows),
        f"{statistics.median(r['seconds'] for r in rows):.1f}",
    )


def _status(row: dict) -> str:
    if not row["status"]:
        return "refused" if row.get("refused") else "exception"
    return row["status"].lower().replace("solved_", "").replace("_", " ").replace("ally", "al")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--timeout", type=float, default=10.0)
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--engines", nargs="+", default=list(ENGINES))
    parser.add_argument("--sorts", nargs="+", default=list(SORTS), choices=[*SORTS, "first"])
    parser.add_argument(
        "--attacks", type=int, default=len(ATTACKERS), help="for each proof, taken in turn"
    )
    parser.add_argument("--maps", type=Path, help="folder with ROS maps to be drawn from, too")
    parser.add_argument("--out", type=Path, default=Path("fuzz.json"))
    parser.add_argument("--merge", type=Path, nargs="+", help="only report on these files")
    args = parser.parse_args()
    args.maps = tuple(sorted(map(str, args.maps.rglob("*.yaml")))) if args.maps else ()
    if args.merge:
        rows = [r for file in args.merge for r in json.loads(file.read_text())]
    else:
        rows = run(args)
    report(rows)
    return 1 if any(r["wrong"] for r in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
