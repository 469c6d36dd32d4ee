"""A plan as VDA 5050 orders (2.1 or 3.0): an order with updates a robot, and when to send them.

Orders carry no time. What keeps robots apart is which part of an order is *released*: an update
releases the next stretch once everything that it waits for has happened. ``releases.json`` lists
all messages in an order in which they can be sent, each with what has to be seen first (a robot's
``lastNodeSequenceId``, an action that is finished).

Source: VDA 5050, Interface for the communication between AGV and a master control, version 2.1.0.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from up_samp.export.legs import FloatArray, PathPiece, simplified, wrapped
from up_samp.export.steps import RobotStep, StepWait, localisation_of, steps_of
from up_samp.io import PlanDict
from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError

VERSION = "2.1.0"
LATER = "3.0.0"
MANUFACTURER = "unknown"
EPOCH = "1970-01-01T00:00:00.00Z"
"""Time stamp of the messages: whoever sends them puts the time of sending there."""

Message = dict[str, Any]
Event = tuple[Any, ...]


@dataclass
class _Order:
    """One robot's whole order: nodes and edges, and the step that each pair came from."""

    robot: str
    nodes: list[Message] = field(default_factory=list)
    edges: list[Message] = field(default_factory=list)
    steps: list[RobotStep] = field(default_factory=list)


def export(plan: PlanDict, folder: Path, version: str = VERSION) -> list[Path]:
    """Write ``ROBOT/order-NNN.json`` for each robot and ``releases.json``."""
    steps = steps_of(plan)
    others = steps.pop("", [])
    map_id = Path(plan["map"]["yaml"] or "plane").stem
    orders = [_order(plan, robot, own, map_id) for robot, own in steps.items()]
    seen = _where_seen(orders)
    names = file_names(order.robot for order in orders)
    written, releases = [], []
    for order in orders:
        for number, message, waits in _messages(order, plan["problem"]):
            name = Path(names[order.robot]) / f"order-{number:03d}.json"
            (folder / name.parent).mkdir(parents=True, exist_ok=True)
            written.append(_write(folder / name, later(message) if version == LATER else message))
            last = next(n["sequenceId"] for n in reversed(message["nodes"]) if n["released"])
            releases.append(_Release(str(name), order.robot, last, waits))
    error, less = localisation_of(plan)
    listed = [_listed(r, seen) for r in _sorted(releases, seen, others)]
    written.append(
        _write(
            folder / "releases.json",
            {
                "localisation": error,
                "narrow": less,
                "messages": listed,
                "activities": [
                    {"activity": s.activity, "after": [_condition(w, seen) for w in s.waits]}
                    for s in others
                ],
            },
        )
    )
    return written


def export_later(plan: PlanDict, folder: Path) -> list[Path]:
    """Write the same as orders of version 3.0."""
    return export(plan, folder, LATER)


def later(message: Message) -> Message:
    """Return a message in the words of version 3.0: other names, and no ends of edges."""
    found: Message = {**_renamed(message, LATER_WORDS), "version": LATER}
    found["timestamp"] = message["timestamp"].replace(".00Z", ".000Z")
    for edge in found.get("edges", ()):
        for key in _GONE:
            edge.pop(key, None)
    return found


def earlier(message: Message) -> Message:
    """Return a message of version 3.0 in the words of 2.1."""
    found: Message = _renamed(message, {later: known for known, later in LATER_WORDS.items()})
    return found


def _renamed(value: Any, words: Mapping[str, str]) -> Any:
    """Return values as JSON holds them with other keys, however deep."""
    if isinstance(value, list):
        return [_renamed(v, words) for v in value]
    if not isinstance(value, dict):
        return value
    return {words.get(key, key): _renamed(v, words) for key, v in value.items()}


LATER_WORDS = {
    "actionDescription": "actionDescriptor",
    "accelerationMax": "maximumAcceleration",
    "agvPosition": "mobileRobotPosition",
    "batteryCharge": "stateOfCharge",
    "batteryState": "powerSupply",
    "maxSpeed": "maximumSpeed",
    "nodeDescription": "nodeDescriptor",
    "positionInitialized": "localized",
    "speedMax": "maximumSpeed",
}
"""What is called otherwise in 3.0, of what is told or heard here; of two words that are one in 3.0
the last is what is heard.
"""
_GONE = ("startNodeId", "endNodeId", "rotationAllowed")


