"""Draw how motion planning grows with the map and with the number of robots.

python benchmarks/motion/car_queries.py --out OUT
python benchmarks/spacetime/growth.py --out OUT/growth.json
python benchmarks/motion/plot_growth.py OUT docs/images/motion-growth.png
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path
from typing import Any

MAP_LINES = (
    ("setup_ms", "clearances of the map, once"),
    ("certificate_ms", "first proof on a map"),
    ("bound_ms", "lower bound"),
    ("plan_ms", "one car query"),
)


def by_map(axes: Any, rows: list[dict[str, float]]) -> None:
    """Draw times over the number of cells."""
    cells = [row["cells"] / 1e6 for row in rows]
    for key, label in MAP_LINES:
        axes.loglog(cells, [row[key] for row in rows], marker="o", label=label)
    axes.set_xticks(cells, [f"{c:.2g}" for c in cells])
    axes.minorticks_off()
    axes.set_xlabel("cells of the map (millions)")
    axes.set_ylabel("ms")
    axes.legend(frameon=False)
    axes.set_title("Map size")


def by_robots(axes: Any, rows: list[dict[str, Any]]) -> None:
    """Draw times over the number of robots that drive at once."""
    robots = [row["robots"] for row in rows]
    for key, label in (("first", "first check"), ("again", "checked again")):
        medians = [1e3 * statistics.median(r[key] for r in row["groups"]) for row in rows]
        axes.semilogy(robots, medians, marker="o", label=f"one group, {label}")
        whole = [1e3 * row["plan"][key] for row in rows]
        axes.semilogy(robots, whole, marker="s", ls="--", label=f"plan of 60 motions, {label}")
    axes.set_xticks(robots)
    axes.set_xlabel("robots")
    axes.set_ylabel("ms")
    axes.legend(frameon=False)
    axes.set_title("Number of robots")


def main() -> None:
    """Read both results, write the picture."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("picture", type=Path)
    options = parser.parse_args()
    maps = json.loads((options.results / "car_queries.json").read_text())["growth"]
    robots = json.loads((options.results / "growth.json").read_text())
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2))
    by_map(left, maps)
    by_robots(right, robots)
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(options.picture, dpi=110)


if __name__ == "__main__":
    main()
