"""A simulated AGV of VDA 5050, over MQTT: drives what is released, along trajectories."""

import itertools
import json
import math
import random
import threading
import time
from datetime import datetime, timezone

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion


class Agv:
    """``speed`` m/s of real time; ``noise`` m; shares of states that are ``lost``, sent ``twice``,
    and ``late``: sent after the next one.
    """

    def __init__(self, port, name, pose, *, speed=1.5, noise=0.0, lost=0.0, twice=0.0, late=0.0):
        self.name, self.pose, self.speed, self.noise = name, list(pose), speed, noise
        self.lost, self.twice, self.late = lost, twice, late
        self.random = random.Random(name)
        self.order = {"orderId": "", "orderUpdateId": 0, "nodes": [], "edges": []}
        self.last = ("", 0)
        self.ahead = []  # what is released and not driven: (edge, node)
        self.way = []  # points that are left of the edge under way
        self.actions = {}
        self.paused = self.stop = False
        self.trace, self.orders, self.refused, self._held = [], [], [], None
        self.told = []
        self.header = itertools.count()
        self.lock = threading.Lock()
        self.topic = f"uagv/v2/up_samp/{name}"
        self.client = mqtt.Client(CallbackAPIVersion.VERSION2, f"agv-{name}")
        gone = json.dumps({**self.head(), "connectionState": "CONNECTIONBROKEN"})
        self.client.will_set(f"{self.topic}/connection", gone, qos=1, retain=True)
        self.client.on_connect = self.connected
        self.client.on_message = self.arrived
        self.client.reconnect_delay_set(1, 1)
        self.client.connect("127.0.0.1", port, keepalive=5)
        self.client.loop_start()
        self.thread = threading.Thread(target=self.live, daemon=True)
        self.thread.start()

    def head(self):
        stamp = datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"
        return {
            "headerId": next(self.header), "timestamp": stamp, "version": "2.1.0",
            "manufacturer": "up_samp", "serialNumber": self.name,
        }  # fmt: skip

    def connected(self, client, *_):
        client.subscribe([(f"{self.topic}/order", 0), (f"{self.topic}/instantActions", 0)])
        client.publish(
            f"{self.topic}/connection",
            json.dumps({**self.head(), "connectionState": "ONLINE"}), qos=1, retain=True,
        )  # fmt: skip

    def arrived(self, _client, _data, message):
        data = json.loads(message.payload)
        with self.lock:
            if message.topic.endswith("order"):
                self.take(data)
            else:
                for action in data["actions"]:
                    if action["actionType"] in ("startPause", "stopPause"):
                        self.paused = action["actionType"] == "startPause"
                    if action["actionType"] == "cancelOrder":
                        self.ahead, self.way = [], []
                    self.told.append(action["actionType"])
                    self.actions[action["actionId"]] = "FINISHED"

    def take(self, order):
        self.orders.append(order)
        same = order["orderId"] == self.order["orderId"]
        if same and order["orderUpdateId"] <= self.order["orderUpdateId"]:
            return
        released = [n for n in order["nodes"] if n["released"]]
        if same:
            base = self.ahead[-1][1]["sequenceId"] if self.ahead else self.last[1]
            if released[0]["sequenceId"] != base:
                self.refused.append((order, f"does not begin with the last node {base}"))
                return
        elif self.ahead or self.way:
            self.refused.append((order, "another order is not over"))
            return
        else:
            first = released[0]["nodePosition"]
            if math.dist((first["x"], first["y"]), self.pose[:2]) > 0.3:
                self.refused.append((order, "does not begin where it is"))
                return
            self.last, self.actions = (released[0]["nodeId"], released[0]["sequenceId"]), {}
            for action in released[0]["actions"]:
                self.actions[action["actionId"]] = "RUNNING"
                seconds = action["actionParameters"][0]["value"]
                threading.Timer(seconds, self.finish, [action["actionId"]]).start()
        edges = {e["sequenceId"]: e for e in order["edges"] if e["released"]}
        self.ahead += [(edges[n["sequenceId"] - 1], n) for n in released[1:]]
        self.order = order

    def finish(self, action):
        with self.lock:
            self.actions[action] = "FINISHED"

    def live(self):
        tick = 0.05
        for k in itertools.count():
            if self.stop:
                return
            with self.lock:
                if not self.paused:
                    self.drive(tick)
                self.trace.append((time.time(), *self.pose))
                message = json.dumps(self.state()) if k % 4 == 0 else None
            if message is not None:
                self.send(message)
            time.sleep(tick)

    def send(self, message):
        if self.random.random() < self.lost:
            return
        if self._held is None and self.random.random() < self.late:
            self._held = message
            return
        count = 2 if self.random.random() < self.twice else 1
        for _ in range(count):
            self.client.publish(f"{self.topic}/state", message)
        if self._held is not None:
            self.client.publish(f"{self.topic}/state", self._held)
            self._held = None

    def drive(self, tick):
        left = self.speed * tick
        while left > 0 and (self.way or self.ahead):
            if not self.way:
                edge, node = self.ahead[0]
                goal = node["nodePosition"]
                points = edge.get("trajectory", {}).get("controlPoints", [])
                back = edge.get("orientation", 0.0) > 1.0
                self.way = [(p["x"], p["y"], back) for p in points[1:]]
                self.way = self.way or [(goal["x"], goal["y"], None)]
            x, y, back = self.way[0]
            gap = math.dist((x, y), self.pose[:2])
            if back is not None and gap > 1e-6:
                turn = math.atan2(y - self.pose[1], x - self.pose[0])
                self.pose[2] = math.remainder(turn + (math.pi if back else 0.0), math.tau)
            if gap > left:
                self.pose[0] += (x - self.pose[0]) * left / gap
                self.pose[1] += (y - self.pose[1]) * left / gap
                return
            self.pose[:2], left = [x, y], left - gap
            self.way.pop(0)
            if not self.way:
                _, node = self.ahead.pop(0)
                self.pose[2] = node["nodePosition"]["theta"]
                self.last = (node["nodeId"], node["sequenceId"])

    def state(self):
        wrong = [self.random.uniform(-self.noise, self.noise) for _ in range(2)]
        return {
            **self.head(), "orderId": self.order["orderId"],
            "orderUpdateId": self.order["orderUpdateId"], "lastNodeId": self.last[0],
            "lastNodeSequenceId": self.last[1], "driving": bool(self.way) and not self.paused,
            "paused": self.paused,
            "nodeStates": [
                {k: n[k] for k in ("nodeId", "sequenceId", "released", "nodePosition")}
                for _, n in self.ahead
            ],
            "edgeStates": [
                {k: e[k] for k in ("edgeId", "sequenceId", "released")} for e, _ in self.ahead
            ],
            "agvPosition": {
                "x": self.pose[0] + wrong[0], "y": self.pose[1] + wrong[1], "theta": self.pose[2],
                "mapId": "map", "positionInitialized": True,
            },
            "actionStates": [
                {"actionId": k, "actionType": "any", "actionStatus": v}
                for k, v in self.actions.items()
            ],
            "batteryState": {"batteryCharge": 80.0, "charging": False},
            "operatingMode": "AUTOMATIC", "errors": [],
            "safetyState": {"eStop": "NONE", "fieldViolation": False},
        }  # fmt: skip

    def close(self):
        self.stop = True
        self.thread.join()
        self.client.disconnect()
        self.client.loop_stop()
