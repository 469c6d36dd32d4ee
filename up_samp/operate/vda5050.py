"""Master control of VDA 5050 over MQTT: commands become orders and their updates, states reports.

A motion is one order: the base is what its robot may drive now, and each update begins with the
last released node and releases more. What is done at a place is an order of one node with one
action. Progress comes from ``agvPosition`` and ``lastNodeSequenceId`` together. Robots of which
nothing is heard are told nothing new, and whoever has to wait for them waits.

Source: VDA 5050, Interface for the communication between AGV and a master control, 2.1.0; topics
``PREFIX/vMAJOR/MANUFACTURER/SERIAL/...``.
"""

from __future__ import annotations

import itertools
import json
import math
import queue
import ssl
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from up_samp.execution.executor import Executor
from up_samp.execution.reports import Command, Go, Hold
from up_samp.export.steps import stretches_of
from up_samp.export.vda5050 import edge_of, later, node_of
from up_samp.fleet.records import FleetRecords, corners_of
from up_samp.model import ProblemError
from up_samp.operate.records import Pose, Report

Message = dict[str, Any]
NEAR = 0.01
"""m of progress that are the same place."""
AGAIN = 1.0
"""Seconds after which what is over is told again, until it is believed."""
SHAPE = ("trajectory", "orientation", "orientationType", "rotationAllowed", "length")
"""What edges do not say to robots that drive straight from node to node."""
VERSIONS = ("2.0.0", "2.1.0", "3.0.0")


@dataclass
class Agv:
    """What is known of one robot: its last messages, and the order that it was sent last."""

    name: str
    online: bool = False
    state: Message = field(default_factory=dict)
    new: bool = False
    order: str = ""
    activity: str = ""
    update: int = -1
    nodes: list[tuple[int, float]] = field(default_factory=list)
    """(sequenceId, progress in m) of the nodes that are released."""
    paused: bool = False
    cancelled: str = ""
    """The order of which the rest was cancelled last."""
    over: float = -math.inf
    """When it was last told that its order is over."""


