"""Draw the pictures of the documentation anew: ``python scripts/pictures.py [NAME ...]``.

Each example is solved as its docstring says, and its picture goes to ``docs/images``.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from up_samp.cli import main
from up_samp.fleet.files import write_starter

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"

SOLVED = {
    "warehouse": ("examples/warehouse.py", "map.png"),
    "passing": ("examples/passing_place.py", "map.png"),
    "mixed": ("examples/mixed_fleet.py", "map.png"),
    "rules": ("examples/traffic_rules.py", "map.png"),
    "pallets": ("examples/pallets.py", "map.png"),
    "formation": ("examples/formation.py", "map.png"),
    "factory": ("examples/factory.py", "map.png"),
    "paint": ("examples/paint_shop.py", "gantt.png"),
    "charging": ("examples/charging.py", "gantt.png"),
    "docking": ("examples/charging.py", "map.png"),
    "hospital": ("examples/hospital.py", "map.png"),
    "shop": ("examples/shop.py", "gantt.png"),
    "nav2": ("examples/nav2_warehouse.py", "gantt.png"),
    "ros": ("examples/ros_map.py", "map.png"),
    "door": ("examples/door.py", "map.png"),
    "swap": ("examples/swap.py", "map.png"),
}
"""Name of the picture: what is solved, and which of its pictures it is."""


def solved(problem: str, out: Path, *options: str) -> None:
    """Solve something and write its pictures to ``out``."""
    command = [
        "solve",
        problem,
        "--out",
        str(out),
        "--timeout",
        "400",
        "--patience",
        "0.5",
        *options,
    ]
    if main(command) != 0:
        raise SystemExit(f"no plan for {problem}")


def draw(name: str, scratch: Path) -> Path:
    """Draw one picture and return its file."""
    target = IMAGES / f"fleet-{name}.png"
    if name in SOLVED:
        problem, picture = SOLVED[name]
        solved(str(ROOT / problem), scratch)
        shutil.copy(scratch / picture, target)
    elif name == "check":
        files = write_starter(scratch / "site")
        main(["check", str(files[0]), "--out", str(target)])
    elif name == "unsolvable":
        main(["check", str(ROOT / "examples" / "unsolvable.yaml"), "--out", str(target)])
    elif name == "delays":
        solved(str(ROOT / "examples" / "delays.py"), scratch)
        runs = ["--delays", "30%", "--runs", "1", "--policy", "staircase"]
        main(["simulate", str(scratch / "plan.json"), *runs, "--out", str(scratch)])
        shutil.copy(scratch / "executed-staircase.png", target)
    elif name == "demo":
        main(["demo", "--out", str(scratch)])
        for picture in ("map.png", "gantt.png"):
            shutil.copy(scratch / picture, IMAGES / picture)
        target = IMAGES / "map.png"
    else:
        raise SystemExit(f"no picture '{name}'; there are {', '.join(names())}")
    return target


def names() -> list[str]:
    """Return the names of all pictures."""
    return [*SOLVED, "check", "unsolvable", "delays", "demo"]


if __name__ == "__main__":
    for wanted in sys.argv[1:] or names():
        with tempfile.TemporaryDirectory() as folder:
            print(draw(wanted, Path(folder)))
