"""What all uses of OMPL share: seeds, deadlines, names, and solving with honest answers.

States are made by ``si.allocState()`` and never freed by hand, paths are copied into numpy at once:
with the Python bindings of OMPL 2.0 anything else crashes or leaks.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from typing import Any

from up_samp.model import ProblemError, UnsupportedError
from up_samp.motion.budget import WorkBudget


def _load() -> tuple[Any, Any, Any, Any]:
    try:
        importlib.import_module("ompl")
    except ModuleNotFoundError as error:
        if error.name != "ompl":
            raise
        raise UnsupportedError(
            "OMPL is not installed (there are packages of it for Linux and macOS, not for "
            "Windows): motion models SE3 and CONTROL, OMPL's planners by name and preset 'paper' "
            "need it; cars and omnidirectional bodies do without it"
        ) from error
    return (
        importlib.import_module("ompl.base"),
        importlib.import_module("ompl.geometric"),
        importlib.import_module("ompl.control"),
        importlib.import_module("ompl.util"),
    )


ob, og, oc, ou = _load()
ou.setLogLevel(ou.LOG_NONE)

GEOMETRIC = (
    "RRT", "RRTConnect", "RRTstar", "InformedRRTstar", "BITstar",
    "KPIECE1", "BKPIECE1", "LBKPIECE1", "EST", "BiEST", "ProjEST", "LazyRRT", "TRRT", "BiTRRT",
    "LBTRRT", "RRTsharp", "RRTXstatic", "ABITstar", "AITstar", "EITstar", "SBL", "PDST", "STRIDE",
    "SST",
)  # fmt: skip
"""Geometric planners that are known to work here, where the installed OMPL has them."""

CONTROL = ("RRT", "KPIECE1", "EST")
"""Control planners that are known to work here."""

ONE_TREE = frozenset({"RRT", "RRTstar", "InformedRRTstar", "KPIECE1"})
"""Planners whose every vertex has been reached from the start."""

REFUSED = {
    "PRM": "its second thread makes it neither deterministic nor safe from Python",
    "PRMstar": "its second thread makes it neither deterministic nor safe from Python",
    "AORRTC": "it returns wrong paths (OMPL 2.0.1)",
    "SORRTstar": "after a good path it hardly gets on",
    **dict.fromkeys(("FMT", "BFMT"), "one batch of samples may not be enough"),
}


def known_planners(control: bool = False) -> tuple[str, ...]:
    """Return the names of the planners that the installed OMPL has and that can be used."""
    module, names = (oc, CONTROL) if control else (og, GEOMETRIC)
    return tuple(name for name in names if hasattr(module, name))


def canonical(name: str, control: bool = False) -> str:
    """Return a planner's name as OMPL writes it (case does not matter), or complain."""
    known = known_planners(control)
    for candidate in known:
        if candidate.lower() == name.lower():
            return candidate
    for refused, why in REFUSED.items():
        if refused.lower() == name.lower():
            raise UnsupportedError(f"OMPL's planner {refused} is not supported: {why}")
    kind = "control planner" if control else "planner"
    raise ProblemError(f"OMPL has no {kind} '{name}' here; known are {', '.join(known)}")


def set_seed(seed: int) -> None:
    """Make the next solve repeatable: all random generators made from now on follow ``seed``."""
    ou.RNG.setSeed(1 + seed % (2**31 - 1))  # 0 is refused


def box_bounds(low: Sequence[float], high: Sequence[float]) -> Any:
    """Return OMPL's bounds of a box (m)."""
    bounds = ob.RealVectorBounds(len(low))
    for i, (least, most) in enumerate(zip(low, high, strict=True)):
        bounds.setLow(i, float(least))
        bounds.setHigh(i, float(most))
    return bounds


class Validity(ob.StateValidityChecker):  # type: ignore[misc, name-defined]
    """Asks a check of ours about one state."""

    def __init__(self, si: Any, free: Callable[[Any], bool]) -> None:
        super().__init__(si)
        self._free = free

    def isValid(self, state: Any) -> bool:  # noqa: N802
        """Return whether a state is valid."""
        return self._free(state)


class EdgeValidity(ob.MotionValidator):  # type: ignore[misc, name-defined]
    """Asks a check of ours about a whole edge at a time, and counts them."""

    def __init__(self, si: Any, free: Callable[[Any, Any], bool], budget: WorkBudget) -> None:
        super().__init__(si)
        self._free, self._budget = free, budget

    def checkMotion(self, a: Any, b: Any, *_partly: Any) -> bool:  # noqa: N802
        """Return whether an edge is valid."""
        self._budget.used += 1
        return self._free(a, b)


def solve(
    planner: Any,
    pdef: Any,
    budget: WorkBudget,
    *,
    polish: int,
    read: Callable[[Any], Any] = type,
) -> tuple[list[Any] | None, str]:
    """Set a planner up, and run it until it has a path or the deadline ends; return the states of
    the path if an exact one was found, and OMPL's own word for how it ended.

    Planners that go on improving are stopped ``polish`` edge checks or iterations after their first
    exact path (counted, not timed: the same on every machine). ``read`` copies a state into a value
    of ours (default: nothing of it).
    """
    end: list[int] = []
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        if budget.spent():
            return True
        work = max(asked, budget.used)
        if not end and (pdef.hasExactSolution() or _has_path(planner)):
            end.append(work + polish)
        return bool(end) and work >= end[0]

    planner.setProblemDefinition(pdef)
    planner.setup()
    status = planner.solve(ob.PlannerTerminationCondition(stop))
    words = status.asString()
    if not pdef.hasExactSolution():
        return None, words
    path = pdef.getSolutionPath()
    return [read(path.getState(i)) for i in range(path.getStateCount())], words


def _has_path(planner: Any) -> bool:
    """Return whether an improving planner has a path already (it hands it over at its end)."""
    return hasattr(planner, "bestCost") and math.isfinite(planner.bestCost().value())


def vertices(planner: Any, read: Callable[[Any], Any]) -> list[Any]:
    """Return the states of all vertices that a planner has made."""
    data = ob.PlannerData(planner.getSpaceInformation())
    planner.getPlannerData(data)
    return [read(data.getVertex(i).getState()) for i in range(data.numVertices())]
