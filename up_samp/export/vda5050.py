"""A plan as VDA 5050 orders (2.1 or 3.0): an order with updates a robot, and when to send them.

Orders carry no time. What keeps robots apart is which part of an order is *released*: an update
releases the next stretch once everything that it waits for has happened. ``releases.json`` lists
all messages in an order in which they can be sent, each with what has to be seen first (a robot's
``lastNodeSequenceId``, an action that is finished).

Source: VDA 5050, Interface for the communication between AGV and a master control, version 2.1.0.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from up_samp.execution.graph import ORIGIN, Event
from up_samp.export.steps import PathPiece, RobotStep, StepReader, StepWait, wrapped
from up_samp.io import PlanDict
from up_samp.io.floors import map_number, maps_of, named_maps, own_frames
from up_samp.io.precision import PRECISION
from up_samp.model import ProblemError
from up_samp.model.arrays import FloatArray
from up_samp.model.graphs import grouped

VERSION = "2.1.0"
LATER = "3.0.0"
MANUFACTURER = "unknown"
EPOCH = "1970-01-01T00:00:00.00Z"
"""Time stamp of the messages: whoever sends them puts the time of sending there."""

Message = dict[str, Any]
At = tuple[int, int]
"""A node of a robot: the how many-th of its orders (from 0), and the sequenceId there."""
Release = tuple[Message, str, At, tuple[StepWait, ...]]
"""A message as ``releases.json`` lists it, whose it is, up to which node it releases, and what it
waits for.
"""


def export(plan: PlanDict, folder: Path, version: str = VERSION) -> list[Path]:
    """Write ``ROBOT/order-NNN.json`` for each robot and ``releases.json``."""
    reader = StepReader(plan)
    steps = reader.steps()
    others = steps.pop("", [])
    seen = _where_seen(plan, steps)
    names = file_names(steps)
    written: list[Path] = []
    releases: list[Release] = []
    for robot, own in steps.items():
        for number, (order, message, waits) in enumerate(_messages(plan, robot, own)):
            name = Path(names[robot]) / f"order-{number:03d}.json"
            (folder / name.parent).mkdir(parents=True, exist_ok=True)
            written.append(_write(folder / name, later(message) if version == LATER else message))
            last = next(n["sequenceId"] for n in reversed(message["nodes"]) if n["released"])
            after = [_condition(w, seen) for w in waits]
            listed = {"file": str(name), "serialNumber": robot, "after": after}
            releases.append((listed, robot, (order, last), waits))
    written.append(
        _write(
            folder / "releases.json",
            {
                "localisation": reader.localisation,
                "narrow": reader.less,
                "maps": named_maps(plan),
                "messages": _sorted(releases, seen, others),
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
    for edge, key in itertools.product(found.get("edges", ()), _GONE):
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
def _whole(
    plan: PlanDict, robot: str, steps: Sequence[RobotStep]
) -> list[tuple[list[Message], list[Message]]]:
    """Return all nodes and edges of each of a robot's orders, an edge to each node but the first.
    By a lift a robot goes along an edge, and spawns at a node on the map of the other floor.
    """
    maps = list(named_maps(plan))
    entry: Mapping[str, Any] = next((o for o in plan["objects"] if o["name"] == robot), {})
    if entry.get("initial") is None:
        raise ProblemError(f"the plan does not say where '{robot}' is")
    floor = map_number(entry)
    pose: FloatArray = np.array(own_frames(plan)[floor].of(entry["initial"]))
    here, orders = node_of(robot, 0, pose, maps[floor]), list[tuple[list[Message], list[Message]]]()
    for where, ((order, number), step) in enumerate(zip(_nodes_of(steps), steps, strict=True), 1):
        if order == len(orders):
            orders.append(([{**here, "sequenceId": 0, "actions": []}], []))
        nodes, edges = orders[order]
        if step.piece is not None:
            pose, floor = step.piece.rows[-1, 1:], step.floor
        elif step.lands:
            pose, floor = np.asarray(step.lands, dtype=np.float64), step.floor
        if number == len(nodes):
            edge = edge_of(robot, where, step.piece, entry.get("v_max", math.inf))
            here = node_of(robot, where, pose, maps[floor])
            edges.append({**edge, "sequenceId": 2 * number - 1})
            nodes.append({**here, "sequenceId": 2 * number})
        if step.piece is None:
            (edges if step.lands else nodes)[-1]["actions"].append(_action(step, plan))
    for nodes, edges in orders:
        _call_by_place(plan, nodes, edges)
    return orders


def _call_by_place(plan: PlanDict, nodes: list[Message], edges: list[Message]) -> None:
    """Call nodes as the site calls the places where they lie."""
    maps, heights = [*named_maps(plan)], [m.height for m in maps_of(plan)]
    for name, place in plan.get("words", {}).get("places", {}).items():
        number = heights.index(place["height"])
        x, y, theta = own_frames(plan)[number].of(place["pose"])
        for node in nodes:
            at = node["nodePosition"]
            near = math.hypot(at["x"] - x, at["y"] - y) <= PRECISION.nurbs
            alike = math.cos(at["theta"] - theta) >= math.cos(PRECISION.nurbs)
            if near and alike and at["mapId"] == maps[number]:
                node |= {"nodeId": name, "nodeDescription": name}
    for edge, (a, b) in zip(edges, itertools.pairwise(nodes), strict=True):
        edge |= {"startNodeId": a["nodeId"], "endNodeId": b["nodeId"]}


def _nodes_of(steps: Sequence[RobotStep]) -> list[tuple[int, int]]:
    """Return the order and its node at which each step is over. What waits for nothing is an action
    of the node come to before; for what waits the order ends there, and another one begins.
    """
    found: list[tuple[int, int]] = []
    order = number = 0
    for step in steps:
        if step.lands or step.piece is not None:
            number += 1
        elif step.waits and found:
            order, number = order + 1, 0
        found.append((order, number))
    return found


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


def _action(step: RobotStep, plan: PlanDict) -> Message:
    """Return an action, in the site's words where the plan has some."""
    told = plan.get("words", {}).get("actions", {}).get(step.activity, {})
    parameters = {"duration": step.seconds, **told.get("parameters", {})}
    return {
        "actionType": told.get("type", step.activity),
        "actionId": f"{step.robot}:{step.activity}",
        "blockingType": "HARD",
        "actionParameters": [{"key": key, "value": value} for key, value in parameters.items()],
    }


