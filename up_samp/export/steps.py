"""A plan as steps of each robot, and what each step has to wait for.

A step drives a stretch of a motion without a stop that the plan asks for, or does an activity on
the spot. Stretches end where the plan's dependencies speak of a point of the path, and where the
direction of travel changes. Whoever follows the steps, each robot in its order and each step only
when all that it waits for has happened, keeps the plan's promises however late robots are, and
however wrong about where they are, up to the localisation error of the plan's dependencies: a point
has been come to once so much more is told, and stretches end so much before a point that is not to
be left.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np

from up_samp.execution.files import dependencies_from_plan, event_to_list
from up_samp.execution.graph import ORIGIN, At, Edge, Event
from up_samp.execution.state import told_places
from up_samp.io import PlanDict
from up_samp.io.floors import map_number, own_frames
from up_samp.io.precision import PRECISION
from up_samp.io.sampling import in_formation
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.arrays import FloatArray
from up_samp.model.graphs import grouped

# ------------------ What robots drive, piece by piece, without a stop in between


@dataclass(frozen=True, eq=False)
class PathPiece:
    """A stretch of a motion between two rests or changes of direction.

    ``rows`` are ``[t, x, y, theta]`` (n, 4). ``direction``: ``"forward"``, ``"backward"``,
    ``"turn"`` (on the spot) or ``"any"`` (sideways in part).
    """

    rows: FloatArray
    direction: str

    @property
    def length(self) -> float:
        """Length of the way of the reference point, m."""
        return float(np.sum(np.hypot(*np.diff(self.rows[:, 1:3], axis=0).T)))

    @property
    def top_speed(self) -> float:
        """Largest speed of the reference point between two samples, m/s."""
        steps = np.hypot(*np.diff(self.rows[:, 1:3], axis=0).T)
        return float(np.max(steps / np.diff(self.rows[:, 0]), initial=0.0))


def pieces_of(motion: dict[str, Any]) -> list[PathPiece]:
    """Return the pieces of one entry of a plan's ``motions``, in order; rests are left out.

    Raises :class:`UnsupportedError` for motions in space.
    """
    rows = np.asarray(motion["samples"], dtype=np.float64)
    if rows.shape[1] != 4:
        raise UnsupportedError(
            f"'{motion['activity']}' moves '{motion['object']}' in space; this format knows the "
            "plane only"
        )
    kinds = list(itertools.starmap(_direction, itertools.pairwise(rows)))
    pieces: list[PathPiece] = []
    begin = 0
    for i in range(1, len(kinds) + 1):
        if i == len(kinds) or kinds[i] != kinds[begin]:
            if kinds[begin] != "rest":
                pieces.append(PathPiece(rows[begin : i + 1], kinds[begin]))
            begin = i
    return pieces


def _direction(a: FloatArray, b: FloatArray) -> str:
    dx, dy = b[1] - a[1], b[2] - a[2]
    turn = b[3] - a[3]
    if math.hypot(dx, dy) < PRECISION.still:
        return "rest" if abs(turn) < PRECISION.still else "turn"
    middle = (a[3] + b[3]) / 2
    angle = abs(_wrapped(math.atan2(dy, dx) - middle))
    if angle < PRECISION.straight:
        return "forward"
    return "backward" if angle > math.pi - PRECISION.straight else "any"


def _wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi]."""
    turned = math.remainder(angle, 2 * math.pi)
    return math.pi if turned == -math.pi else turned


def wrapped(angle: float) -> float:
    """Return an angle (rad) in [-pi, pi], rounded to 6 digits without leaving that range."""
    return min(max(round(_wrapped(angle), 6), -3.141592), 3.141592) + 0.0


def quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a turn by ``yaw`` (rad) about the vertical axis."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def robots_of(plan: PlanDict) -> list[str]:
    """Return who drives in the plan, in the order of its objects."""
    driven = {m["object"] for m in plan["motions"]}
    return [o["name"] for o in plan["objects"] if o["name"] in driven]


# ------------------ Steps, and what each has to wait for


@dataclass(frozen=True)
class StepWait:
    """An event that has to come first, and for how long (s) at least."""

    event: Event
    lag: float
    why: str

    @property
    def told(self) -> dict[str, Any]:
        """Itself as JSON would hold it."""
        return {"event": event_to_list(self.event), "seconds": self.lag, "why": self.why}


