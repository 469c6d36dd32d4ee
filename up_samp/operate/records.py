"""What is told, decided and set on the floor, as frozen values. Times: s since the day's start."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

from up_samp.execution.executor import Executor
from up_samp.execution.reports import Command, Report
from up_samp.fleet.fields import Windows, corners_of
from up_samp.fleet.files import read_record
from up_samp.fleet.records import FleetRecords, Order, Task, Weights
from up_samp.io.plan_dict import PlanDict
from up_samp.model import ProblemError

Pose = tuple[float, float, float]
Shape = tuple[tuple[float, float], ...]


class OrderState(enum.Enum):
    """How far an order is."""

    WAITING = "waiting"
    """Nobody has it in the plan."""
    PLANNED = "planned"
    """The plan says who does it; that may change."""
    BEGUN = "begun"
    """It is with a robot, or one is on its way that will not be sent elsewhere."""
    DONE = "done"
    CANCELLED = "cancelled"

    @property
    def open(self) -> bool:
        """Whether it is still to be done."""
        return self in (OrderState.WAITING, OrderState.PLANNED, OrderState.BEGUN)


@dataclass(frozen=True)
class DayOrder:
    """An order or a task of the day: its record, when it came, how far it is, and by whom.

    ``due`` and ``release`` in the record are since the day's start; windows since the order came.
    """

    record: Order | Task
    came: float
    state: OrderState = OrderState.WAITING
    robot: str = ""
    begun: float | None = None
    done: float | None = None
    note: str = ""

    @property
    def id(self) -> str:
        """The record's."""
        return self.record.id

    @property
    def tardiness(self) -> float:
        """By how much later (s) than due it was done (0: in time, or not done, or never due)."""
        due = self.record.due
        return 0.0 if due is None or self.done is None else max(0.0, self.done - due)


def job_data(record: Order | Task) -> dict[str, Any]:
    """Return an order or a task as JSON would hold it."""
    return asdict(record, dict_factory=lambda kv: {k: v for k, v in kv if v is not None})


def job_record(data: Mapping[str, Any]) -> Order | Task:
    """Return the order (with ``pickup``) or task that data speak of.

    :raises FleetError: where something in them is wrong.
    """
    kind = Order if "pickup" in data else Task
    found: Order | Task = read_record(kind, dict(data), ("orders",))
    return found


def since_now(record: Any, now: float, came: float) -> Any:
    """Return an order that came at some time (s) on the clock of a plan that begins ``now``."""
    changes: dict[str, Any] = {"release": max(0.0, record.release - now)}
    if record.due is not None:
        changes["due"] = max(0.0, record.due - now)
    if isinstance(record, Order):
        for end in ("pickup", "delivery"):
            stop = getattr(record, end)
            changes[end] = replace(stop, window=_windows(stop.window, came - now))
    else:
        changes["window"] = _windows(record.window, came - now)
    return replace(record, optional=False, penalty=None, **changes)


def _windows(windows: Windows, by: float) -> Windows:
    """Return windows on a later clock: those that are over are gone, but for the last."""
    later = [(max(0.0, opens + by), max(0.0, closes + by)) for opens, closes in windows]
    return tuple([w for w in later if w[1] > 0.0] or later[-1:])


class Robots(Protocol):
    """The robots as the loop sees them: simulated ones, or those behind a broker."""

    faults: list[tuple[str, str]]
    """(robot, in words) what is wrong with robots, as it is found out."""
    levels: dict[str, float]
    """Of batteries (shares of a full one), of the robots that tell them."""

    def reports(self, now: float) -> Iterable[Report]:
        """Return what robots have told since the last call."""

    def tell(self, commands: Mapping[str, Command], now: float) -> None:
        """Tell everybody what to do: robots by name, activities of nobody by theirs."""

    def follow(self, executor: Executor) -> None:
        """Take note that commands speak of the motions of another plan from now on."""


def nothing_planned(site: FleetRecords, poses: Mapping[str, Pose]) -> PlanDict:
    """Return a plan in which robots stand at their poses, and nobody does anything."""
    objects = []
    for name, pose in poses.items():
        kind = site.kind_of(name)
        objects.append({
            "name": name, "type": site.robots[name].type, "footprint": corners_of(kind.footprint),
            "model": {"car": "REEDSSHEPP", "diff": "PIVOT", "omni": "SE2"}[kind.model],
            "turning_radius": kind.turning_radius, "v_max": kind.v_max, "a_max": kind.a_max,
            "omega_max": kind.omega_max, "initial": list(pose), "reverse": kind.reverse != "never",
            **site.senses(name),
        })  # fmt: skip
    nothing = {"tasks": [], "edges": [], "bounds": [], "edges_before_reduction": 0}
    return {
        "format": "up-samp-plan", "version": 1, "problem": site.name, "engine": "", "number": 0,
        "status": "SOLVED_SATISFICING", "seconds_per_unit": 1.0, "lower_bound": None,
        "makespan": 0.0, "map": {"yaml": site.map}, "objects": objects, "activities": [],
        "motions": [], "changes": [], "meanings": {},
        "dependencies": {**nothing, "margin": site.margin},
    }  # fmt: skip


# ------------------ How a day is operated: budgets, thresholds, and how much is planned at a time


@dataclass(frozen=True)
class Settings:
    """How a day is operated. ``budget``: seconds that a plan may be sought for, and ``grace`` more
    until it has to be there. ``every``: seconds after which what is not begun is planned anew in
    any case; ``late``: by how many seconds everything may end later than forecast until then.
    ``soon``: orders are given to robots that are free within so many seconds; ``most``: so many
    orders of a robot are planned anew at a time. ``tick``: seconds between two steps.
    ``localisation``: how far (m) from the truth robots tell to be, and ``latency``: by how many
    seconds longer than another one a message may take to come, where the site file says nothing
    else of them; ``ahead``: for how many seconds farther than
    they can stand robots are let drive: so much is told of a plan, and stays. ``low``: robots
    charge that have less than this share of what a full battery has above its reserve.
    ``stretch``: in simulated time, where the planner's budget is what it computes (CPU s), it has
    so many times as much.
    """

    budget: float = 2.0
    grace: float = 2.0
    stretch: float = 1.0
    every: float = 20.0
    late: float = 20.0
    soon: float = 20.0
    most: int = 3
    tick: float = 0.2
    localisation: float = 0.05
    latency: float = 0.5
    ahead: float = 1.2
    low: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("budget", "grace", "tick", "localisation", "latency", "ahead"):
            if not 0.0 <= (value := getattr(self, name)) < math.inf:
                raise ProblemError(f"'{name}' cannot be {value:g}: at least 0")

    @property
    def lead(self) -> float:
        """In how many seconds a plan that is asked for now is followed, at the latest."""
        return self.budget + self.grace + 2 * self.tick


DAY = Weights(tardiness=10.0, completion=1.0, driving=0.1)
"""What is best where a site file says only "makespan": a day has no end that counts."""