def edge_of(robot: str, number: int, piece: PathPiece | None, v_max: float = math.inf) -> Message:
    """Return the edge that leads to a node, along a piece of a path that is driven no faster than
    ``v_max`` (m/s); it is not released.
    """
    edge: Message = {
        "edgeId": f"{robot}-e{number}",
        "sequenceId": 2 * number - 1,
        "released": False,
        "startNodeId": f"{robot}-n{number - 1}",
        "endNodeId": f"{robot}-n{number}",
        "actions": [],
    }
    if piece is None:  # by a lift: no way on a map
        return edge
    edge |= {"length": round(piece.length, 6)}
    if piece.direction == "turn":
        return edge | {"rotationAllowed": True}
    speed = min(round(piece.top_speed, 6), v_max)
    edge |= {"maxSpeed": speed, "trajectory": nurbs(piece.rows[:, 1:3])}
    if piece.direction in ("forward", "backward"):
        turned = 0.0 if piece.direction == "forward" else 3.141592
        edge |= {"orientationType": "TANGENTIAL", "orientation": turned, "rotationAllowed": False}
    return edge


def nurbs(points: FloatArray) -> Message:
    """Return a path (n, 2) as a NURBS of degree 1: its polyline, within ``PRECISION.nurbs``.

    Knots are clamped and go by arc length: n + degree + 1 of them.
    """
    line = shapely.LineString(points).simplify(PRECISION.nurbs, preserve_topology=False)
    chosen = np.asarray(line.coords, dtype=np.float64)
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
def _messages(
    plan: PlanDict, robot: str, steps: Sequence[RobotStep]
) -> Iterator[tuple[int, Message, tuple[StepWait, ...]]]:
    """Yield a robot's messages, each with the number of its order (from 0) and what it waits for:
    of each order that first, then its updates.

    An order releases what waits for nothing; each update releases one more stretch, up to the next
    drive that waits. An update begins with the last node that is released already.
    """
    header, before = itertools.count(), list[StepWait]()
    for order, (nodes, edges) in enumerate(_whole(plan, robot, steps)):
        parts = zip(_nodes_of(steps), steps, strict=True)
        own = [(number, step) for (which, number), step in parts if which == order]
        begins = (*before, *(w for number, step in own if number == 0 for w in step.waits))
        gates = [(n - 1, step.waits) for n, step in own if step.waits and n > 0]
        gates.insert(0, (0, begins))
        # whoever has an order is through with it before the next one
        before = [StepWait(own[-1][1].happens[-1], 0.0, "the order before")]
        ends = [*(until for until, _ in gates[1:]), len(edges)]
        for number, ((begin, waits), until) in enumerate(zip(gates, ends, strict=True)):
            message: Message = {
                "headerId": next(header),
                "timestamp": EPOCH,
                "version": VERSION,
                "manufacturer": MANUFACTURER,
                "serialNumber": robot,
                "orderId": _order_id(plan, robot, order),
                "orderUpdateId": number,
                "nodes": [{**nodes[k], "released": k <= until} for k in range(begin, len(nodes))],
                "edges": [{**edges[k], "released": k < until} for k in range(begin, len(edges))],
            }
            yield order, message, waits