@dataclass(frozen=True, eq=False)
class RobotStep:
    """``piece`` is None for an activity on the spot, which then lasts ``seconds``.

    ``happens`` are the events that are true when the step is done; ``begins`` those that are true
    once it has begun. An activity that puts the robot elsewhere (a
    lift) ``lands`` it at a pose. Both, and a piece, are on the map number ``floor``.
    """

    robot: str
    activity: str
    waits: tuple[StepWait, ...]
    begins: tuple[Event, ...]
    happens: tuple[Event, ...]
    piece: PathPiece | None = None
    seconds: float = 0.0
    floor: int = 0
    lands: tuple[float, ...] = ()


def steps_of(plan: PlanDict) -> dict[str, list[RobotStep]]:
    """Return each robot's steps in order, in the frames of the maps' files; under "" the activities
    that no robot does.

    Raises :class:`ProblemError` for plans without dependencies: nobody could follow them safely
    without keeping to their times; :class:`UnsupportedError` where robots keep formation: steps say
    what each does by itself.
    """
    return StepReader(plan).steps()


class StepReader:
    """Reads one plan; see :func:`steps_of`. ``localisation``: how far (m) from where it tells to be
    a robot may be that follows the steps; ``less``: where only less is covered, in words.
    """

    def __init__(self, plan: PlanDict) -> None:
        if not isinstance(plan.get("dependencies"), dict):
            raise ProblemError(
                f"the plan of '{plan['problem']}' has no dependencies, without which such orders "
                "are unsafe; solve the problem again, or add them with up_samp.execution"
            )
        for ride in in_formation(plan):
            raise UnsupportedError(
                f"'{ride['object']}' keeps formation with '{ride['carrier']}' in "
                f"'{ride['activity']}': robots that are driven one by one cannot; trajectories.csv "
                "(export --to csv) has the ways of both"
            )
        dependencies = dependencies_from_plan(plan)
        graph, self.plan = dependencies.graph, plan
        places, squeezed = told_places(graph, dependencies.errors)
        self.localisation = dependencies.localisation
        self.less = [*map(str, dependencies.narrow), *map(str, squeezed)]
        self.waits: dict[Event, list[StepWait]] = {}
        self.points: dict[tuple[str, str], list[tuple[Event, float]]] = {}
        """The progress (m) to be told at which points have surely been come to, or not been left.
        """
        for k in sorted(places, key=lambda k: graph.events[k].progress):
            event = graph.events[k]
            self.points.setdefault((event.activity, event.object), []).append((event, places[k]))
        self.tasks = graph.tasks
        self.frames = own_frames(plan)
        self.puts = {(c["activity"], c["object"]): c for c in plan["changes"]}
        self.drivers = {m["object"] for m in plan["motions"]}
        self.motions = grouped(plan["motions"], itemgetter("activity"))
        for edge in graph.edges:
            if not self._kept_anyway(edge):
                wait = StepWait(edge.first, edge.lag, edge.why)
                self.waits.setdefault(edge.then, []).append(wait)
        for waits in self.waits.values():
            for wait in waits:  # robots tell that they are done without waiting for its end
                own = self.waits.get(wait.event, ()) if wait.event.at is At.END else ()
                waits += [
                    more for w in own if (more := replace(w, lag=wait.lag + w.lag)) not in waits
                ]

    def _kept_anyway(self, edge: Edge) -> bool:
        """Return whether a robot that does its steps in order cannot break an edge."""
        first, then = edge.first, edge.then
        if edge.kind == "duration":
            rows = [m["samples"] for m in self.motions.get(first.activity, ())]
            expected = self.tasks[first.activity].expected
            takes = min((r[-1][0] - r[0][0] for r in rows), default=expected)
            return bool(takes >= edge.lag - PRECISION.at_once)
        if first == ORIGIN or edge.lag > PRECISION.at_once:
            return False
        own = [self._robots(event) for event in (first, then)]
        return len(own[0]) == 1 and own[0] == own[1]

    def _robots(self, event: Event) -> set[str]:
        """Return who makes an event happen."""
        if event.object:
            return {event.object}
        moves = {m["object"] for m in self.motions.get(event.activity, ())}
        return moves.union(self.tasks[event.activity].who)

    def steps(self) -> dict[str, list[RobotStep]]:
        """Return each robot's steps in order."""
        found: dict[str, list[RobotStep]] = {}
        late: dict[str, list[StepWait]] = {}
        for activity in sorted(self.plan["activities"], key=lambda a: (a["start"], a["end"])):
            name = activity["name"]
            moves = {m["object"] for m in self.motions.get(name, ())}
            moves |= {o for a, o in self.puts if a == name} & self.drivers
            for robot in sorted(moves.union(self.tasks[name].who)) or [""]:
                steps = self._steps(robot, activity)
                waits = (*late.pop(robot, ()), *steps[0].waits)
                steps[0] = replace(steps[0], waits=tuple(dict.fromkeys(waits)))
                found.setdefault(robot, []).extend(steps)
                late[robot] = self.waits.get(Event(At.END, name), [])
        return found

    def _steps(self, robot: str, activity: Mapping[str, Any]) -> list[RobotStep]:
        name = activity["name"]
        motion = next((m for m in self.motions.get(name, ()) if m["object"] == robot), None)
        seconds = self.tasks[name].expected
        started, done = Event(At.START, name), Event(At.END, name)
        begin = tuple(self.waits.get(started, ()))
        if motion is None:
            put = self.puts.get((name, robot), {})
            floor = map_number(put)
            lands = self.frames[floor].of(put["configuration"]) if put else ()
            shared = robot, name, begin, (started,), (done,), None, seconds
            return [RobotStep(*shared, floor, lands)]
        steps: list[RobotStep] = []
        points = {place for _, place in self.points.get((name, robot), ())}
        floor = map_number(motion)
        for piece, low, high in stretches_of(motion, points):
            rows = piece.rows.copy()
            rows[:, 1:3] = self.frames[floor].points(rows[:, 1:3])
            rows[:, 3] += self.frames[floor].yaw
            waits = () if steps else begin
            begins = self._events(At.LEAVE, name, robot, low)
            waits += tuple(w for e in begins for w in self.waits.get(e, ()))
            happens = self._events(At.REACH, name, robot, high)
            own = replace(piece, rows=rows)
            steps.append(RobotStep(robot, name, waits, begins, happens, own, 0.0, floor))
        if not steps:  # it stays where it is
            return [RobotStep(robot, name, begin, (started,), (done,), None, seconds)]
        steps[0] = replace(steps[0], begins=(started, *steps[0].begins))
        steps[-1] = replace(steps[-1], happens=(*steps[-1].happens, done))
        return steps

    def _events(self, kind: At, name: str, robot: str, at: float) -> tuple[Event, ...]:
        points = self.points.get((name, robot), ())
        return tuple(e for e, p in points if e.at is kind and abs(p - at) <= PRECISION.near)