def file_names(robots: Iterable[str]) -> dict[str, str]:
    """Return a file name for each robot that leads nowhere else, each its own; "" is "others"."""
    found: dict[str, str] = {}
    for robot in robots:
        plain = re.sub(r"[^A-Za-z0-9_.-]", "_", robot).lstrip(".") or "others"
        name, count = plain, 2
        while name.lower() in (taken.lower() for taken in found.values()):
            name, count = f"{plain}-{count}", count + 1
        found[robot] = name
    return found


def _write(path: Path, data: Any) -> Path:
    path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


# ------------------------------------------------------------------------------ nodes and edges
def _order(plan: PlanDict, robot: str, steps: Sequence[RobotStep], map_id: str) -> _Order:
    order = _Order(robot)
    entry = next((o for o in plan["objects"] if o["name"] == robot), None)
    first = next((s.piece.rows[0, 1:] for s in steps if s.piece is not None), None)
    if first is None:
        if entry is None or entry["initial"] is None:
            raise ProblemError(f"the plan does not say where '{robot}' is")
        first = np.asarray(entry["initial"], dtype=np.float64)
    pose: FloatArray = first
    order.nodes.append(node_of(robot, 0, pose, map_id))
    for number, step in enumerate(steps, start=1):
        if step.piece is not None:
            pose = step.piece.rows[-1, 1:]
        node = node_of(robot, number, pose, map_id)
        if step.piece is None:
            node["actions"] = [_action(step)]
        order.edges.append(edge_of(robot, number, step.piece))
        order.nodes.append(node)
        order.steps.append(step)
    return order


def node_of(robot: str, number: int, pose: FloatArray, map_id: str) -> Message:
    """Return a node at a pose; it is not released."""
    return {
        "nodeId": f"{robot}-n{number}",
        "sequenceId": 2 * number,
        "released": False,
        "nodePosition": {
            "x": round(float(pose[0]), 6),
            "y": round(float(pose[1]), 6),
            "theta": wrapped(float(pose[2])),
            "mapId": map_id,
        },
        "actions": [],
    }


def _action(step: RobotStep) -> Message:
    return {
        "actionType": step.activity,
        "actionId": f"{step.robot}:{step.activity}",
        "blockingType": "HARD",
        "actionParameters": [{"key": "duration", "value": step.seconds}],
    }


def edge_of(robot: str, number: int, piece: PathPiece | None) -> Message:
    """Return the edge that leads to a node, along a piece of a path; it is not released."""
    edge: Message = {
        "edgeId": f"{robot}-e{number}",
        "sequenceId": 2 * number - 1,
        "released": False,
        "startNodeId": f"{robot}-n{number - 1}",
        "endNodeId": f"{robot}-n{number}",
        "actions": [],
    }
    if piece is None:
        return edge | {"length": 0.0}
    edge |= {"length": round(piece.length, 6)}
    if piece.direction == "turn":
        return edge | {"rotationAllowed": True}
    edge |= {"maxSpeed": round(piece.top_speed, 6), "trajectory": nurbs(piece.rows[:, 1:3])}
    if piece.direction in ("forward", "backward"):
        turned = 0.0 if piece.direction == "forward" else 3.141592
        edge |= {"orientationType": "TANGENTIAL", "orientation": turned, "rotationAllowed": False}
    return edge


def nurbs(points: FloatArray) -> Message:
    """Return a path (n, 2) as a NURBS of degree 1: its polyline, within ``PRECISION.nurbs``.

    Knots are clamped and go by arc length: n + degree + 1 of them.
    """
    chosen = simplified(points, PRECISION.nurbs)
    steps = np.hypot(*np.diff(chosen, axis=0).T)
    whole = float(steps.sum())
    inner = np.cumsum(steps)[:-1] / whole if whole > 0 else np.linspace(0, 1, len(chosen))[1:-1]
    return {
        "degree": 1,
        "knotVector": [0.0, 0.0, *(round(float(k), 9) for k in inner), 1.0, 1.0],
        "controlPoints": [
            {"x": round(float(x), 6), "y": round(float(y), 6), "weight": 1.0} for x, y in chosen
        ],
    }


