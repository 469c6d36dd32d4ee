"""Write docs/tuning.md from the class that it is about, and from what ``scripts/sweep.py`` has
found out: ``python scripts/tuning.py``.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path
from typing import Any

from up_samp.tuning import Tuning

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "tuning.md"
SWEEP = ROOT / "benchmarks" / "figures" / "sweep.json"
INTRO = """# Tuning

Made by `python scripts/tuning.py` from `up_samp/tuning.py` and from what
`python scripts/sweep.py` has kept in `benchmarks/figures/sweep.json`.

These numbers decide how hard something is tried: efforts, shares of the time, sizes up to which a
stage is worth it. None of them changes what a plan or a proof means; with other values a search
takes longer, or finds less. The defaults were chosen by trials on the package's own families. The
last column says what a quarter of the default and four times as much (a share: nearer to 0 or 1)
change in short cases that read it: the first thing that gets worse or better by 1 % (CPU: 30 %), or
that nothing does in the runs that were made. What no case shows to matter is on its way to become a
constant beside its use.

A TOML file names what it changes; the rest stays as it is:

```toml
stale = 4000
knots = [80000, 300000]
```

```sh
up-samp solve PROBLEM --tuning mine.toml
up-samp bench run paper --tuning mine.toml other.toml --out runs   # the defaults, and each file
```

From Python: `params={"tuning": "mine.toml"}`, a dictionary, or a `up_samp.tuning.Tuning`;
engines `samp-refine[...]` and `cpsat` take it.
A name that is unknown is an error, with the nearest known one; so is a value that makes no sense.
"""


def shown(value: object) -> str:
    """Return a value as TOML has it."""
    if isinstance(value, tuple):
        return "[" + ", ".join(map(shown, value)) + "]"
    return f"{value:g}" if isinstance(value, float) and value != int(value) else str(value)


def bounds(about: Any) -> str:
    """Return which values make sense."""
    low, high = about["least"], about["most"]
    return f"{low:g} or more" if high == math.inf else f"{low:g} to {high:g}"


def told(swept: dict[str, Any], name: str) -> str:
    """Return what a sweep shows of a tunable."""
    if name not in swept:
        return "not tried yet"
    found = swept[name]
    if not found["cases"]:
        return "no case reads it"
    if not found["matters"]:
        return f"nothing in {found['runs']} runs"
    where, what = list(found["shown"].items())[-1]
    factor, _, case = where.partition(" ")
    return f"{factor}, {case}: {'; '.join(what)}"


def page() -> str:
    """Return the page."""
    swept = json.loads(SWEEP.read_text(encoding="utf-8"))["tried"]
    lines = [INTRO]
    lines += ["| name | default | unit | what | read in | values | what a sweep shows |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for field in dataclasses.fields(Tuning):
        about = field.metadata
        lines.append(
            f"| `{field.name}` | {shown(field.default)} | {about['unit']} | {about['what']} "
            f"| `{about['room']}` | {bounds(about)} | {told(swept, field.name)} |"
        )
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0)
