"""A simulated AGV of VDA 5050 2.1 that is ours, and knows nothing of plans: it drives the edges of
its base, and tells where it is. What it is told comes by calls; :mod:`tests.operate.wire` brings
it, over a broker or in simulated time.
"""

import itertools
import math
import random
from datetime import datetime, timezone

OVER = ("FINISHED", "FAILED")
TURNS = 1.5
"""rad/s at which it turns."""


class Agv:
    """``speed`` m/s; ``noise`` m; ``version`` of VDA 5050 that it speaks."""

    def __init__(self, name, pose, *, speed=1.5, noise=0.0, version="2.1.0"):
        self.version = version
        self.instants = {}  # status by id, of what was told at once
        self.name, self.pose, self.speed, self.noise = name, list(pose), speed, noise
        self.random = random.Random(name)
        self.order = {"orderId": "", "orderUpdateId": 0, "nodes": [], "edges": []}
        self.last = ("", 0)
        self.ahead = []  # what is released and not driven: (edge, node)
        self.horizon = []  # nodes that are not released
        self.way = []  # points that are left of the edge under way
        self.actions = {}  # status by id
        self.work = []  # (when it ends, action)
        self.paused = self.broken = self.charging = False
        self.charge = 80.0
        self.deviation, self.score = None, 1.0  # how sure it is of where it is
        self.now = 0.0
        self.trace, self.orders, self.refused, self.told = [], [], [], []
        self.handled = []  # (kind, what, from, until)
        self.header = itertools.count()

    def head(self):
        stamp = datetime.fromtimestamp(self.now, timezone.utc)
        return {
            "headerId": next(self.header),
            "timestamp": stamp.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z",
            "version": self.version, "manufacturer": "up_samp", "serialNumber": self.name,
        }  # fmt: skip

    # ------------------------------------------------------------------ what it is told

    def act(self, action):
        """Do an instant action; what was done by the same id is done again."""
        kind = action["actionType"]
        self.told.append(kind)
        if kind in ("startPause", "stopPause"):
            self.paused = kind == "startPause"
        if kind == "cancelOrder":
            self.ahead, self.horizon, self.way = [], [], []
            for _, work in self.work:
                self.actions[work["actionId"]] = "FAILED"
            self.work = []
        if kind == "stopCharging":
            self.charging = False
        known = self.instants if self.version.startswith("3") else self.actions
        known[action["actionId"]] = "FINISHED"

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
        elif self.ahead or self.way or self.horizon or self.work:
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
                self.charging = action["actionType"] == "startCharging"
                seconds = 0.0 if self.charging else action["actionParameters"][0]["value"]
                self.work.append((self.now + seconds, {**action, "since": self.now}))
        edges = {e["sequenceId"]: e for e in order["edges"] if e["released"]}
        self.ahead += [(edges[n["sequenceId"] - 1], n) for n in released[1:]]
        self.horizon = [n for n in order["nodes"] if not n["released"]]
        self.order = order

    def reboot(self):
        """Forget all that it was told."""
        self.order = {"orderId": "", "orderUpdateId": 0, "nodes": [], "edges": []}
        self.last, self.ahead, self.horizon, self.way = ("", 0), [], [], []
        self.actions, self.work, self.paused = {}, [], False

    def put(self, pose):
        """Be put somewhere by hand."""
        self.reboot()
        self.pose = list(pose)
        self.trace.append((self.now, *self.pose))

    # ------------------------------------------------------------------ what it does

    def tick(self, now, seconds):
        """Drive and work for some seconds, until ``now``."""
        self.now = now
        if not self.broken:
            if not self.paused:
                self.drive(seconds)
            for end, action in [w for w in self.work if w[0] <= now]:
                self.work.remove((end, action))
                self.actions[action["actionId"]] = "FINISHED"
                what = action.get("actionDescription", action.get("actionDescriptor", ""))
                self.handled.append((action["actionType"], what, action["since"], now))
        if self.charging:
            self.charge = min(100.0, self.charge + 2.0 * seconds)
        self.trace.append((now, *self.pose))

    def drive(self, tick):
        left = self.speed * tick
        while left > 0 and (self.way or self.ahead):
            if not self.way:
                self.way = self.points(*self.ahead[0])
            x, y, theta = self.way[0]
            # where it may only drive slowly, or turns, it comes less far
            edge, turn = self.ahead[0][0], math.remainder(theta - self.pose[2], math.tau)
            slower = self.speed / edge.get("maxSpeed", edge.get("maximumSpeed", self.speed))
            gap = math.dist((x, y), self.pose[:2]) * max(1.0, slower)
            gap = max(gap, abs(turn) * self.speed / TURNS)
            if gap > left:
                share = left / gap
                for k, by in enumerate((x - self.pose[0], y - self.pose[1], turn)):
                    self.pose[k] += share * by
                return
            self.pose[:], left = [x, y, theta], left - gap
            when = self.now - left / self.speed
            if self.trace and self.trace[-1][0] + 1e-4 < when < self.now - 1e-4:
                self.trace.append((when, *self.pose))
            self.way.pop(0)
            if not self.way:
                _, node = self.ahead.pop(0)
                self.last = (node["nodeId"], node["sequenceId"])

    def points(self, edge, node):
        """Return the poses to come to, one after the other, along an edge to a node: it turns where
        it has to before it drives, or while it drives sideways.
        """
        goal = node["nodePosition"]
        known = edge.get("trajectory", {}).get("controlPoints", [goal])
        line = [tuple(self.pose[:2]), *((p["x"], p["y"]) for p in known)]
        found, here, whole = [], self.pose[2], sum(map(math.dist, line, line[1:]))
        turn, gone = math.remainder(goal["theta"] - here, math.tau), 0.0
        for a, b in itertools.pairwise(line):
            if math.dist(a, b) < 1e-3:
                continue
            gone += math.dist(a, b)
            # who is told neither a trajectory nor a heading drives head first
            if "orientation" in edge or "trajectory" not in edge:
                turned, kind = edge.get("orientation", 0.0), edge.get("orientationType")
                ahead = 0.0 if kind == "GLOBAL" else math.atan2(b[1] - a[1], b[0] - a[0])
                found += [(*a, ahead + turned), (*b, ahead + turned)]
            else:
                found.append((*b, here + turn * gone / whole))
        return [*found, (goal["x"], goal["y"], goal["theta"])]

    def state(self):
        """Return its state in the words of its version."""
        state = self.state_of_2()
        if not self.version.startswith("3"):
            return state
        position, battery = state.pop("agvPosition"), state.pop("batteryState")
        position["localized"] = position.pop("positionInitialized")
        del state["safetyState"]["eStop"]
        return {
            **state, "mobileRobotPosition": position,
            "powerSupply": {"stateOfCharge": battery["batteryCharge"], "charging": self.charging},
            "safetyState": {**state["safetyState"], "activeEmergencyStop": "NONE"},
            "instantActionStates": [
                {"actionId": k, "actionType": "any", "actionStatus": v}
                for k, v in self.instants.items()
            ],
        }  # fmt: skip

    def state_of_2(self):
        wrong = [self.random.uniform(-self.noise, self.noise) for _ in range(2)]
        nodes = [n for _, n in self.ahead] + self.horizon
        return {
            **self.head(), "orderId": self.order["orderId"],
            "orderUpdateId": self.order["orderUpdateId"], "lastNodeId": self.last[0],
            "lastNodeSequenceId": self.last[1],
            "driving": bool(self.way or self.ahead) and not self.paused and not self.broken,
            "paused": self.paused,
            "nodeStates": [
                {k: n[k] for k in ("nodeId", "sequenceId", "released", "nodePosition")}
                for n in nodes
            ],
            "edgeStates": [
                {k: e[k] for k in ("edgeId", "sequenceId", "released")} for e, _ in self.ahead
            ],
            "agvPosition": {
                "x": self.pose[0] + wrong[0], "y": self.pose[1] + wrong[1], "theta": self.pose[2],
                "mapId": "map", "positionInitialized": True, "localizationScore": self.score,
                **({} if self.deviation is None else {"deviationRange": self.deviation}),
            },
            "actionStates": [
                {"actionId": k, "actionType": "any", "actionStatus": v}
                for k, v in self.actions.items()
            ],
            "batteryState": {"batteryCharge": self.charge, "charging": self.charging},
            "operatingMode": "AUTOMATIC", "errors": [],
            "safetyState": {"eStop": "NONE", "fieldViolation": False},
        }  # fmt: skip
