"""Writes the files that are frozen with the package: ``python -m tests.benchmarks.freeze``."""

from __future__ import annotations

import json
from pathlib import Path

from up_samp.benchmarks import places
from up_samp.benchmarks.builders import jobshop
from up_samp.benchmarks.builders.logistics import shelved_floor
from up_samp.geometry import write_map

PAPER_JOB_SHOPS = tuple(
    (robots, jobs, machines)
    for machines in (1, 2, 4, 6)
    for robots in (1, 2, 3)
    for jobs in (1, 2, 3)
)


def write(folder: Path) -> None:
    """Draw the paper's maps and job shops into ``folder``."""
    for floor in (shelved_floor(), *map(jobshop.shop_floor, (1, 2, 4, 6))):
        occupied = places.draw(floor.size, floor.walls)
        write_map(folder, floor.name, occupied, places.RESOLUTION)
    shops = {}
    for r, j, m in PAPER_JOB_SHOPS:
        shop = jobshop.draw_shop(r, j, m, 0)
        told = {"jobs": shop.jobs, "machines": shop.machines, "starts": shop.starts}
        shops[jobshop.instance_name(r, j, m)] = told
    rows = ",\n".join(f'"{name}": {json.dumps(shop)}' for name, shop in shops.items())
    (folder / "jobshop.json").write_text(f"{{\n{rows}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    write(places.DATA)
