"""Plans that survive the floor: what depends on what, and what to do now."""

from up_samp.execution.astray import Overrun
from up_samp.execution.build import Dependencies, dependencies_of
from up_samp.execution.executor import Executor
from up_samp.execution.files import (
    dependencies_from_plan,
    dependency_faults,
    shown_with_dependencies,
    with_dependencies,
)
from up_samp.execution.floor import Delays
from up_samp.execution.graph import At, Bound, Edge, Event, Graph, PlannedTask
from up_samp.execution.remaining import Remaining, Surprise
from up_samp.execution.reports import Command, Do, Go, Heard, Hold, Reply
from up_samp.execution.simulate import (
    Reorderer,
    Simulation,
    remaining_at,
    simulate,
    solve_remaining,
)

__all__ = [
    "At",
    "Bound",
    "Command",
    "Delays",
    "Dependencies",
    "Do",
    "Edge",
    "Event",
    "Executor",
    "Go",
    "Graph",
    "Heard",
    "Hold",
    "Overrun",
    "PlannedTask",
    "Remaining",
    "Reorderer",
    "Reply",
    "Simulation",
    "Surprise",
    "dependencies_from_plan",
    "dependencies_of",
    "dependency_faults",
    "remaining_at",
    "shown_with_dependencies",
    "simulate",
    "solve_remaining",
    "with_dependencies",
]
