"""Master control of VDA 5050 over MQTT: commands become orders and their updates, states reports.

A motion is one order: the base is what its robot may drive now, and each update begins with the
last released node and releases more. What is done at a place is an order of one node with one
action. Progress comes from ``agvPosition`` and ``lastNodeSequenceId`` together. Robots of which
nothing is heard are told nothing new, and whoever has to wait for them waits.

Messages may be lost: all that is told is told again until the robot's state shows that it is known
there, an order by ``orderId`` and ``orderUpdateId``, a pause or a cancellation by its ``actionId``
among ``actionStates``. A robot is sent another order only once its state shows that nothing is left
of the last one, and that one that may still be on its way has been cancelled.

Source: VDA 5050, Interface for the communication between AGV and a master control, 2.1.0; topics
``PREFIX/vMAJOR/MANUFACTURER/SERIAL/...``.
"""

from __future__ import annotations

import itertools
import json
import math
import queue
import re
import ssl
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from up_samp.execution.astray import place_of, pose_in
from up_samp.execution.executor import Executor
from up_samp.execution.graph import PlannedTask
from up_samp.execution.reports import Command, Go, Hold, Report
from up_samp.execution.tolerances import TOLERANCES
from up_samp.export.steps import PathPiece, pieces_of, wrapped
from up_samp.export.vda5050 import LATER, earlier, edge_of, later, node_of
from up_samp.fleet.fields import corners_of
from up_samp.fleet.records import FleetRecords
from up_samp.model import ProblemError
from up_samp.operate.horizon import driven_before
from up_samp.operate.records import Pose
from up_samp.operate.stitch import whole_motion
from up_samp.operate.upkeep import action_of
from up_samp.operate.zones import stretches_told

Message = dict[str, Any]
BEGUN_ANEW = "~"
"""What stands between an activity and how often its order was begun anew."""
NEAR = 0.01
"""m of progress that are the same place."""
AGAIN = 1.0
"""Seconds after which what is over is told again, until it is believed."""
BROKEN = "its connection is broken: nothing is told to it until it is back"
SHAPE = ("trajectory", "orientation", "orientationType", "rotationAllowed", "length")
"""What edges do not say to robots that drive straight from node to node."""
TYPES = {"charge": "startCharging"}
"""What is called otherwise in the standard than here."""
VERSIONS = ("2.0.0", "2.1.0", LATER)
FRACTION = re.compile(r"\.\d+")
"""Of a second, in a time stamp."""
LISTS = ("nodeStates", "actionStates", "instantActionStates")
NUMBERS = (
    "orderUpdateId", "lastNodeSequenceId", "sequenceId", "x", "y", "theta", "deviationRange",
    "batteryCharge", "localizationScore", "speedMax", "accelerationMax", "length", "width",
)  # fmt: skip
KINDS: dict[str, Any] = {
    **dict.fromkeys(NUMBERS, (int, float)),
    **dict.fromkeys(LISTS, list),
    **dict.fromkeys((f"one of {key}" for key in LISTS), dict),
    **dict.fromkeys(("message", "agvPosition", "nodePosition", "batteryState"), dict),
    "physicalParameters": dict,
    "orderId": str,
}
"""What is read of messages, and of which kind it is."""


