"""Hunt for invalid plans, false proofs, exceptions and leftovers among random problems.

    python benchmarks/reliability/fuzz.py --first 0 --count 1000 --out fuzz.json

Prints a table over engines; every finding is printed with its seed, which makes it again. A run is
resumed where its output file ended.
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
from tests.fuzz.attack import attack
from tests.fuzz.problems import random_case

warnings.simplefilter("ignore")


def run(args: argparse.Namespace) -> list[dict]:
    rows = json.loads(args.out.read_text()) if args.out.exists() else []
    known = {(r["seed"], r["engine"]) for r in rows}
    stop = time.monotonic() + args.minutes * 60
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        tempfile.tempdir = os.environ["TMPDIR"] = folder  # so that what is left behind is ours
        for seed in range(args.first, args.first + args.count):
            engine = args.engines[seed % len(args.engines)]
            if (seed, engine) in known:
                continue
            if time.monotonic() > stop:
                break
            case = random_case(seed)
            found = attack(case, Path(folder), engine=engine, timeout=args.timeout)
            row = asdict(found) | {"style": asdict(case.style), "robots": len(case.robots)}
            rows.append(row)
            args.out.write_text(json.dumps(rows))
            for line in found.wrong:
                print(f"seed {seed} {engine}: {line}", flush=True)
            for line in found.faster:
                print(f"seed {seed} {engine}: (another seed is faster) {line}", flush=True)
    return rows


def report(rows: list[dict]) -> None:
    print(
        "| engine | problems | statuses | attacked | attacks | wrong | faster by seed | s | late |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for engine in sorted({r["engine"] for r in rows}):
        own = [r for r in rows if r["engine"] == engine]
        statuses = Counter(r["status"].lower() for r in own)
        told = ", ".join(f"{n} {s}" for s, n in statuses.most_common())
        print(
            f"| {engine} | {len(own)} | {told} | {sum(r['attacks'] > 0 for r in own)} | "
            f"{sum(r['attacks'] for r in own)} | {sum(bool(r['wrong']) for r in own)} | "
            f"{sum(bool(r['faster']) for r in own)} | "
            f"{statistics.median(r['seconds'] for r in own):.1f} | "
            f"{max(0.0, *(r['overrun'] for r in own), 0.0):.1f} |"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--timeout", type=float, default=10.0)
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--engines", nargs="+", default=["cpsat", "aries", "cpsat", "aries-opt"])
    parser.add_argument("--out", type=Path, default=Path("fuzz.json"))
    rows = run(parser.parse_args())
    report(rows)
    return 1 if any(r["wrong"] for r in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