class MasterControl:
    """The robots behind a broker. ``types``: what an action is called for what is done at places
    (``pick``, ``deliver``, ``task``, ``open``); ``spacing`` (m): for robots that
    know no trajectories and drive straight from node to node, which are at most so far apart then.

    :raises ProblemError: where the broker cannot be reached, or the version is not known.
    """

    def __init__(
        self,
        site: FleetRecords,
        host: str,
        port: int = 1883,
        *,
        prefix: str = "uagv",
        manufacturer: str = "up_samp",
        version: str = "2.1.0",
        user: str | None = None,
        password: str | None = None,
        tls: bool = False,
        types: Mapping[str, str] | None = None,
        spacing: float = 0.0,
        map_id: str = "map",
    ) -> None:
        if version not in VERSIONS:
            raise ProblemError(f"VDA 5050 {version} is not known: {', '.join(VERSIONS)}")
        self.site, self.version, self.manufacturer = site, version, manufacturer
        self.types, self.spacing, self.map_id = dict(types or {}), spacing, map_id
        self.root = f"{prefix}/v{version.partition('.')[0]}/{manufacturer}"
        self.agvs = {name: Agv(name) for name in site.robots}
        self.faults: list[str] = []
        """What robots told that does not fit the site file, in words."""
        self._inbox: queue.SimpleQueue[tuple[str, str, bytes]] = queue.SimpleQueue()
        self._headers: dict[tuple[str, str], itertools.count[int]] = {}
        self._motions: dict[str, Message] = {}
        self._meanings: Mapping[str, Any] = {}
        self._expected: Mapping[str, float] = {}
        self._lengths: dict[str, float] = {}
        self._number = 0
        self.client = mqtt.Client(
            CallbackAPIVersion.VERSION2, f"up_samp-{site.name}-{time.time_ns()}"
        )
        if user is not None:
            self.client.username_pw_set(user, password)
        if tls:
            self.client.tls_set_context(ssl.create_default_context())
        self.client.on_connect = self._connected
        self.client.on_message = self._arrived
        try:
            self.client.connect(host, port, keepalive=10)
        except OSError as error:
            raise ProblemError(f"no broker at {host}:{port}: {error}") from error
        self.client.loop_start()

    def close(self) -> None:
        """Leave the broker."""
        self.client.disconnect()
        self.client.loop_stop()

    def _connected(self, client: mqtt.Client, *_: Any) -> None:
        for name in self.agvs:
            for topic in ("state", "connection", "factsheet"):
                client.subscribe(
                    f"{self.root}/{name}/{topic}", qos=1 if topic == "connection" else 0
                )
        for name in self.agvs:
            self.instant(name, "factsheetRequest")
            self.instant(name, "stateRequest")

    def _arrived(self, _client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage) -> None:
        name, topic = message.topic.split("/")[-2:]
        self._inbox.put((name, topic, message.payload))

    # ------------------------------------------------------------------ what robots tell

    def reports(self, now: float) -> list[Report]:
        """Return what robots have told since the last call."""
        while True:
            try:
                name, topic, payload = self._inbox.get_nowait()
            except queue.Empty:
                break
            self._read(name, topic, payload)
        return [r for agv in self.agvs.values() for r in self._reported(agv, now)]

    def _read(self, name: str, topic: str, payload: bytes) -> None:
        agv = self.agvs.get(name)
        try:
            data = json.loads(payload)
        except ValueError:
            return
        if agv is None or not isinstance(data, dict):
            return
        if topic == "connection":
            agv.online = data.get("connectionState") == "ONLINE"
            if agv.online:
                self.instant(name, "stateRequest")
        elif topic == "factsheet":
            self._check(name, data)
        elif topic == "state" and not _older(data, agv.state):
            agv.state, agv.new = data, True
            agv.online = True

    def _check(self, name: str, sheet: Message) -> None:
        """Compare a factsheet with the robot's type in the site file."""
        kind = self.site.robot_types[self.site.robots[name].type]
        told = sheet.get("physicalParameters", {})
        for key, own in (("speedMax", kind.v_max), ("accelerationMax", kind.a_max)):
            if isinstance(told.get(key), int | float) and told[key] < own - 1e-9:
                self.faults.append(f"{name}: its {key} is {told[key]:g}, in the site file {own:g}")
        corners = corners_of(kind.footprint)
        for key, axis in (("length", 0), ("width", 1)):
            own = max(c[axis] for c in corners) - min(c[axis] for c in corners)
            if isinstance(told.get(key), int | float) and told[key] > own + 1e-3:
                self.faults.append(
                    f"{name}: its {key} is {told[key]:g} m, in the site file {own:g}"
                )

    def _reported(self, agv: Agv, now: float) -> list[Report]:
        state = agv.state
        if not agv.activity or state.get("orderId") != agv.order:
            return []
        fresh, agv.new = agv.new, False
        moves = agv.activity in self._motions
        found = []
        if fresh and moves and state.get("orderUpdateId") == agv.update:
            found += self._where(agv, now)
        if self._finished(agv, moves) and (fresh or now >= agv.over + AGAIN):
            agv.over = now
            found.append(Report(agv.name, now, agv.activity, done=True))
        return found

    def _where(self, agv: Agv, now: float) -> list[Report]:
        position = agv.state.get("agvPosition") or {}
        passed = max(
            (s for q, s in agv.nodes if q <= agv.state.get("lastNodeSequenceId", 0)), default=0.0
        )
        try:
            pose: Pose = (float(position["x"]), float(position["y"]), float(position["theta"]))
        except (KeyError, TypeError, ValueError):
            return [Report(agv.name, now, agv.activity, progress=passed)]
        if not position.get("positionInitialized", position.get("localized", True)):
            return [Report(agv.name, now, agv.activity, progress=passed)]
        return [Report(agv.name, now, agv.activity, pose=pose)]

    def _finished(self, agv: Agv, moves: bool) -> bool:
        """Return whether a robot has done its order."""
        if moves:
            last, at = agv.nodes[-1] if agv.nodes else (0, 0.0)
            whole = at >= self._lengths.get(agv.activity, math.inf) - NEAR
            there = agv.state.get("lastNodeSequenceId") == last
            return (
                whole and there and not agv.state.get("driving") and not agv.state.get("nodeStates")
            )
        return any(
            a.get("actionId") == agv.order and a.get("actionStatus") == "FINISHED"
            for a in agv.state.get("actionStates", ())
        )

    # ------------------------------------------------------------------ what robots are told

    def follow(self, executor: Executor) -> None:
        """Know the motions of another plan."""
        plan = executor.plan
        self._number = plan["number"]
        self._motions = {m["activity"]: _whole(m) for m in plan["motions"]}
        self._lengths = {name: m["progress"][-1] for name, m in self._motions.items()}
        self._meanings = plan["meanings"]
        self._expected = {n: t.expected for n, t in executor.state.graph.tasks.items()}

    def tell(self, commands: Mapping[str, Command], now: float) -> None:
        """Send what is new."""
        for who, command in commands.items():
            agv = self.agvs.get(who)
            if agv is None or not agv.online or not agv.state:
                continue
            if isinstance(command, Hold):
                self._hold(agv)
                continue
            what = command.motion if isinstance(command, Go) else command.activity
            if what != agv.activity and not self._free(agv):
                continue  # a pause goes on until what was released before is cancelled
            if agv.paused:
                agv.paused = False
                self.instant(agv.name, "stopPause")
            if isinstance(command, Go):
                self._go(agv, command)
            elif agv.activity != command.activity:
                self._do(agv, command.activity)

    def _free(self, agv: Agv) -> bool:
        """Return whether a robot can be sent another order: its last one is over. What is left of
        one that ends early (never released, or paused) is cancelled.
        """
        state = agv.state
        left = state.get("nodeStates") or ()
        if not agv.order or state.get("orderId") != agv.order or not (left or state.get("driving")):
            return True
        ends = agv.paused or not any(n.get("released") for n in left)
        stands = ends and not state.get("driving")
        if stands and agv.cancelled != agv.order:
            agv.cancelled = agv.order
            self.instant(agv.name, "cancelOrder")
        return False

    def _hold(self, agv: Agv) -> None:
        """Pause a robot that might drive on by what was released."""
        left = any(n.get("released") for n in agv.state.get("nodeStates", ()))
        if left and not agv.paused and agv.order and agv.activity:
            agv.paused = True
            self.instant(agv.name, "startPause")

    def _go(self, agv: Agv, command: Go) -> None:
        known = agv.activity == command.motion
        if not known:
            self._begin(agv, command.motion)
        if known and agv.nodes and command.until <= agv.nodes[-1][1] + NEAR:
            return
        motion = self._motions[command.motion]
        released = agv.nodes[-1] if agv.nodes else (0, 0.0)
        whole = self._lengths[command.motion]
        at = {released[1], command.until, *self._spaced(whole)}
        pieces = [p for p in stretches_of(motion, at) if p[2] > released[1] + NEAR]
        number = released[0] // 2
        nodes = [self._node(agv, number, self._pose(motion, released[1]), True)]
        edges = []
        added = [] if agv.nodes else [released]
        for piece, _, high in pieces:
            number += 1
            free = high <= command.until + NEAR
            nodes.append(self._node(agv, number, piece.rows[-1, 1:], free))
            edge = {**edge_of(agv.name, number, piece), "released": free}
            edges.append({k: v for k, v in edge.items() if not self.spacing or k not in SHAPE})
            added += [(2 * number, high)] if free else []
        if agv.nodes and not added:
            return  # a rounding: nothing new may be driven
        agv.update += 1
        agv.nodes = [*agv.nodes, *added]
        self._send_order(agv, nodes, edges)

    def _spaced(self, whole: float) -> list[float]:
        if not self.spacing:
            return []
        return [self.spacing * k for k in range(1, int(whole / self.spacing) + 1)]

    def _begin(self, agv: Agv, activity: str) -> None:
        """Begin an order, or go on with the one that the robot has already (after a restart)."""
        agv.activity = agv.order = activity
        agv.nodes, agv.update, agv.over = [], -1, -math.inf
        state = agv.state
        if state.get("orderId") == activity and activity in self._motions:
            agv.update = int(state.get("orderUpdateId", 0))
            last = max(
                [state.get("lastNodeSequenceId", 0)]
                + [n["sequenceId"] for n in state.get("nodeStates", ()) if n.get("released")]
            )
            at = [
                n.get("nodePosition") for n in state.get("nodeStates", ())
                if n["sequenceId"] == last
            ]  # fmt: skip
            agv.nodes = [(0, 0.0), (last, self._progress(activity, at, state))]

    def _progress(self, activity: str, at: list[Any], state: Message) -> float:
        """Return how far along a motion a released node is: where it says, or the robot stands."""
        place = next((p for p in at if p), None) or state.get("agvPosition") or {}
        rows, s = self._motions[activity]["samples"], self._motions[activity]["progress"]
        if "x" not in place:
            return 0.0
        gaps = [math.hypot(r[1] - place["x"], r[2] - place["y"]) for r in rows]
        return float(s[gaps.index(min(gaps))])

    def _do(self, agv: Agv, activity: str) -> None:
        agv.activity = agv.order = activity
        agv.nodes, agv.update, agv.over = [], 0, -math.inf
        if agv.state.get("orderId") == activity:
            return  # it has it from before a restart
        kind, what, _ = self._meanings[activity]
        position = agv.state.get("agvPosition") or {}
        pose = tuple(float(position.get(k, 0.0)) for k in ("x", "y", "theta"))
        node = self._node(agv, 0, pose, True)
        node["actions"] = [
            {
                "actionType": self.types.get(kind, kind),
                "actionId": activity,
                "actionDescription": what,
                "blockingType": "HARD",
                "actionParameters": [{"key": "duration", "value": self._expected[activity]}],
            }
        ]
        self._send_order(agv, [node], [])

    def _pose(self, motion: Message, at: float) -> Any:
        rows, s = np.asarray(motion["samples"])[:, 1:], np.asarray(motion["progress"])
        return [float(np.interp(at, s, rows[:, k])) for k in range(3)]

    def _node(self, agv: Agv, number: int, pose: Any, released: bool) -> Message:
        node = node_of(agv.name, number, pose, self.map_id)
        return {**node, "released": released}

    def _send_order(self, agv: Agv, nodes: list[Message], edges: list[Message]) -> None:
        order = {
            **self._head(agv.name, "order"),
            "orderId": agv.order,
            "orderUpdateId": agv.update,
            "nodes": nodes,
            "edges": edges,
        }
        if self.version.startswith("3"):
            order = {**later(order), "timestamp": order["timestamp"]}
        self._send(agv.name, "order", order)

    def instant(self, robot: str, kind: str, **parameters: Any) -> None:
        """Send an instant action: ``startPause``, ``stopPause``, ``cancelOrder``, ``stateRequest``,
        ``factsheetRequest``.
        """
        action = {
            "actionType": kind,
            "actionId": f"{kind}-{time.time_ns()}",
            "blockingType": "NONE" if kind.endswith("Request") else "HARD",
            "actionParameters": [{"key": k, "value": v} for k, v in parameters.items()],
        }
        message = {**self._head(robot, "instantActions"), "actions": [action]}
        if self.version.startswith("2.0"):
            message["instantActions"] = [action]  # as some clients of 2.0 have it
        self._send(robot, "instantActions", message)

    def _head(self, robot: str, topic: str) -> Message:
        header = self._headers.setdefault((robot, topic), itertools.count())
        return {
            "headerId": next(header),
            "timestamp": datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z",
            "version": self.version,
            "manufacturer": self.manufacturer,
            "serialNumber": robot,
        }

    def _send(self, robot: str, topic: str, message: Message) -> None:
        self.client.publish(f"{self.root}/{robot}/{topic}", json.dumps(message), qos=0)


def _whole(motion: Message) -> Message:
    """Return a motion with progress from where its robot began it."""
    return {**motion, "progress": [p + motion.get("from", 0.0) for p in motion["progress"]]}


def _older(new: Message, old: Message) -> bool:
    """Return whether a state was sent before one that is known (messages come in any order)."""
    a, b = new.get("timestamp"), old.get("timestamp")
    if not isinstance(a, str) or not isinstance(b, str) or a == b:
        return bool(old) and new.get("headerId") == old.get("headerId") and a == b
    return a < b