@dataclass
class Agv:
    """What is known of one robot: its last messages, and the order that it was sent last."""

    name: str
    online: bool = False
    state: Message = field(default_factory=dict)
    seen: Message = field(default_factory=dict)
    """The last message of what there is to be seen of it, which may come more often than states."""
    new: bool = False
    order: str = ""
    activity: str = ""
    update: int = -1
    nodes: list[tuple[int, float]] = field(default_factory=list)
    """(sequenceId, progress in m) of the nodes that are released."""
    sent: list[Message] = field(default_factory=list)
    """What was sent of the order and its state does not show yet."""
    sent_at: float = -math.inf
    known: bool = False
    """Whether its state has shown the order."""
    pause: Instant | None = None
    """The last pause, or end of one, that it was told (None: none since the process began)."""
    cancel: Instant | None = None
    """The cancellation of its order."""
    dropped: dict[str, int] = field(default_factory=dict)
    """How often the orders of activities ended early, and were begun anew."""
    over: float = -math.inf
    """When it was last told that its order is over."""
    map_id: str = ""
    """The map of which it told first: elsewhere its poses say nothing."""

    def begin(self, activity: str) -> None:
        """Have another order, that of an activity ("": none); it may have it from before a restart
        of this process.
        """
        self.activity = activity
        name, _, number = str(self.state.get("orderId", "")).partition(BEGUN_ANEW)
        if activity and name == activity and f"0{number}".isdecimal():
            self.dropped.setdefault(activity, int(f"0{number}"))
        again = self.dropped.get(activity, 0)
        self.order = f"{activity}{BEGUN_ANEW}{again}" if again else activity
        self.nodes, self.update, self.over = [], -1, -math.inf
        self.sent, self.known, self.cancel = [], False, None

    @property
    def position(self) -> Message:
        """Where it told last to be."""
        by = _sent_after(self.seen, self.state)  # by another clock its state counts
        newest = self.seen if 0.0 <= by <= TOLERANCES.clock else self.state
        found: Message = newest.get("agvPosition") or self.state.get("agvPosition") or {}
        return found

    @property
    def shown(self) -> bool:
        """Whether its state is of the order that it was sent last."""
        return bool(self.order) and self.state.get("orderId") == self.order

    @property
    def left(self) -> bool:
        """Whether it drives, or has anything left of an order."""
        state, working = self.state, ("WAITING", "INITIALIZING", "RUNNING", "PAUSED")
        return bool(
            state.get("nodeStates")
            or state.get("driving")
            or (self.done in working and state.get("orderId"))
        )

    @property
    def done(self) -> str:
        """The status of what it does at a place by the order of its state ("": nothing)."""
        order = self.state.get("orderId")
        known = self.state.get("actionStates", ())
        return next((a.get("actionStatus", "") for a in known if a.get("actionId") == order), "")

    @property
    def released(self) -> list[Message]:
        """The nodes before it, by its state, to which it may drive."""
        return [n for n in self.state.get("nodeStates") or () if n.get("released")]

    @property
    def actions(self) -> list[Message]:
        """What its state says of actions, also of those that it was told at once."""
        return [*self.state.get("actionStates", ()), *self.state.get("instantActionStates", ())]

    @property
    def told_to_pause(self) -> bool:
        """Whether its state knows of a pause that it was told from here, maybe before a restart."""
        return any(str(a.get("actionId")).startswith("startPause-") for a in self.actions)

    def heeded(self, instant: Instant) -> bool:
        """Return whether it has done what it was told at once (or has nothing to do it with)."""
        mine = (a.get("actionStatus") for a in self.actions if a.get("actionId") == instant.id)
        return any(status in ("FINISHED", "FAILED") for status in mine)


@dataclass
class Instant:
    """An instant action, and when it was sent last (s)."""

    kind: str
    id: str
    at: float


