"""The tables of the documentation, made from the figures kept (``scripts/figures.py --docs``).

Where a page has a line ``<!-- figures: NAME -->``, what follows up to ``<!-- end -->`` is the table
of that name. ``tests/docs/test_figures.py`` keeps pages and figures together.
"""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from figures import ABOUT

from up_samp.benchmarks.report import PAPER
from up_samp.operate.judge import DayVerdict

Row = dict[str, Any]
Rows = Mapping[str, Row]
Cells = list[list[str]]

MARK = re.compile(r"(<!-- figures: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def say(value: object, form: str = "") -> str:
    """Return a cell; "-" where there is nothing."""
    return "-" if value is None else format(value, form)


def markdown(head: Sequence[str], cells: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    lines = [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *cells)]
    return "\n".join(lines)


@dataclass(frozen=True)
class Column:
    """A column: its heading, the row's value or a function of the row, and how that is written."""

    head: str
    value: str | Callable[[Row], object]
    form: str = ""

    def cell(self, row: Row) -> str:
        """Return the cell of a row."""
        found = self.value(row) if callable(self.value) else row.get(self.value)
        return say(found, self.form)


def plain(first: str, *columns: Column) -> Callable[[Rows], str]:
    """Return what makes a table with one line for each case."""

    def table(rows: Rows) -> str:
        empty = [""] * (len(columns) - 1)
        cells = [
            [case, f"failed: {row['failed']}", *empty]
            if "failed" in row
            else [case, *(column.cell(row) for column in columns)]
            for case, row in rows.items()
        ]
        return markdown([first, *(column.head for column in columns)], cells)

    return table


def share(part: str, whole: str) -> Callable[[Row], float | None]:
    """Return a function of a row: one value over another."""

    def found(row: Row) -> float | None:
        top, bottom = row.get(part), row.get(whole)
        return None if top is None or not bottom else top / bottom

    return found


def wrong(row: Row) -> str:
    """Return how much was wrong in a day, and of which kinds."""
    found = (f"{row[kind.name]} {kind.name}" for kind in fields(DayVerdict) if kind.name in row)
    return ", ".join(found) or str(row["wrong"])


def of(part: str, whole: str) -> Callable[[Row], str]:
    """Return a function of a row: "3 of 4"."""
    return lambda row: f"{row[part]} of {row[whole]}"


# --- tables that are not one line for each case


GROUPS = {
    "OC-DO": "logistics-do-oc", "OC-DC": "logistics-dc-oc", "ALL-DO": "logistics-do-all",
    "ALL-DC": "logistics-dc-all", "JSP": "jobshop",
}  # fmt: skip


def published(rows: Rows, engine: str = "cpsat") -> str:
    """The paper's table: valid first plans by group."""
    good = {name: row for name, row in rows.items() if row.get("valid")}
    counts = []
    for start in GROUPS.values():
        asked = [name for name in rows if name.startswith(start)]
        counts.append(f"{sum(name in good for name in asked)} of {len(asked)}")
    seconds = [row["seconds"] for row in good.values()]
    mean = say(statistics.mean(seconds), ".2f") if seconds else "-"
    ours = [f"samp-refine[{engine}], 60 s", *counts, f"{len(good)} of {len(rows)}", mean]
    best = ["paper's best (Aries, fluents, 1800 s)", *(f"{n:g}" for n in PAPER["Aries, fluents"])]
    return markdown(["", *GROUPS, "total", "mean s"], [best, ours])


def instances(rows: Rows) -> str:
    """Every first plan: makespan, bound, CPU seconds; the sizes of a family stand side by side."""
    cells = []
    for name, row in rows.items():
        told = row.get("failed")
        cells.append(
            [name, f"failed: {told}", "", "", ""]
            if told
            else [
                name,
                say(row["makespan"]) if row["valid"] else "none",
                say(row["bound"]),
                say(row["sequential"]),
                say(row["cpu"], ".1f"),
            ]
        )
    return markdown(["instance", "makespan", "lower bound", "sequential", "CPU s"], cells)


def tight_places(rows: Rows) -> str:
    """One line for each place, one column for each kind of body."""
    bodies = {"omni": "omnidirectional", "car": "car", "differential": "turns on the spot"}
    found: dict[str, dict[str, str]] = {}
    for case, row in rows.items():
        place, _, body = case.rpartition(", ")
        told = f"{row['cpu']:.2f} s, {say(row['ratio'], '.2f')}" if row.get("found") else "no way"
        found.setdefault(place, {})[body] = "failed" if "failed" in row else told
    cells = [[place, *(each.get(body, "") for body in bodies)] for place, each in found.items()]
    return markdown(["place", *bodies.values()], cells)


def growth(rows: Rows) -> str:
    """Exponents k of (CPU seconds, MiB) ~ activities ** k over the sizes of ``scale``."""
    keys = {"all": "cpu", "reading": "cpu_reading", "building the plan": "cpu_building",
            "validating": "cpu_validating", "peak memory": "peak"}  # fmt: skip
    good = [row for case, row in rows.items() if "," not in case and "failed" not in row]
    cells = []
    for label, key in keys.items():
        points = [(math.log(r["activities"]), math.log(max(r[key], 1e-3))) for r in good]
        x, y = [p[0] for p in points], [p[1] for p in points]
        slope = statistics.linear_regression(x, y).slope if len(points) > 1 else None
        cells.append([label, say(slope, ".2f")])
    return markdown(["what grows with the optional activities", "exponent"], cells)


def _traffic(row: Mapping[str, Any]) -> tuple[str, str]:
    """The least makespan without traffic, and how much more a plan takes (no other share of the
    jobs may have been tried in the time).
    """
    without = row.get("without_traffic")
    return ("", "") if without is None else (str(without), f"{row['makespan'] / without - 1:.0%}")


def better_plans(rows: Rows) -> str:
    """The plans of an anytime planner, one after the other."""
    cells = [
        [case, f"failed: {row['failed']}", "", "", ""]
        if "failed" in row
        else [
            case,
            ", ".join(f"{makespan} ({seconds:.0f} s)" for makespan, seconds in row["plans"]),
            *_traffic(row),
            f"{row['bound']} ({row['absolute']})",
        ]
        for case, row in rows.items()
    ]
    head = ["", "makespans (after CPU s)", "without traffic", "traffic", "bound (absolute)"]
    return markdown(head, cells)


def house(rows: Rows) -> str:
    """The structure of the package."""
    told = {k: v for k, v in next(iter(rows.values())).items() if k not in ABOUT}
    return markdown(["of `up_samp/`", ""], [[key, say(value)] for key, value in told.items()])


def cell_of(engine: str) -> Column:
    """Return a column of an engine's makespan, seconds and what it did not prove."""

    def told(row: Row) -> str:
        return str(row["engines"].get(engine, "-"))

    return Column(engine, told)


PERCENT = ".1%"
BUSY = 2.5
"""The load from which a caption warns (a measurement makes one of up to 2 by itself)."""
TABLES: dict[str, tuple[str, Callable[[Rows], str]]] = {
    "house": ("house", house),
    "start-up": ("start-up", plain(
        "a fresh process that does",
        Column("CPU s", "cpu", ".2f"), Column("s by the clock", "seconds", ".2f"),
    )),
    "memory": ("memory", plain(
        "a process that solves", Column("peak MiB", "peak", ".0f"),
        Column("held after 6 solves", "after_6", ".0f"),
        Column("held after 48", "after_48", ".0f"),
    )),
    "published": ("first-plans", published),
    "instances": ("first-plans", instances),
    "aries": ("aries", partial(published, engine="aries")),
    "drawn-anew": ("drawn-anew", plain(
        "instance", Column("makespan", "makespan"), Column("lower bound", "bound"),
        Column("gap", lambda r: 1 - r["bound"] / r["makespan"] if r["makespan"] else None, ".0%"),
        Column("proven", lambda r: "yes" if r["proven"] else "no"), Column("CPU s", "cpu", ".1f"),
    )),
    "proofs": ("proofs", plain(
        "instance", Column("makespan", "makespan"), Column("lower bound", "bound"),
        Column("proven", lambda r: "yes" if r["proven"] else "no"),
        Column("CPU s", "cpu", ".1f"), Column("s", "seconds", ".1f"),
    )),
    "ten-robots": ("ten-robots", plain(
        "instance", Column("makespan", "makespan"), Column("lower bound", "bound"),
        Column("CPU s", "cpu", ".1f"), Column("s", "seconds", ".1f"),
    )),
    "scale": ("scale", plain(
        "robots x orders", Column("optional activities", "activities"),
        Column("makespan", "makespan"), Column("lower bound", "bound"),
        Column("CPU s in all", "cpu", ".1f"), Column("reading", "cpu_reading", ".1f"),
        Column("building the plan", "cpu_building", ".1f"),
        Column("validating", "cpu_validating", ".1f"), Column("peak MiB", "peak", ".0f"),
    )),
    "growth": ("scale", growth),
    "better-plans": ("better-plans", better_plans),
    "others-floors": ("others-floors", plain(
        "map, robots x orders, seed", Column("makespan", "makespan", "g"),
        Column("without traffic", "without_traffic", "g"),
        Column("traffic", lambda r: r["makespan"] / r["without_traffic"] - 1, ".0%"),
        Column("bound", "bound", "g"),
    )),
    "sites": ("sites", plain(
        "site", Column("plan, s", "makespan", "g"), Column("lower bound, s", "bound", "g"),
        Column("over it", lambda r: r["makespan"] / r["bound"] - 1, ".0%"),
        Column("routing without traffic, s", "without_traffic", "g"),
        Column("over that", lambda r: r["makespan"] / r["without_traffic"] - 1, ".0%"),
    )),
    "tight-places": ("tight-places", tight_places),
    "traffic": ("traffic", plain(
        "map, body, robots, seed", Column("first plan after CPU s", "cpu", ".1f"),
        Column("arrivals / alone", "first", ".3f"), Column("after 60 CPU s", "ratio", ".3f"),
    )),
    "drives": ("drives", plain(
        "planner", Column("found", of("found", "asked")), Column("median ms", "median", ".1f"),
        Column("max ms", "most", ".0f"), Column("median duration / bound", "ratio", ".3f"),
        Column("max", "worst", ".3f"),
    )),
    "execution": ("execution", plain(
        "instance, delays",
        Column("(a) time-stamped: runs with collisions", lambda r: (
            f"{r['timed']:.3f}: {r['timed_collided']} of {r['draws']}"
        )),
        Column("(b) staircase", "staircase", ".3f"), Column("(c) re-ordered", "reorder", ".3f"),
        Column("waiting (c)", "waiting", PERCENT),
        Column("unsafe runs of (b), (c)", "unsafe"),
    )),
    "days": ("days", plain(
        "way, orders, hours, seed", Column("done", of("done", "orders")),
        Column("an hour", "per_hour", ".1f"), Column("mean tardiness s", "tardiness", ".1f"),
        Column("from coming to done s", "flow", ".0f"),
        Column("waited", "waiting", PERCENT),
        Column("wrong", wrong),
        Column("plans (dropped)", lambda r: f"{r['plans']} ({r['dropped']})"),
        Column("CPU of a plan, 95 %, s", "planning", ".2f"),
        Column("of a step, 95 %, ms", lambda r: 1000 * r["step"], ".1f"),
        Column("MiB early, at the end", lambda r: f"{r['early']:.0f}, {r['held']:.0f}"),
    )),
    "clairvoyant": ("clairvoyant", plain(
        "instance", Column("draws", "draws"), Column("(b) staircase", "staircase", ".3f"),
        Column("(c) re-ordered", "reorder", ".3f"), Column("(c) at worst", "worst", ".3f"),
    )),
    "replan": ("replan", plain(
        "instance", Column("solved", of("solved", "asked")), Column("median CPU s", "cpu", ".2f"),
    )),
    "executor": ("executor", plain(
        "made-up fleet", Column("`update` ms", "update", ".2f"),
        Column("`commands` ms", "commands", ".2f"),
        Column("`predicted_makespan` ms", "forecast", ".1f"),
    )),
    "presets": ("presets", plain(
        "preset", Column("solved", of("solved", "runs")), Column("CPU s in all", "cpu", ".1f"),
        Column("rounds", "rounds"), Column("refinements", "refinements"),
        Column("makespans in all", "makespans"),
    )),
    "schedulers": ("schedulers", plain(
        "problem", Column("optimum", "optimum"),
        *map(cell_of, ("cpsat", "aries-opt", "cpse", "aries-opt compiled", "cpse compiled")),
        Column("ratio", "ratio"),
    )),
    "relaxations": ("relaxations", plain(
        "instance", Column("bound without search", "bound"), Column("quick tour", "tour"),
        Column("share", share("bound", "tour"), ".0%"), Column("CPU s of the bound", "cpu", ".1f"),
    )),
    "resolving": ("resolving", plain(
        "problem", Column("one session, CPU s", "warm", ".1f"),
        Column("a new one each round, CPU s", "cold", ".1f"), Column("ratio", "ratio", ".1f"),
    )),
}  # fmt: skip
"""The figure that each table is made from, and how."""


def caption(rows: Rows) -> str:
    """Say where and when the rows were measured."""
    commits = ", ".join(f"`{c}`" for c in dict.fromkeys(r["commit"] for r in rows.values()))
    machines = "; ".join(dict.fromkeys(r["machine"] for r in rows.values()))
    loads = sorted({r["load"] for r in rows.values()})
    told = " to ".join(f"{load:g}" for load in dict.fromkeys((loads[0], loads[-1])))
    busy = ": beside other work, so seconds say little" if loads[-1] > BUSY else ""
    return f"*Measured at {commits}: {machines}; load {told}{busy}.*"


def table(name: str, figures: Mapping[str, Rows]) -> str:
    """Return a table by its name, with where it was measured."""
    figure, make = TABLES[name]
    rows = figures.get(figure)
    if not rows:
        return f"*Not measured yet: `python scripts/figures.py --keep --docs --only {figure}`.*\n"
    return f"{make(rows)}\n\n{caption(rows)}\n"


def renewed(text: str, figures: Mapping[str, Rows]) -> str:
    """Return a page with its tables made anew."""
    return MARK.sub(lambda m: f"{m[1]}\n{table(m[2], figures)}\n{m[3]}", text)


def rewrite(folder: Path, figures: Mapping[str, Rows]) -> None:
    """Write the tables of all pages in a folder anew."""
    for page in sorted(folder.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        after = renewed(text, figures)
        if after != text:
            page.write_text(after, encoding="utf-8")
            print(f"wrote {page.name}")
