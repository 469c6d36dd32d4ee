"""Write docs/tuning.md from the classes that it is about: ``python scripts/tuning.py``."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

from up_samp.tuning import Tuning

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "tuning.md"
INTRO = """# Tuning

Made by `python scripts/tuning.py` from the classes in `up_samp/*/**/*tuning.py`.

These numbers decide how hard something is tried: efforts, shares of the time, sizes up to which a
stage is worth it. None of them changes what a plan or a proof means; with other values a search
takes longer, or finds less. The defaults were chosen by trials on the package's own families,
unless the last column says otherwise.

A TOML file names what it changes; the rest stays as it is:

```toml
[search.repair]
steps = 40

[cpsat.stages]
one_thread = [0.1, 1.0]
```

```sh
up-samp solve PROBLEM --tuning mine.toml
up-samp simulate plan.json --tuning mine.toml
up-samp bench run paper --tuning mine.toml other.toml --out runs   # the defaults, and each file
```

From Python: `params={"tuning": "mine.toml"}`, a nested dictionary, or a `up_samp.tuning.Tuning`;
engines `samp-refine[...]` and `cpsat` take it; `Executor` and `simulate` take its part `execution`.
A name that is unknown is an error, with the nearest known one; so is a value that makes no sense.
"""


def shown(value: object) -> str:
    """Return a value as TOML has it."""
    if isinstance(value, tuple):
        return "[" + ", ".join(map(shown, value)) + "]"
    return f"{value:g}" if isinstance(value, float) and value != int(value) else str(value)


def bounds(told: Any) -> str:
    """Return which values make sense."""
    low, high = told["least"], told["most"]
    if low is None and high is None:
        return "any"
    if high is None:
        return f"{low:g} or more"
    return f"{low:g} to {high:g}" if low is not None else f"{high:g} or less"


def page() -> str:
    """Return the page."""
    lines = [INTRO]
    for path, part in Tuning().walk():
        what = " ".join((type(part).__doc__ or "").split()).replace("``", "`")
        lines += [f"## {path}", "", what, ""]
        lines += ["| name | default | unit | what | values | source |", "|---|---|---|---|---|---|"]
        for field in dataclasses.fields(part):
            told = field.metadata
            value = shown(getattr(part, field.name))
            lines.append(
                f"| `{field.name}` | {value} | {told['unit']} | {told['what']} | {bounds(told)} "
                f"| {told['source']} |"
            )
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0)