class MasterControl:
    """The robots behind a broker. ``types``: what an action is called for what is done at places
    (``pick``, ``deliver``, ``task``, ``open``, ``charge``); ``spacing`` (m): for robots that
    know no trajectories and drive straight from node to node, which are at most so far apart then;
    ``tls``: speak to the broker over TLS, by the certificates that this machine trusts, or by those
    of a file.

    :raises ProblemError: where the broker cannot be reached or refuses, or the version is none.
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
        tls: bool | str = False,
        types: Mapping[str, str] | None = None,
        spacing: float = 0.0,
        map_id: str = "map",
        client: Any = None,
    ) -> None:
        if version not in VERSIONS:
            raise ProblemError(f"VDA 5050 {version} is not known: {', '.join(VERSIONS)}")
        self.site, self.version, self.manufacturer = site, version, manufacturer
        self.types, self.spacing, self.map_id = dict(types or {}), spacing, map_id
        self.root = f"{prefix}/v{version.partition('.')[0]}/{manufacturer}"
        self.agvs = {name: Agv(name) for name in site.robots}
        self.levels: dict[str, float] = {}
        self.faults: list[tuple[str, str]] = []
        """(robot, in words) what does not fit the site file, or what was told."""
        self._inbox: queue.SimpleQueue[tuple[str, str, bytes]] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._headers: dict[tuple[str, str], itertools.count[int]] = {}
        self._executor: Executor
        self._motions: dict[str, Message] = {}
        self._charging: dict[str, float] = {}
        """Activities in which robots charge, and since when (s)."""
        name = f"up_samp-{site.name}-{time.time_ns()}"
        self.client = client or mqtt.Client(CallbackAPIVersion.VERSION2, name)
        if user is not None:
            self.client.username_pw_set(user, password)
        if tls:
            own = tls if isinstance(tls, str) else None
            self.client.tls_set_context(ssl.create_default_context(cafile=own))
        self._enter(host, port)

    def _enter(self, host: str, port: int) -> None:
        """Come to the broker."""
        self.client.on_connect = self._connected
        self.client.on_message = self._arrived
        try:
            self.client.connect(host, port, keepalive=10)
        except OSError as error:
            raise ProblemError(f"no broker at {host}:{port}: {error}") from error
        self.client.loop_start()
        refused = self._answer()
        if refused:
            self.close()
            raise ProblemError(f"the broker at {host}:{port} refuses: {refused}")

    def _answer(self) -> str:
        """Return why the broker lets nobody in ("": it does)."""
        try:
            return self._answers.get(timeout=10.0)
        except queue.Empty:
            return "it does not answer"

    def close(self) -> None:
        """Leave the broker."""
        self.client.disconnect()
        self.client.loop_stop()

    def _connected(self, client: mqtt.Client, *told: Any) -> None:
        reason = told[2] if len(told) > 2 else None
        failed = reason is not None and reason.is_failure
        self._answers.put(str(reason) if failed else "")
        for name in self.agvs:
            for topic in ("state", "connection", "factsheet", "visualization"):
                client.subscribe(
                    f"{self.root}/{name}/{topic}", qos=1 if topic == "connection" else 0
                )
            self._ask(name)

    def _ask(self, robot: str) -> None:
        """Ask a robot what it is, and how it is; it may not have been there before."""
        self._instant(robot, "factsheetRequest")
        self._instant(robot, "stateRequest")

    def _arrived(self, _client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage) -> None:
        name, topic = message.topic.split("/")[-2:]
        self._inbox.put((name, topic, message.payload))

    # ------------------------------------------------------------------ what robots tell

    def reports(self, now: float) -> list[Report]:
        """Return what robots have told since the last call."""
        for _ in range(self._inbox.qsize()):  # nobody else takes from it
            self._read(*self._inbox.get())
        return [r for agv in self.agvs.values() for r in self._reported(agv, now)]

    def _read(self, name: str, topic: str, payload: bytes) -> None:
        agv = self.agvs.get(name)
        if agv is None:
            return
        try:
            data = json.loads(payload)
            data = _as_told(earlier(data) if self.version == LATER else data, "message")
        except (ValueError, OverflowError, RecursionError) as error:
            why = error if type(error) is ValueError else type(error).__name__
            self._fault(name, f"its {topic} cannot be read: {why}")
            return
        match topic:
            case "connection":
                told = data.get("connectionState")
                agv.online = told == "ONLINE"
                if agv.online:
                    self._ask(name)
                elif str(told).startswith("CONNECTION"):
                    self._fault(name, BROKEN)
            case "visualization" if not _older(data, agv.seen):
                agv.seen, agv.new = data, True
            case "factsheet":
                self._check(name, data)
            case "state" if not _older(data, agv.state):
                self._hear(agv, data)

    def _hear(self, agv: Agv, state: Message) -> None:
        """Take in a robot's state."""
        agv.state, agv.new, agv.online = state, True, True
        level = float((state.get("batteryState") or {}).get("batteryCharge", math.nan))
        if 0.0 <= level < 101.0:  # percent, rounded
            self.levels[agv.name] = min(1.0, level / 100.0)
        elif not math.isnan(level):
            self._fault(agv.name, f"its batteryCharge cannot be {level:g} percent")
        if agv.shown:
            agv.known = True
            update = state.get("orderUpdateId", 0)
            agv.sent = [m for m in agv.sent if m["orderUpdateId"] > update]
        if self._dropped(agv):
            why = f"it has given up '{agv.order}': hold and release it where it may go on"
            self._fault(agv.name, why)

    def _dropped(self, agv: Agv) -> bool:
        """Return whether a robot does not know its order any more, or has given it up."""
        if not agv.known or agv.cancel is not None or agv.left:
            return False
        if not agv.shown or agv.done == "FAILED":
            return True
        if agv.activity not in self._motions or agv.sent:
            return False
        return bool(agv.nodes) and agv.state.get("lastNodeSequenceId", 0) < agv.nodes[-1][0]

    def _fault(self, robot: str, words: str) -> None:
        if (robot, words) not in self.faults:
            self.faults.append((robot, words))

    def _check(self, name: str, sheet: Message) -> None:
        """Compare a factsheet with the robot's type in the site file."""
        kind = self.site.kind_of(name)
        told = sheet.get("physicalParameters", {})
        for key, own in (("speedMax", kind.v_max), ("accelerationMax", kind.a_max)):
            if told.get(key, own) < own - 1e-9:
                self._fault(name, f"its {key} is {told[key]:g}, in the site file {own:g}")
        for key, own in zip(("length", "width"), self._sides(name), strict=True):
            if told.get(key, own) > own + 1e-3:
                self._fault(name, f"its {key} is {told[key]:g} m, in the site file {own:g}")

    def _sides(self, robot: str) -> tuple[float, float]:
        """Return a robot's length and width (m)."""
        kind = self.site.kind_of(robot)
        x, y = zip(*corners_of(kind.footprint), strict=True)
        return max(x) - min(x), max(y) - min(y)

    def _reported(self, agv: Agv, now: float) -> list[Report]:
        fresh, agv.new = agv.new, False
        pose, error = _pose_in(agv.position), agv.position.get("deviationRange")
        told = agv.position.get("mapId", agv.map_id)
        agv.map_id = agv.map_id or told
        if told != agv.map_id:
            pose = None
            self._fault(agv.name, f"it is on map '{told}', and was on '{agv.map_id}'")
        activity = agv.activity if agv.shown else ""
        moves, found = activity in self._motions, []
        if fresh and pose is not None:
            motion = activity if moves else ""
            found.append(Report(agv.name, now, motion, pose=pose, error=error))
        elif fresh and moves:
            passed = agv.state.get("lastNodeSequenceId", 0)
            progress = max((s for q, s in agv.nodes if q <= passed), default=0.0)
            # between two nodes nobody knows where it is, nor where it stands there
            stands = not agv.released and not agv.state.get("driving")
            if stands or progress > self._known(agv, activity) + NEAR:
                found.append(Report(agv.name, now, activity, progress))
        over = activity and self._finished(agv, moves, now)
        if over and (fresh or now >= agv.over + AGAIN):
            agv.over = now
            found.append(Report(agv.name, now, activity, done=True))
        return found

    def _known(self, agv: Agv, activity: str) -> float:
        """Return how far (m) along a motion a robot is by what it told last."""
        way = self._executor.state.ways[activity, agv.name]
        return way.told + driven_before(self._motions[activity])

    def _finished(self, agv: Agv, moves: bool, now: float) -> bool:
        """Return whether a robot has done its order."""
        if moves:
            last, at = agv.nodes[-1] if agv.nodes else (0, 0.0)
            whole = at >= self._motions[agv.activity]["progress"][-1] - NEAR
            there = agv.state.get("lastNodeSequenceId") == last
            # what was never released of a way that ends early is no part of it
            return whole and there and not agv.state.get("driving") and not agv.released
        if agv.done != "FINISHED":
            return False
        return agv.activity not in self._charging or self._charged(agv, now)

    def _charged(self, agv: Agv, now: float) -> bool:
        """Return whether a robot that has begun to charge is full, or has charged as long as is
        planned; then it is told to stop.
        """
        since = self._charging[agv.activity] = min(self._charging[agv.activity], now)
        full, task = self.levels.get(agv.name, 0.0) >= 1.0, self._tasks.get(agv.activity)
        if not full and now < since + (0.0 if task is None else task.expected):
            return False
        if now >= agv.over + AGAIN and (agv.state.get("batteryState") or {}).get("charging"):
            self._instant(agv.name, "stopCharging", now)
        return True

    # ------------------------------------------------------------------ what robots are told

    def follow(self, executor: Executor) -> None:
        """Know the motions of another plan."""
        self._executor = executor
        self._motions = {m["activity"]: whole_motion(m) for m in executor.plan["motions"]}

    @property
    def _tasks(self) -> Mapping[str, PlannedTask]:
        return self._executor.state.graph.tasks

    def tell(self, commands: Mapping[str, Command], now: float) -> None:
        """Send what is new, and again what is not known to have arrived."""
        for who, command in commands.items():
            agv = self.agvs.get(who)
            if agv is None or not agv.online or not agv.state:
                continue
            if isinstance(command, Hold):
                self._hold(agv, now)
                continue
            if self._dropped(agv):
                continue  # somebody sees to it
            what = command.motion if isinstance(command, Go) else command.activity
            if what != agv.activity and not self._free(agv, what, now):
                continue  # a pause goes on until what was released before is cancelled
            if isinstance(command, Go) and not self._taken_back(agv, command, now):
                continue
            self._pause(agv, False, now)
            if isinstance(command, Go):
                self._go(agv, command, now)
            elif agv.activity != command.activity:
                self._do(agv, command.activity, now)
            if agv.sent and now >= agv.sent_at + AGAIN:
                self._send_orders(agv, agv.sent, now)

    def _free(self, agv: Agv, activity: str, now: float) -> bool:
        """Return whether a robot can be sent the order of another activity: its last one is over.
        What is left of one that ends early (never released, or paused), and one that may still be
        on its way, is cancelled.
        """
        state = agv.state
        if not agv.order and state.get("orderId") == activity:
            return True  # it goes on with it after a restart
        awaited = bool(agv.order) and not agv.known
        if not agv.left and not awaited:
            return True
        paused = agv.pause is not None and agv.pause.kind == "startPause"
        if state.get("driving") or (agv.released and not paused):
            return False
        return self._cancelled(agv, now)

    def _cancelled(self, agv: Agv, now: float) -> bool:
        """Cancel a robot's order; return whether nothing is left of it."""
        agv.sent = []
        if agv.cancel is None:
            agv.cancel = self._instant(agv.name, "cancelOrder", now)
        elif not agv.heeded(agv.cancel):
            self._once_more(agv, agv.cancel, now)
        elif not agv.left:
            agv.begin("")
            return True
        return False

    def _taken_back(self, agv: Agv, command: Go, now: float) -> bool:
        """Return whether nothing is released beyond where a robot may go. Where it is, the robot
        pauses, its order is cancelled, and another one begins from where it stands.
        """
        ahead = agv.released or agv.sent or agv.cancel
        if agv.activity != command.motion or not agv.nodes or not ahead:
            return True
        if agv.cancel is None and command.until >= agv.nodes[-1][1] - NEAR:
            return True
        self._pause(agv, True, now)
        if not agv.state.get("driving"):
            activity = agv.activity
            again = agv.dropped.get(activity, 0) + 1
            if self._cancelled(agv, now):
                agv.dropped[activity] = again
        return False

    def _hold(self, agv: Agv, now: float) -> None:
        """Pause a robot that might drive on by what was released. Who has given up its order
        forgets it: it begins anew from where it stands then.
        """
        if self._dropped(agv):
            dropped = agv.dropped.get(agv.activity, 0) + 1
            agv.dropped[agv.activity] = dropped
            agv.begin("")
        elif agv.released or agv.sent:
            self._pause(agv, True, now)

    def _pause(self, agv: Agv, want: bool, now: float) -> None:
        """Let a robot pause, or go on; a pause that somebody else began goes on."""
        kind, told = "startPause" if want else "stopPause", agv.state.get("paused")
        ours = told is None or (told and agv.told_to_pause)
        if agv.pause is None and not want and not ours:
            if told:
                self._fault(agv.name, "somebody else has paused it: it goes on once they let it")
            return
        if agv.pause is None or agv.pause.kind != kind:
            agv.pause = self._instant(agv.name, kind, now)
        elif not agv.heeded(agv.pause):
            self._once_more(agv, agv.pause, now)
        elif want and told is False and now >= agv.pause.at + AGAIN:
            agv.pause = self._instant(agv.name, kind, now)  # it has begun anew, say

    def _once_more(self, agv: Agv, instant: Instant, now: float) -> None:
        if now >= instant.at + AGAIN:
            self._instant(agv.name, instant.kind, now, instant.id)
            instant.at = now

    def _go(self, agv: Agv, command: Go, now: float) -> None:
        known = agv.activity == command.motion
        if not known:
            self._begin(agv, command.motion)
        if known and agv.nodes and command.until <= agv.nodes[-1][1] + NEAR:
            return
        motion = self._motions[command.motion]
        released = agv.nodes[-1] if agv.nodes else (0, 0.0)
        at = {released[1], command.until, *self._spaced(agv.name, motion)}
        path = self._executor.drives[command.motion, agv.name].path
        stretches = stretches_told(motion, path, at)
        pieces = [p for p in stretches if p[2] > released[1] + NEAR]
        number = released[0] // 2
        nodes = [self._node(agv, number, self._pose(motion, released[1]), True)]
        edges = []
        added = [] if agv.nodes and agv.update >= 0 else [released]
        for piece, _, high, speed in pieces:
            number += 1
            free = high <= command.until + NEAR
            nodes.append(self._node(agv, number, piece.rows[-1, 1:], free))
            edge = {**edge_of(agv.name, number, piece), "released": free}
            edge |= {"maxSpeed": round(speed, 6)} if "maxSpeed" in edge else {}
            edges.append(_straight(edge, piece) if self.spacing else edge)
            added += [(2 * number, high)] if free else []
        if agv.nodes and not added:
            return  # a rounding: nothing new may be driven
        agv.update += 1
        agv.nodes = [*agv.nodes, *added]
        self._send_new(agv, nodes, edges, now)

    def _spaced(self, robot: str, motion: Message) -> list[float]:
        """Return where (m) a motion has nodes beside those that are asked for: edges do not say how
        a robot turns while it drives sideways, nodes do, half as far from each other as it is wide.
        Who drives straight from node to node has one after each turn of 0.2 rad, too.
        """
        step, whole = self.spacing, motion["progress"][-1]
        if any(p.direction == "any" for p in pieces_of(motion)):
            half = min(self._sides(robot)) / 2
            step = min(step or half, half)
        spaced = [step * k for k in range(1, int(whole / step) + 1)] if step else []
        if self.spacing:
            turned = np.cumsum(np.abs(np.diff([row[3] for row in motion["samples"]])))
            s = np.asarray(motion["progress"])[1:]
            bends = s[np.diff(np.floor(turned / 0.2), prepend=0.0) > 0.0]
            bends = bends[(bends > NEAR) & (bends < whole - NEAR)]
            far = (k for k in spaced if np.all(np.abs(bends - k) > NEAR))
            spaced = [*far, *map(float, bends)]
        return spaced

    def _begin(self, agv: Agv, activity: str) -> None:
        """Begin an order, or go on with the one that the robot has already (after a restart), or
        with what is left of one that it gave up.
        """
        agv.begin(activity)
        state = agv.state
        if agv.shown:
            agv.known = True
            agv.update = int(state.get("orderUpdateId", 0))
            left = state.get("nodeStates") or ()
            released = (n.get("sequenceId", 0) for n in agv.released)
            last = max([state.get("lastNodeSequenceId", 0), *released])
            at = [n.get("nodePosition") for n in left if n.get("sequenceId") == last]
            agv.nodes = [(0, 0.0), (last, self._progress(agv, activity, at))]
        elif activity in agv.dropped:
            agv.nodes = [(0, self._progress(agv, activity, []))]

    def _progress(self, agv: Agv, activity: str, at: list[Any]) -> float:
        """Return how far along a motion a released node is: where it says, or the robot stands."""
        pose = _pose_in(agv.position)
        here = {} if pose is None else dict(zip("xy", pose, strict=False))
        place = next((p for p in at if p), here)
        rows, s = self._motions[activity]["samples"], self._motions[activity]["progress"]
        if not {"x", "y"} <= place.keys():
            return self._known(agv, activity)
        gaps = [math.hypot(r[1] - place["x"], r[2] - place["y"]) for r in rows]
        return float(s[gaps.index(min(gaps))])

    def _do(self, agv: Agv, activity: str, now: float) -> None:
        agv.begin(activity)
        agv.update = 0
        kind, what = action_of(self._executor.plan, activity)
        if kind == "charge":
            self._charging.setdefault(activity, math.inf)
        if agv.shown:
            agv.known = True
            return  # it has it from before a restart
        node = self._node(agv, 0, _pose_in(agv.position) or self._planned(agv.name), True)
        node["actions"] = [
            {
                "actionType": self.types.get(kind, TYPES.get(kind, kind)),
                "actionId": agv.order,
                "actionDescription": what,
                "blockingType": "HARD",
                "actionParameters": [{"key": "duration", "value": self._tasks[activity].expected}],
            }
        ]
        self._send_new(agv, [node], [], now)

    def _planned(self, robot: str) -> Any:
        """Return where a robot rests by the plan."""
        state, life = self._executor.state, self._executor.dependencies.lives[robot]
        here = place_of(state, life)
        return pose_in(state, life.pieces[0] if here is None else here)

    def _pose(self, motion: Message, at: float) -> Any:
        rows, s = np.asarray(motion["samples"])[:, 1:], np.asarray(motion["progress"])
        return [float(np.interp(at, s, rows[:, k])) for k in range(3)]

    def _node(self, agv: Agv, number: int, pose: Any, released: bool) -> Message:
        node = node_of(agv.name, number, pose, self.map_id)
        return {**node, "released": released}

    def _send_new(self, agv: Agv, nodes: list[Message], edges: list[Message], now: float) -> None:
        order = {
            "orderId": agv.order,
            "orderUpdateId": agv.update,
            "nodes": nodes,
            "edges": edges,
        }
        agv.sent.append(order)
        self._send_orders(agv, [order], now)

    def _send_orders(self, agv: Agv, orders: list[Message], now: float) -> None:
        """Send an order and its updates; who has one already ignores it."""
        agv.sent_at = now
        for order in orders:
            self._send(agv.name, "order", {**self._head(agv.name, "order"), **order})

    def _instant(self, robot: str, kind: str, now: float = 0.0, known: str = "") -> Instant:
        """Send an instant action: ``startPause``, ``stopPause``, ``cancelOrder``, ``stateRequest``,
        ``factsheetRequest``. ``known``: it was sent before by that ``actionId``.
        """
        action: Message = {
            "actionType": kind,
            "actionId": known or f"{kind}-{time.time_ns()}",
            "blockingType": "NONE" if kind.endswith("Request") or self.version == LATER else "HARD",
            "actionParameters": [],
        }
        message = {**self._head(robot, "instantActions"), "actions": [action]}
        if self.version.startswith("2.0"):
            message["instantActions"] = [action]  # as some clients of 2.0 have it
        self._send(robot, "instantActions", message)
        return Instant(kind, action["actionId"], now)

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
        told = later(message) if self.version == LATER else message
        self.client.publish(f"{self.root}/{robot}/{topic}", json.dumps(told), qos=0)