# ---------------------------------------------------------------------------------- messages
def _messages(order: _Order, problem: str) -> list[tuple[int, Message, tuple[StepWait, ...]]]:
    """Return (number, message, what it waits for): the order first, then its updates.

    The order releases what waits for nothing; each update releases one more stretch, up to the
    next step that waits. An update begins with the last node that is released already.
    """
    gates = [k for k, s in enumerate(order.steps) if s.waits]
    cuts = [*gates, len(order.steps)]
    messages = [(0, _message(order, problem, 0, 0, cuts[0]), ())]
    found: list[tuple[int, Message, tuple[StepWait, ...]]] = list(messages)
    for number, (gate, until) in enumerate(zip(gates, cuts[1:], strict=True), start=1):
        message = _message(order, problem, number, gate, until)
        found.append((number, message, order.steps[gate].waits))
    return found


def _message(order: _Order, problem: str, number: int, begin: int, until: int) -> Message:
    nodes = [{**n, "released": k <= until} for k, n in enumerate(order.nodes) if k >= begin]
    edges = [{**e, "released": k < until} for k, e in enumerate(order.edges) if k >= begin]
    return {
        "headerId": number,
        "timestamp": EPOCH,
        "version": VERSION,
        "manufacturer": MANUFACTURER,
        "serialNumber": order.robot,
        "orderId": f"{problem}:{order.robot}",
        "orderUpdateId": number,
        "nodes": nodes,
        "edges": edges,
    }


# ---------------------------------------------------------------------------------- releases
@dataclass(frozen=True)
class _Release:
    """A message, up to which node (sequenceId) it releases, and what it waits for."""

    file: str
    robot: str
    last: int
    waits: tuple[StepWait, ...]


Seen = tuple[str, int, Message]
"""Where an event is seen: a robot, the sequenceId of the node that it has come to by then, and what
its state says: that it has passed the node, or finished (begun) an action.
"""


def _where_seen(orders: Sequence[_Order]) -> dict[Event, list[Seen]]:
    """Return how each event of the plan's dependencies shows in the robots' states."""
    seen: dict[Event, list[Seen]] = {}
    for order in orders:
        for number, step in enumerate(order.steps, start=1):
            # begun is known for sure once it is over; a drive that has begun is not reported
            for events, status in ((step.begins, "RUNNING"), (step.happens, "FINISHED")):
                sign: Message = {"lastNodeSequenceId": 2 * number}
                if step.piece is None:
                    action = f"{order.robot}:{step.activity}"
                    sign = {"actionId": action, "actionStatus": status}
                sign = {"serialNumber": order.robot, **sign}
                for event in events:
                    seen.setdefault(event, []).append((order.robot, 2 * number, sign))
    return seen


def _sorted(
    releases: Sequence[_Release], seen: dict[Event, list[Seen]], others: Sequence[RobotStep]
) -> list[_Release]:
    """Return the messages in an order in which each waits only for what earlier ones release.

    Raises :class:`ProblemError` where there is none: the dependencies have a cycle.
    """
    known = {event for step in others for event in (*step.begins, *step.happens)}
    released: dict[str, int] = {}
    left, found = list(releases), []
    while left:
        ready = next((r for r in left if _can_go(r, seen, released, known, left)), None)
        if ready is None:
            raise ProblemError("the plan's dependencies have a cycle: no order can be released")
        left.remove(ready)
        found.append(ready)
        released[ready.robot] = ready.last
    return found


def _can_go(
    release: _Release,
    seen: dict[Event, list[Seen]],
    released: dict[str, int],
    known: set[Event],
    left: Sequence[_Release],
) -> bool:
    if any(r.robot == release.robot for r in left[: left.index(release)]):
        return False
    return all(
        w.event in known
        or w.event[0] == "origin"
        or all(released.get(robot, -1) >= last for robot, last, _ in seen.get(w.event, ()))
        for w in release.waits
    )


def _listed(release: _Release, seen: dict[Event, list[Seen]]) -> Message:
    return {
        "file": release.file,
        "serialNumber": release.robot,
        "after": [_condition(w, seen) for w in release.waits],
    }


def _condition(wait: StepWait, seen: dict[Event, list[Seen]]) -> Message:
    """Return what has to be seen before a message may be sent."""
    signs = [dict(sign) for *_, sign in seen.get(wait.event, ())]
    return {"event": list(wait.event), "seconds": wait.lag, "seen": signs, "why": wait.why}
