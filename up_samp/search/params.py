"""What the search does: one validated dataclass, and the presets."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from up_samp.model.errors import ProblemError, short
from up_samp.search.events import Observer
from up_samp.search.history import ProgressEvent
from up_samp.search.stopping import StopCriterion

if TYPE_CHECKING:
    from up_samp.search.search import Components
    from up_samp.tuning import Tuning

GROUP_PLANNERS = {"default": "ladder", "ladder": "ladder", "st-rrt*": "st-rrt*"}
"""Group planners by parameter: our ladder, or the paper's ST-RRT* for one robot after the other."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of ``samp-refine``; everything else goes to the wrapped engine.

    The switches from ``refine`` on are the ideas that presets and ablations turn on and off;
    docs/architecture.md says where each of them lives.
    """

    preset: str = "default"
    seed: int = 0
    seconds_per_unit: float = 1.0
    margin: float = 0.01
    """Clearance that motions keep from everything (m)."""
    optimal: bool = False
    """Go on until proven optimal, or all the time; so also where UP's guarantee asks for it."""
    first_plan: bool = False
    """Return the first plan at once."""
    patience: float = 1.0
    """Where neither is asked for: how long to go on without a better plan, as a share of what it
    took to find the best one (a second at least; ``inf``: all the time).
    """
    reproducible: bool = False
    """Limits within the search count work, not seconds: the same seed gives the same plan on every
    machine, busy or not, if the time limit does not end it. For ``cpsat`` with one worker.
    """
    query_seconds: float = 10.0
    """First limit of one motion query (the paper's t_p, doubled at each restart)."""
    max_restarts: int | None = None
    """Restarts without what was only guessed (``None``: without a plan as long as there is time,
    with one as long as they bring anything new; 3 where there is no time limit).
    """
    cache: str | None = None
    """Folder that keeps motions across runs (``None``: in memory only)."""
    trace: str | None = None
    """Folder for a readable trace of every candidate schedule and refinement."""
    progress: Callable[[ProgressEvent], None] | None = None
    observers: Sequence[Observer] = ()
    """Told of every event (:class:`up_samp.search.events.Observer`)."""
    stop: StopCriterion | None = None
    """Stops the search after a round (:mod:`up_samp.search.stopping`); by time: ``timeout``."""
    components: Components | None = None
    """What the search is made of, instead of what the preset and its switches say."""
    tuning: Tuning | Mapping[str, Any] | str | os.PathLike[str] | None = None
    """Tunables (:mod:`up_samp.tuning`), or a table or TOML file of them."""
    executor: Executor | None = None
    """Who plans motions and searches neighbourhoods beside this process
    (:mod:`up_samp.system.workers`); answers are
    the same without. The caller ends it.
    """
    path_planner: str = "default"
    group_planner: str = "default"

    refine: bool = True
    """Learn from failed checks (off: the sequential pipeline of schedule, then motions)."""
    bounds_first: bool = True
    """Motion durations known before the first schedule."""
    certificates: bool = True
    """Proofs of unreachability (stated before the first schedule, too) and unary places."""
    small_cuts: bool = True
    """Failed groups shrunk to the motions that conflict, with only the rivals that matter."""
    equivalents: bool = True
    """Refinements stated for all equivalent objects."""
    profiles: bool = True
    """Pairs of motions that meet learned for whole ranges of start offsets."""
    incumbents: bool = True
    """Candidate schedules repaired into plans."""
    slack: bool = True
    """Motions given what time the candidate's makespan leaves them."""
    neighbourhoods: bool = False
    """Parts of a plan decided anew where the scheduler finds nothing better for the whole."""
    tidy: bool = True
    """Optional motions that nothing needs left out of the plan that is returned."""
    single_geometric: bool = True
    """Layer 1, geometric: a path for each motion alone, first."""
    single_temporal: bool = True
    """Layer 1, temporal: a duration for each motion alone, first."""

    def __post_init__(self) -> None:
        self._check_types()
        if self.preset not in PRESETS and self.preset not in ABLATIONS:
            raise ProblemError(f"unknown preset '{self.preset}' (known: {', '.join(PRESETS)})")
        for name in ("seconds_per_unit", "query_seconds"):
            if not getattr(self, name) > 0:
                raise ProblemError(f"parameter '{name}' must be positive")
        if self.group_planner.lower() not in GROUP_PLANNERS:
            raise ProblemError(
                f"unknown group planner '{self.group_planner}' (known: {', '.join(GROUP_PLANNERS)})"
            )
        if self.optimal and self.first_plan:
            raise ProblemError("'optimal' and 'first_plan' ask for different things")
        if self.margin < 0 or not self.patience >= 0:
            which = "margin" if self.margin < 0 else "patience"
            raise ProblemError(f"parameter '{which}' must not be negative")
        if self.max_restarts is not None and self.max_restarts < 0:
            raise ProblemError("parameter 'max_restarts' must not be negative")

    def _check_types(self) -> None:
        for field in dataclasses.fields(self):
            name, value = field.name, getattr(self, field.name)
            if value is None and field.default is None:
                continue
            plain = not isinstance(value, bool)
            if name in _NUMBERS:
                good = isinstance(value, int | float) and plain and math.isfinite(value)
                wanted = "a finite number"
            elif name == "patience":
                good, wanted = isinstance(value, int | float) and plain, "a number"
            elif name in _WHOLE:
                good, wanted = isinstance(value, int) and plain, "a whole number"
            elif name in _TEXTS:
                good, wanted = isinstance(value, str | os.PathLike), "a text"
            elif name in ("progress", "stop"):
                good, wanted = callable(value), "a function"
            elif name == "observers":
                good = isinstance(value, Sequence) and all(isinstance(o, Observer) for o in value)
                wanted = "a sequence of observers"
            elif name == "tuning":
                continue  # it is checked where it is read: that imports what is not needed here
            elif name == "executor":
                good, wanted = callable(getattr(value, "submit", None)), "an executor"
            elif name == "components":
                good, wanted = dataclasses.is_dataclass(value), "components of a search"
            else:
                good, wanted = isinstance(value, bool), "True or False"
            if not good:
                raise ProblemError(f"parameter '{name}' must be {wanted}, not {short(value)}")