def _straight(edge: Message, piece: PathPiece) -> Message:
    """Return an edge for robots that drive straight from node to node, and turn to where they drive
    unless they are told how to stand meanwhile: as halfway.
    """
    found = {k: v for k, v in edge.items() if k not in SHAPE}
    if piece.direction == "turn":
        return found
    heading = wrapped(float(piece.rows[0, 3] + piece.rows[-1, 3]) / 2)
    return found | {"orientationType": "GLOBAL", "orientation": heading}


def _pose_in(position: Message) -> Pose | None:
    """Return where a robot tells to be (None: it does not, or does not know)."""
    if not (position.get("positionInitialized", True) and position.get("localizationScore", 1.0)):
        return None
    try:
        return float(position["x"]), float(position["y"]), float(position["theta"])
    except (KeyError, TypeError, ValueError):
        return None


def _as_told(value: Any, key: str) -> Any:
    """Return what a message tells under a key, without what is null.

    :raises ValueError: where that is not of its kind.
    """
    of_its_kind = isinstance(value, KINDS.get(key, object))
    if not of_its_kind or (key in NUMBERS and not math.isfinite(value)):
        raise ValueError(f"no '{key}' is like that")
    if isinstance(value, dict):
        return {k: _as_told(v, k) for k, v in value.items() if v is not None}
    return [_as_told(v, f"one of {key}") for v in value] if isinstance(value, list) else value


def _older(new: Message, old: Message) -> bool:
    """Return whether a state was sent before one that is known (messages come in any order)."""
    by = _sent_after(new, old)
    if not by:
        same = new.get("timestamp") == old.get("timestamp")
        return bool(old) and new.get("headerId") == old.get("headerId") and same
    return -TOLERANCES.clock <= by < 0.0


def _sent_after(new: Message, old: Message) -> float:
    """Return how long (s) after another message one was sent, by the clock of who sent both (0.0:
    that is not known). By more than a minute before it says that the clock was set.
    """
    try:
        times = [
            datetime.fromisoformat(FRACTION.sub(_six, m["timestamp"].replace("Z", "+00:00")))
            for m in (new, old)
        ]
        return (times[0] - times[1]).total_seconds()
    except (KeyError, AttributeError, TypeError, ValueError):
        return 0.0


def _six(fraction: re.Match[str]) -> str:
    """Return a fraction of a second with six digits, as Python's older versions read it."""
    return fraction[0][:7].ljust(7, "0")
