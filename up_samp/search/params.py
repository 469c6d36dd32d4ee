"""What the search does: one validated dataclass, and the presets."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from up_samp.model.errors import ProblemError, short
from up_samp.search.events import Observer, State
from up_samp.search.knowledge import ProgressEvent

if TYPE_CHECKING:
    from up_samp.motion.protocol import MotionCache
    from up_samp.tuning import Tuning


@dataclass(frozen=True)
class Parameters:
    """Parameters of ``samp-refine``; everything else goes to the wrapped engine."""

    preset: str = "default"
    seed: int = 0
    seconds_per_unit: float = 1.0
    margin: float = 0.01
    """Clearance that motions keep from everything (m)."""
    optimal: bool = False
    """Go on until proven optimal, or all the time; so also where UP's guarantee asks for it."""
    relative: bool = False
    """Call a plan optimal also where motions may be shorter than the planner's own, by which it is
    (the paper's relative optimality); otherwise only where each is within 5 % of its proven bound.
    """
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
    cache: MotionCache | None = None
    """What keeps motions, to be shared by searches one after the other (``None``: one's own)."""
    trace: str | None = None
    """Folder for a readable trace of every candidate schedule and refinement."""
    progress: Callable[[ProgressEvent], None] | None = None
    observers: Sequence[Observer] = ()
    """Told of every event (:class:`up_samp.search.events.Observer`)."""
    stop: Callable[[State], bool] | None = None
    """Asked before every round whether to stop there."""
    runtime: float = math.inf
    """Longest search (s), as ``timeout`` says it where UP takes one; it ends what is under way. If
    ``reproducible``, it counts work.
    """
    components: Any = None
    """What the search is made of (:class:`up_samp.search.search.Components`), instead of what the
    preset says."""
    tuning: Tuning | Mapping[str, Any] | str | os.PathLike[str] | None = None
    """Tunables (:mod:`up_samp.tuning`), or a table or TOML file of them."""
    path_planner: str = "default"
    without: tuple[str, ...] = ()
    """The :data:`IDEAS` that are left out, beside those that the preset leaves out."""

    def __post_init__(self) -> None:
        self._check_types()
        for message, wrong in (
            (_unknown(self.preset), self.preset not in {**PRESETS, **ABLATIONS}),
            ("parameter 'seconds_per_unit' must be positive", self.seconds_per_unit <= 0),
            ("parameter 'query_seconds' must be positive", self.query_seconds <= 0),
            ("'optimal' and 'first_plan' ask for different things", self.optimal & self.first_plan),
            ("parameter 'margin' must not be negative", self.margin < 0),
            ("parameter 'patience' must not be negative", not self.patience >= 0),
            ("parameter 'runtime' must be 0 s or more", not self.runtime >= 0),
            ("parameter 'max_restarts' must not be negative", (self.max_restarts or 0) < 0),
        ):
            if wrong:
                raise ProblemError(message)

    def _check_types(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            good, wanted = _KINDS.get(field.name, (_of(bool), "True or False"))
            if not (good(value) or value is field.default is None):
                raise ProblemError(f"parameter '{field.name}' must be {wanted}, not {short(value)}")


def _unknown(preset: str) -> str:
    return f"unknown preset '{preset}' (known: {', '.join(PRESETS)})"


def _of(*kinds: type) -> Callable[[Any], bool]:
    """Return what tells whether a value is of one of some types (True is no number)."""
    return lambda value: isinstance(value, kinds) and (bool in kinds) == isinstance(value, bool)


def _finite(value: Any) -> bool:
    return _of(int, float)(value) and math.isfinite(value)


def _are_ideas(value: Any) -> bool:
    return isinstance(value, tuple | list) and set(map(str, value)) <= IDEAS.keys()


def _observe(value: Any) -> bool:
    return isinstance(value, Sequence) and all(isinstance(o, Observer) for o in value)


IDEAS: Mapping[str, str] = {
    "refine": "learn from failed checks (else: the sequential pipeline of schedule, then motions)",
    "bounds_first": "motion durations known before the first schedule",
    "certificates": "proofs of unreachability (stated before the first schedule), unary places",
    "small_cuts": "failed groups shrunk to the motions that conflict, with the rivals that matter",
    "equivalents": "refinements stated for all equivalent objects",
    "handovers": "proven gaps between who leaves a place and who comes there",
    "incumbents": "candidate schedules repaired into plans",
    "slack": "motions given what time the candidate's makespan leaves them",
    "tidy": "motions that nothing needs, and waits, left out of the plan that is returned",
    "single_geometric": "layer 1, geometric: a path for each motion alone, first",
    "single_temporal": "layer 1, temporal: a duration for each motion alone, first",
}
"""What presets and ablations leave out; docs/architecture.md says where each of them lives."""

_KINDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    **dict.fromkeys(("seconds_per_unit", "query_seconds", "margin"), (_finite, "a finite number")),
    **dict.fromkeys(("patience", "runtime"), (_of(int, float), "a number")),
    **dict.fromkeys(("seed", "max_restarts"), (_of(int), "a whole number")),
    **dict.fromkeys(
        ("preset", "path_planner", "trace"),
        (_of(str, os.PathLike), "a text"),
    ),
    **dict.fromkeys(("progress", "stop"), (callable, "a function")),
    "observers": (_observe, "a sequence of observers"),
    "without": (_are_ideas, f"a tuple of ideas ({', '.join(IDEAS)})"),
    # it is checked where it is read: that imports what is not needed here
    "tuning": (lambda value: True, ""),
    "components": (dataclasses.is_dataclass, "components of a search"),
    "cache": (lambda value: hasattr(value, "hits"), "an up_samp.motion.MotionCache"),
}
"""What parameters may be, by name; the others are switches."""


_OURS = ("bounds_first", "certificates", "small_cuts", "handovers", "incumbents", "slack", "tidy")
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    "paper": {"without": _OURS, "path_planner": "RRT"},
    "sequential": {"without": ("refine", *_OURS)},
}
ABLATIONS: Mapping[str, Mapping[str, Any]] = {
    f"without-{idea.replace('_', '-')}": {"without": (idea,)} for idea in IDEAS if idea != "refine"
}
"""The default preset with one idea left out; presets too, for measurements."""


def split_parameters(given: Mapping[str, Any]) -> tuple[Parameters, dict[str, Any]]:
    """Return our parameters (over their preset) and those left for the wrapped engine."""
    names = {f.name for f in dataclasses.fields(Parameters)}
    ours = {k: v for k, v in given.items() if k in names}
    rest = {k: v for k, v in given.items() if k not in names}
    preset = ours.get("preset", "default")
    settings = {**PRESETS, **ABLATIONS}.get(preset)
    if settings is None:
        raise ProblemError(_unknown(preset))
    asked = Parameters(**{**settings, **ours})
    without = dict.fromkeys((*settings.get("without", ()), *asked.without))
    return dataclasses.replace(asked, without=tuple(without)), rest
