"""Car queries on the logistics map: ours beside OMPL with compiled and with shapely callbacks.

    python benchmarks/motion/car_queries.py --out OUT

Every planner answers the same depot-to-item queries in one run, single-threaded, warm. Times are
CPU times of this process, so that other load on the machine counts little. Writes
``car_queries.json``, ``car_queries.md`` and ``car_queries.png``.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely import affinity

from up_samp.geometry import OccupancyGrid, shape_of
from up_samp.geometry import kernels as k
from up_samp.geometry.compiled import kernel
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery, Placed
from up_samp.motion import MotionService
from up_samp.motion.curves.reeds_shepp import run_time

KIN = Kinematics(MotionModel.REEDSSHEPP, turning_radius=1.0, v_max=2.0, a_max=0.5)
ROBOT = Body(((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)), KIN)
OMNI = Body(ROBOT.footprint, Kinematics(MotionModel.SE2, v_max=2.0, a_max=0.5, omega_max=1.0))
DOOR = Body(((-0.5, -5.0), (0.5, -5.0), (0.5, 5.0), (-0.5, 5.0)), KIN)
OPEN, CLOSED = Placed("door", DOOR, (51.5, 40.0, 0.0)), Placed("door", DOOR, (51.5, 30.0, 0.0))
WALLS = ((52, 35, 100, 40), (52, 20, 100, 25))


def logistics_map(scale: float = 1.0, resolution: float = 0.1) -> OccupancyGrid:
    """The logistics floor, ``scale`` times as large along both axes."""
    rows, cols = round(65 * scale / resolution), round(100 * scale / resolution)
    cells = np.zeros((rows, cols), dtype=bool)
    cells[:2] = cells[-2:] = True
    cells[:, :2] = cells[:, -2:] = True
    for x0, y0, x1, y1 in WALLS:
        a, b, c, d = (round(v * scale / resolution) for v in (y0, y1, x0, x1))
        cells[a:b, c:d] = True
    return OccupancyGrid(cells, resolution)


def queries(depots: int) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    starts = [(x, 59.0, math.pi / 2) for x in (25.0, 15.0, 35.0)[:depots]]
    items = [(float(x), float(y), 0.0) for y in (32, 27, 42, 17) for x in (59, 71, 83, 95)]
    return [(s, g) for s in starts for g in items]


def timed(call: Any) -> tuple[float, Any]:
    began = time.process_time()
    value = call()
    return time.process_time() - began, value


def by_service(
    planner: str, depots: int, seconds: float, body: Body = ROBOT
) -> list[dict[str, Any]]:
    grid = logistics_map()
    warm = MotionService(grid, planner=planner)
    warm.plan(PathQuery(body, ((20, 59, 1.5), (59, 32, 0)), (OPEN,)), Deadline.after(120))
    service = MotionService(grid, planner=planner)
    service.lower_bound(body, (20, 59, 1.5), (59, 32, 0), (OPEN,))
    service.certificate(body, ((20, 59, 1.5), (59, 32, 0)), (OPEN,))
    rows = []
    for start, goal in queries(depots):
        query = PathQuery(body, (start, goal), (OPEN,))
        spent, report = timed(lambda q=query: service.plan(q, Deadline.after(seconds)))
        bound = service.lower_bound(body, start, goal, (OPEN,))
        found = report.outcome is Outcome.FOUND
        duration = report.trajectory.duration if found else None
        rows.append({"seconds": spent, "found": found, "duration": duration, "bound": bound})
    return rows


def by_shapely(depots: int, seconds: float, limit: int) -> list[dict[str, Any]]:
    """OMPL's RRTConnect over its Reeds-Shepp space; every state is checked with shapely."""
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.setLogLevel(ou.LOG_NONE)
    walls = shapely.union_all(
        [shapely.box(*w) for w in WALLS]
        + [shapely.box(0, 0, 100, 65) - shapely.box(0.2, 0.2, 99.8, 64.8)]
        + [affinity.translate(shapely.Polygon(DOOR.footprint), *OPEN.pose[:2])]
    )
    shapely.prepare(walls)
    footprint = shapely.Polygon(ROBOT.footprint)

    def valid(state: Any) -> bool:
        me = affinity.rotate(footprint, state.getYaw(), origin=(0, 0), use_radians=True)
        return not walls.intersects(affinity.translate(me, state.getX(), state.getY()))

    service, rows = MotionService(logistics_map()), []
    for index, (start, goal) in enumerate(queries(depots)[::3][:limit]):
        ou.RNG.setSeed(index + 1)
        space = ob.ReedsSheppStateSpace(KIN.turning_radius)
        box = ob.RealVectorBounds(2)
        for axis, high in enumerate((100.0, 65.0)):
            box.setLow(axis, 0.0)
            box.setHigh(axis, high)
        space.setBounds(box)
        si = ob.SpaceInformation(space)
        si.setStateValidityChecker(valid)
        si.setStateValidityCheckingResolution(0.1 / space.getMaximumExtent())
        si.setup()
        states = [si.allocState(), si.allocState()]
        for state, pose in zip(states, (start, goal), strict=True):
            state.setX(pose[0])
            state.setY(pose[1])
            state.setYaw(pose[2])
        pdef = ob.ProblemDefinition(si)
        pdef.setStartAndGoalStates(*states)
        planner = og.RRTConnect(si)
        planner.setProblemDefinition(pdef)
        planner.setup()
        spent, _ = timed(lambda p=planner: p.solve(seconds))
        found = bool(pdef.hasExactSolution())
        bound = service.lower_bound(ROBOT, start, goal, (OPEN,))
        # at best its path has no cusp
        duration = (
            run_time(pdef.getSolutionPath().length(), KIN.v_max, KIN.a_max) if found else None
        )
        rows.append({"seconds": spent, "found": found, "duration": duration, "bound": bound})
    return rows