def stretches_of(
    motion: Mapping[str, Any], points: set[float]
) -> list[tuple[PathPiece, float, float]]:
    """Return the pieces of a motion, cut at ``points`` (m of progress), with their ends (m)."""
    rows = np.asarray(motion["samples"], dtype=np.float64)
    progress = np.asarray(motion["progress"], dtype=np.float64)
    found = []
    for piece in pieces_of(dict(motion)):
        low, high = (float(np.interp(piece.rows[k, 0], rows[:, 0], progress)) for k in (0, -1))
        inner = sorted(p for p in points if low + PRECISION.near < p < high - PRECISION.near)
        for a, b in itertools.pairwise([low, *inner, high]):
            part = _between(piece.rows, rows[:, 0], progress, a, b)
            found.append((replace(piece, rows=part), a, b))
    return found


def _between(
    piece: FloatArray, times: FloatArray, progress: FloatArray, low: float, high: float
) -> FloatArray:
    """Return the rows of a piece from progress ``low`` to ``high``, both ends included."""
    here = np.interp(piece[:, 0], times, progress)
    inner = piece[(here > low + PRECISION.near) & (here < high - PRECISION.near)]
    first, last = np.column_stack([np.interp((low, high), here, column) for column in piece.T])
    return np.vstack([first, inner, last])
