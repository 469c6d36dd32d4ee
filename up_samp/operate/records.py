"""What is told and decided on the floor, as frozen values. Times in s since the day's start."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from up_samp.fleet.files import read_record
from up_samp.fleet.records import Order, Task

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

    ``due`` in the record is since the day's start; windows are since the order came.
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


@dataclass(frozen=True)
class Report:
    """What a robot tells at ``time``: its ``progress`` (m) along a motion, or its ``pose``, or that
    an activity is over (``done``).
    """

    robot: str
    time: float
    activity: str = ""
    progress: float | None = None
    pose: Pose | None = None
    done: bool = False
