"""The table of a run: what was tried, and what came of it."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator

HEAD = (
    "problems",
    "statuses",
    "attacked",
    "attacks",
    "plans accepted",
    "wrong",
    "faster motions",
    "late",
    "s",
)
TITLES = {"decisions": ", all decisions", "coarse": ", coarse search", "small": ", small"}


def report(rows: list[dict]) -> Iterator[str]:
    """Yield lines that tell what came of the rows: by engine, and how often what was tried."""
    for row in rows:
        row.setdefault("sort", "first")
        row.setdefault("preset", "default")
        row.setdefault("accepted", 0)
        if isinstance(row.get("loads"), int):
            row["loads"] = ["ahead ride"] * row["loads"]
    groups: dict[str, list[dict]] = {}
    for row in rows:
        groups.setdefault(row["engine"] + TITLES.get(row["sort"], ""), []).append(row)
    yield f"| engine | {' | '.join(HEAD)} |"
    yield "|---" * (len(HEAD) + 1) + "|"
    for name in sorted(groups):
        yield f"| {name} | {' | '.join(map(str, _line(groups[name])))} |"
    yield f"| all | {' | '.join(map(str, _line(rows)))} |"
    yield ""
    yield from _by_size(rows)
    yield ""
    for key in ("preset", "map", "robots", "jobs"):
        yield _counted(key, [r[key] for r in rows if key in r])
    yield _counted("bodies", [b for r in rows for b in r.get("bodies", ())])
    yield _counted("loads", [x for r in rows for x in r.get("loads", ())])
    yield _counted("attackers", [x for r in rows for x in r.get("attackers", ())])
    for name in sorted({k for r in rows for k in r.get("style", {})}):
        yield _counted(name, [r["style"][name] for r in rows if name in r.get("style", {})])


def _by_size(rows: list[dict]) -> Iterator[str]:
    """Yield a table by the number of robots, where rows tell it and their CPU time."""
    groups: dict[int, list[dict]] = {}
    for row in rows:
        if "cpu" in row and "robots" in row:
            groups.setdefault(row["robots"], []).append(row)
    yield "| robots | problems | statuses | CPU s: mean | median |"
    yield "|---" * 5 + "|"
    for count, some in sorted(groups.items()):
        told = ", ".join(f"{n} {s}" for s, n in Counter(map(_status, some)).most_common())
        spent = [r["cpu"] for r in some]
        middle = f"{statistics.mean(spent):.2f} | {statistics.median(spent):.2f}"
        yield f"| {count} | {len(some)} | {told} | {middle} |"


def _counted(told: str, values: list) -> str:
    return f"{told}: " + ", ".join(f"{n} {c}" for n, c in Counter(map(str, values)).most_common())


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
