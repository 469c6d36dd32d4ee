"""Unified Planning's own engine report (``up_test_cases/report.py``) with our engines registered.

    python benchmarks/scheduling/up_report.py cpsat "samp-refine[cpsat]" "samp-refine[aries]" \
        samp-validator -p unified_planning.test -f sched -m oneshot anytime validation -t 10

Arguments are those of the report; it exits with 1 if there is any error.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import up_test_cases

import up_samp  # noqa: F401  (registers the engines)


def main() -> None:
    """Run the report with this program's arguments."""
    script = Path(up_test_cases.__file__).with_name("report.py")
    sys.path.insert(0, str(script.parent))  # it imports its neighbours
    sys.argv[0] = str(script)
    runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    main()
