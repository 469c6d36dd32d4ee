"""Plans that survive the floor: what depends on what, what to do now, what to do when it is late."""

from up_samp.execution.build import Dependencies, dependencies_of
from up_samp.execution.graph import At, Bound, Edge, Event, Graph, Task

__all__ = ["At", "Bound", "Dependencies", "Edge", "Event", "Graph", "Task", "dependencies_of"]