_NUMBERS = ("seconds_per_unit", "margin", "query_seconds")
_WHOLE = ("seed", "max_restarts")
_TEXTS = ("preset", "path_planner", "group_planner", "cache", "trace")


_ALL_OFF = dict.fromkeys(
    (
        "bounds_first",
        "certificates",
        "small_cuts",
        "profiles",
        "incumbents",
        "slack",
        "neighbourhoods",
        "tidy",
    ),
    False,
)
"""Our own ideas, all switched off."""

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    "paper": {
        **_ALL_OFF,
        "path_planner": "RRT",
        "group_planner": "ST-RRT*",
    },
    "sequential": {"refine": False, **_ALL_OFF},
}


SWITCHES = (
    "refine",
    "bounds_first",
    "certificates",
    "small_cuts",
    "equivalents",
    "profiles",
    "incumbents",
    "slack",
    "neighbourhoods",
    "tidy",
    "single_geometric",
    "single_temporal",
)
"""The ideas that presets and ablations turn on and off."""

ABLATIONS: Mapping[str, Mapping[str, Any]] = {
    f"without-{switch.replace('_', '-')}": {switch: False}
    for switch in SWITCHES
    if switch != "refine"
}
"""The default preset with one idea switched off; presets too, for measurements."""


def split_parameters(given: Mapping[str, Any]) -> tuple[Parameters, dict[str, Any]]:
    """Return our parameters (over their preset) and those left for the wrapped engine."""
    names = {f.name for f in dataclasses.fields(Parameters)}
    ours = {k: v for k, v in given.items() if k in names}
    rest = {k: v for k, v in given.items() if k not in names}
    preset = ours.get("preset", "default")
    if preset not in PRESETS and preset not in ABLATIONS:
        raise ProblemError(f"unknown preset '{preset}' (known: {', '.join(PRESETS)})")
    settings = PRESETS[preset] if preset in PRESETS else ABLATIONS[preset]
    return Parameters(**{**settings, **ours}), rest