@kernel
def _checks(world: Any, poses: Any) -> int:
    count = 0
    for i in range(poses.shape[0]):
        count += k.pose_free(world, poses[i, 0], poses[i, 1], poses[i, 2])
    return count


def footprint_check() -> dict[str, float]:
    """Microseconds of one footprint check: anywhere, and where discs do not settle it."""
    from up_samp.geometry import Scene

    scene, rng, n = Scene(logistics_map()), np.random.default_rng(0), 50_000
    world = scene.world(shape_of(ROBOT, 0.01), (CLOSED,))
    anywhere = np.column_stack(
        [rng.uniform(0, 100, n), rng.uniform(0, 65, n), rng.uniform(-3, 3, n)]
    )
    tight = anywhere.copy()
    tight[:, 0], tight[:, 1] = rng.uniform(53, 97, n), rng.uniform(34, 34.6, n)
    out = {}
    for name, poses in (("anywhere", anywhere), ("beside a wall", tight)):
        _checks(world, poses[:1])
        out[name] = min(timed(lambda p=poses: _checks(world, p))[0] for _ in range(5))
    return {name: seconds / n * 1e6 for name, seconds in out.items()}


def certificates() -> dict[str, float]:
    """Milliseconds to prove that the closed door cuts off the corridor: fresh, and once known; the
    least of a few, and the median.
    """
    query = ((25.0, 59.0, math.pi / 2), (59.0, 32.0, 0.0))
    first, again = [], []
    for _ in range(7):
        service = MotionService(logistics_map())
        service.certificate(ROBOT, query, (OPEN,))  # the map's own distances, once per map
        spent, proof = timed(lambda s=service: s.certificate(ROBOT, query, (CLOSED,)))
        assert proof is not None
        assert proof.blockers == {"door"}
        first.append(spent * 1e3)
        again.append(timed(lambda s=service: s.certificate(ROBOT, query, (CLOSED,)))[0] * 1e3)
    return {
        "first, least": min(first),
        "first, median": statistics.median(first),
        "again": statistics.median(again),
    }


