"""Run every check: lint, format, types, layers, tests. Stops at the first that fails.

Extra arguments go to pytest (``python scripts/check.py --long``).
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def tool(name: str) -> str:
    """Return a command that was installed beside this Python."""
    return str(Path(sys.executable).parent / name)


CHECKS = (
    [tool("ruff"), "check", "."],
    [tool("ruff"), "format", "--check", "."],
    [tool("mypy"), "-p", "up_samp"],
    [tool("lint-imports")],
    # the service starts limited processes: what other tests leave behind must not reach them
    [sys.executable, "-m", "pytest", "-n", "2", "-q", "tests/server", *sys.argv[1:]],
    [sys.executable, "-m", "pytest", "-n", "2", "-q", "--ignore=tests/server", *sys.argv[1:]],
)


def main() -> int:
    """Run the checks; return the first exit code that is not 0."""
    for command in CHECKS:
        print("$", Path(command[0]).name, *command[1:], flush=True)
        code = subprocess.run(command, cwd=ROOT, check=False).returncode
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