def _order_id(plan: PlanDict, robot: str, order: int) -> str:
    return f"{plan['problem']}:{robot}:{order + 1}"


# ---------------------------------------------------------------------------------- releases
Seen = tuple[str, At, Message]
"""Where an event is seen: a robot, the node that it has come to by then, and what its state says:
that it has passed the node, or finished (begun) an action.
"""


def _where_seen(
    plan: PlanDict, steps_of_all: Mapping[str, Sequence[RobotStep]]
) -> dict[Event, list[Seen]]:
    """Return how each event of the plan's dependencies shows in the robots' states."""
    seen: dict[Event, list[Seen]] = {}
    for robot, steps in steps_of_all.items():
        for (order, number), step in zip(_nodes_of(steps), steps, strict=True):
            # begun is known for sure once it is over; a drive that has begun is not reported
            for events, status in ((step.begins, "RUNNING"), (step.happens, "FINISHED")):
                sign: Message = {"lastNodeSequenceId": 2 * number}
                if step.piece is None:
                    action = f"{robot}:{step.activity}"
                    sign = {"actionId": action, "actionStatus": status}
                sign = {"serialNumber": robot, "orderId": _order_id(plan, robot, order), **sign}
                for event in events:
                    seen.setdefault(event, []).append((robot, (order, 2 * number), sign))
    return seen


def _sorted(
    releases: Sequence[Release], seen: dict[Event, list[Seen]], others: Sequence[RobotStep]
) -> list[Message]:
    """Return the messages in an order in which each waits only for what earlier ones release.

    Raises :class:`ProblemError` where there is none: the dependencies have a cycle.
    """
    known = {ORIGIN, *(e for step in others for e in (*step.begins, *step.happens))}
    released: dict[str, At] = {}
    queues = grouped(releases, itemgetter(1))

    def can_go(release: Release) -> bool:
        needed = (w.event for w in release[3] if w.event not in known)
        at = (sign for event in needed for sign in seen.get(event, ()))
        return all(released.get(robot, (-1, 0)) >= last for robot, last, _ in at)

    found: list[Message] = []
    while len(found) < len(releases):
        ready = next((q for q in queues.values() if q and can_go(q[0])), None)
        if ready is None:
            raise ProblemError("the plan's dependencies have a cycle: no order can be released")
        listed, robot, released[robot], _ = ready.pop(0)
        found.append(listed)
    return found


def _condition(wait: StepWait, seen: dict[Event, list[Seen]]) -> Message:
    """Return what has to be seen before a message may be sent."""
    signs = [dict(sign) for *_, sign in seen.get(wait.event, ())]
    return {**wait.told, "seen": signs}
