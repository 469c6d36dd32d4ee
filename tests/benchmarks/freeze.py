"""Writes the files that are frozen with the package: ``python -m tests.benchmarks.freeze``."""

from __future__ import annotations

import json
from pathlib import Path

from up_samp.benchmarks import jobshop, maps

PAPER_JOB_SHOPS = tuple(
    (robots, jobs, machines)
    for machines in (1, 2, 4, 6)
    for robots in (1, 2, 3)
    for jobs in (1, 2, 3)
)


def write(folder: Path) -> None:
    """Draw the paper's maps and job shops into ``folder``."""
    maps.write_map(folder, "logistics", maps.draw(maps.LOGISTICS_SIZE, maps.logistics_walls()))
    for cells in (1, 2, 4, 6):
        grid = maps.draw(maps.job_shop_size(cells), maps.job_shop_walls(cells))
        maps.write_map(folder, f"jobshop-{cells}", grid)
    shops = {
        jobshop.instance_name(r, j, m): vars(jobshop.draw_shop(r, j, m, 0))
        for r, j, m in PAPER_JOB_SHOPS
    }
    rows = ",\n".join(f'"{name}": {json.dumps(shop)}' for name, shop in shops.items())
    (folder / "jobshop.json").write_text(f"{{\n{rows}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    write(maps.DATA)
