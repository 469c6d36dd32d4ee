"""Inject every fault as often as the table says; print what came of it as a table.

    python benchmarks/reliability/faults.py --out faults.json

Faults that were done are not done again where the output file goes on. As root, some are run on
disks of their own.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.faults.cases import FAULT_TABLE


def run(args: argparse.Namespace) -> dict[str, dict]:
    rows = json.loads(args.out.read_text()) if args.out.exists() else {}
    for fault in FAULT_TABLE:
        row = rows.setdefault(fault.name, {"runs": 0, "wrong": []})
        if args.only and args.only not in fault.name:
            continue
        folder = Path(tempfile.mkdtemp(prefix="faults-"))
        try:
            for number in range(row["runs"], round(fault.runs * args.times)):
                began = time.monotonic()
                wrong = fault.make(folder, random.Random(f"{fault.name} {number} {args.seed}"))
                row["runs"] += 1
                row["wrong"] += [f"run {number}: {line}" for line in wrong]
                args.out.write_text(json.dumps(rows, indent=1))
                print(f"{fault.name} {number}: {time.monotonic() - began:.0f} s", flush=True)
                for line in wrong:
                    print(f"  WRONG {line}", flush=True)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    return rows


def report(rows: dict[str, dict]) -> None:
    print("| fault | what is expected | runs | not so |")
    print("|---|---|---|---|")
    for fault in FAULT_TABLE:
        row = rows.get(fault.name, {"runs": 0, "wrong": []})
        bad = {line.partition(":")[0] for line in row["wrong"]}
        print(f"| {fault.name} | {fault.expected} | {row['runs']} | {len(bad)} |")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("faults.json"))
    parser.add_argument("--only", default="", help="faults whose name has this in it")
    parser.add_argument("--times", type=float, default=1.0, help="runs by this factor")
    parser.add_argument("--seed", type=int, default=0)
    rows = run(parser.parse_args())
    report(rows)
    return 1 if any(r["wrong"] for r in rows.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