def growth() -> list[dict[str, float]]:
    """Times over the size of the map."""
    rows = []
    for scale in (0.5, 1.0, 2.0, 3.0):
        service = MotionService(logistics_map(scale))
        setup, _ = timed(lambda s=service: (s.scene.data, s.certificate(ROBOT, ((9, 9, 0.0),), ())))
        ends = ((25 * scale, 59 * scale, math.pi / 2), (83 * scale, 30 * scale, 0.0))
        prove, _ = timed(lambda s=service, e=ends: s.certificate(ROBOT, e, ()))
        plan, report = timed(
            lambda s=service, e=ends: s.plan(PathQuery(ROBOT, e), Deadline.after(60))
        )
        bound, seconds = timed(lambda s=service, e=ends: s.lower_bound(ROBOT, *e))
        rows.append(
            {
                "cells": service.grid.occupied.size if service.grid else 0,
                "setup_ms": setup * 1e3,
                "certificate_ms": prove * 1e3,
                "plan_ms": plan * 1e3,
                "bound_ms": bound * 1e3,
                "ratio": report.trajectory.duration / seconds if report.trajectory else math.nan,
            }
        )
    return rows


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    ratios = [r["duration"] / r["bound"] for r in rows if r["found"]]
    times = [r["seconds"] * 1e3 for r in rows]
    return {
        "queries": len(rows),
        "found": sum(r["found"] for r in rows),
        "median_ms": statistics.median(times),
        "max_ms": max(times),
        "median_ratio": statistics.median(ratios) if ratios else None,
        "max_ratio": max(ratios) if ratios else None,
    }


def markdown(result: dict[str, Any]) -> str:
    lines = [
        "| planner | queries | found | median ms | max ms | median duration / bound | max |",
        "|---|---|---|---|---|---|---|",
    ]
    same = {**result["planners"], "ours, the body omnidirectional": result["omnidirectional"]}
    for name, s in same.items():
        ratio = "-" if s["median_ratio"] is None else f"{s['median_ratio']:.3f}"
        worst = "-" if s["max_ratio"] is None else f"{s['max_ratio']:.3f}"
        lines.append(
            f"| {name} | {s['queries']} | {s['found']} | {s['median_ms']:.1f} | {s['max_ms']:.0f} "
            f"| {ratio} | {worst} |"
        )
    checks = ", ".join(f"{n} {us:.2f}" for n, us in result["footprint_check_us"].items())
    proofs = ", ".join(f"{n} {ms:.1f}" for n, ms in result["certificate_ms"].items())
    lines += ["", f"Footprint check (us): {checks}.", f"Closed door proven (ms): {proofs}.", ""]
    lines += ["| cells | setup ms | certificate ms | bound ms | plan ms | duration / bound |"]
    lines += ["|---|---|---|---|---|---|"]
    lines += [
        f"| {g['cells']} | {g['setup_ms']:.0f} | {g['certificate_ms']:.1f} | {g['bound_ms']:.1f} "
        f"| {g['plan_ms']:.1f} | {g['ratio']:.3f} |"
        for g in result["growth"]
    ]
    return "\n".join(lines) + "\n"


def plot(result: dict[str, Any], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
    names = list(result["planners"])
    left.barh(names, [result["planners"][n]["median_ms"] for n in names])
    left.set_xlabel("median CPU time of a query, ms")
    cells = [g["cells"] for g in result["growth"]]
    for key in ("setup_ms", "certificate_ms", "bound_ms", "plan_ms"):
        right.loglog(cells, [g[key] for g in result["growth"]], marker="o", label=key[:-3])
    right.xaxis.set_minor_formatter("")
    right.set_xlabel("cells of the map")
    right.set_ylabel("ms")
    right.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("bench-out/motion"))
    parser.add_argument("--depots", type=int, default=3, choices=(1, 2, 3))
    parser.add_argument("--timeout", type=float, default=5.0, help="seconds per OMPL query")
    parser.add_argument("--shapely-queries", type=int, default=6)
    args = parser.parse_args()
    planners = {
        "ours (car)": by_service("car", args.depots, 60.0),
        "OMPL RRTConnect, compiled edges": by_service("RRTConnect", 1, args.timeout),
        "OMPL RRTConnect, shapely states": by_shapely(
            args.depots, args.timeout, args.shapely_queries
        ),
    }
    result = {
        "planners": {name: summary(rows) for name, rows in planners.items()},
        "omnidirectional": summary(by_service("planar", args.depots, 60.0, OMNI)),
        "footprint_check_us": footprint_check(),
        "certificate_ms": certificates(),
        "growth": growth(),
        "rows": planners,
    }
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "car_queries.json").write_text(json.dumps(result, indent=1))
    (args.out / "car_queries.md").write_text(markdown(result))
    plot(result, args.out / "car_queries.png")
    print(markdown(result))


if __name__ == "__main__":
    main()
