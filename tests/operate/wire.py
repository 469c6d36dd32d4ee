"""What simulated AGVs are told and tell: over a broker in real time, or over a wire in simulated
time that loses messages, brings them late or twice, and is cut for a while.
"""

import json
import random
import threading
import time
from types import SimpleNamespace

import numpy as np
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from tests.operate.agv import Agv
from up_samp.execution.floor import Drive, Handled
from up_samp.operate.vda5050 import MasterControl

EVERY = 0.2
"""Seconds between two states."""


class OverBroker(Agv):
    """An AGV in real time behind a broker; shares of states that are ``lost``, sent ``twice``, and
    ``late``: sent after the next one.
    """

    def __init__(self, port, name, pose, *, lost=0.0, twice=0.0, late=0.0, **options):
        super().__init__(name, pose, **options)
        self.lost, self.twice, self.late = lost, twice, late
        self.stop, self._held = False, None
        self.now = time.time()
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
                    self.act(action)

    def live(self):
        tick, told = 0.05, 0.0
        while not self.stop:
            with self.lock:
                self.tick(time.time(), tick)
                message = json.dumps(self.state()) if self.now >= told + EVERY else None
            if message is not None:
                told = self.now
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

    def close(self):
        self.stop = True
        self.thread.join()
        self.client.disconnect()
        self.client.loop_stop()


def unwound(rows):
    """Return rows (t, x, y, theta) in which headings go on where they pass half a turn."""
    found = np.array(rows, dtype=float)
    found[:, 3] = np.unwrap(found[:, 3])
    return found.tolist()


class Wire:
    """A broker in simulated time, as one of paho's clients has it. Each message is lost by chance,
    arrives twice, or late (states: also after later ones); ``cuts``: (from, until) when nothing
    arrives at all. ``lose(agv, kind, message)`` may choose what to lose of what AGVs are told.
    """

    def __init__(self, agvs, seed, *, lost=0.1, twice=0.1, late=0.5, cuts=()):
        self.agvs, self.random = agvs, random.Random(f"wire {seed}")
        self.lost, self.twice, self.late, self.cuts = lost, twice, late, cuts
        self.on_connect = self.on_message = None
        self.lose = lambda *_message: False
        self.lateness = {}  # of messages to and from an AGV, where it has its own
        self.now, self.count = 0.0, 0
        self.there = []  # (when it arrives, number, call, message)
        self.last = {}  # when the last message to an AGV arrives

    def connect(self, *_args, **_options):
        self.on_connect(self)

    def loop_start(self):
        pass

    loop_stop = disconnect = subscribe = lambda *_args, **_options: None

    @property
    def cut(self):
        return any(a <= self.now < b for a, b in self.cuts)

    def publish(self, topic, payload, qos=0):
        """Send a message to an AGV: those to one arrive in the order of sending."""
        name, kind = topic.split("/")[-2:]
        data = json.loads(payload)
        for _ in range(0 if self.lose(name, kind, data) else self.times()):
            when = self.now + self.random.uniform(0.0, self.lateness.get(name, self.late))
            self.last[name] = when = max(when, self.last.get(name, 0.0))
            self.put(when, self.bring, (name, kind, data))

    def times(self):
        """How often a message that is sent now arrives."""
        if self.cut or self.random.random() < self.lost:
            return 0
        return 2 if self.random.random() < self.twice else 1

    def put(self, when, call, message):
        self.count += 1
        self.there.append((when, self.count, call, message))

    def bring(self, message):
        name, kind, data = message
        agv = self.agvs[name]
        if agv.broken:
            return
        if kind == "order":
            agv.take(data)
        else:
            for action in data["actions"]:
                agv.act(action)

    def told(self, message):
        topic, payload = message
        self.on_message(self, None, SimpleNamespace(topic=topic, payload=payload))

    def state_of(self, agv):
        """Send an AGV's state."""
        message = f"uagv/v2/up_samp/{agv.name}/state", json.dumps(agv.state())
        for _ in range(self.times()):
            late = self.random.uniform(0.0, self.lateness.get(agv.name, self.late))
            self.put(self.now + late, self.told, message)

    def step(self, now):
        """Bring what has arrived by now."""
        self.now = now
        due = sorted((m for m in self.there if m[0] <= now), key=lambda m: m[:2])
        self.there = [m for m in self.there if m[0] > now]
        for _, _, call, message in due:
            call(message)


class AgvFloor:
    """Simulated AGVs behind a wire, and their master control: the robots of an operation, with what
    a judge has to know, as :class:`up_samp.operate.simulated.SimulatedRobots` tells it.
    """

    def __init__(self, site, mishaps, seed, **options):
        self.site, self.mishaps, self.seed = site, mishaps, seed
        self.initial = {n: site.places[r.start].pose for n, r in site.robots.items()}
        self.spoken = {k: options.pop(k) for k in ("version", "spacing") if k in options}
        version = self.spoken.get("version", "2.1.0")
        told = {"noise": mishaps.delays.noise, "version": version}
        self.agvs = {
            n: Agv(n, self.initial[n], speed=0.8 * site.robot_types[r.type].v_max, **told)
            for n, r in site.robots.items()
        }
        self.wire = Wire(self.agvs, seed, **options)
        self.broken, self.parts, self._told_at = {}, {n: [] for n in self.agvs}, 0.0
        self._begin()

    def _begin(self):
        self.control = MasterControl(self.site, "simulated", client=self.wire, **self.spoken)

    def restart(self):
        """Let another process speak to the AGVs."""
        self._begin()

    @property
    def faults(self):
        return self.control.faults

    @property
    def levels(self):
        return self.control.levels

    def follow(self, executor):
        self.control.follow(executor)

    def tell(self, commands, now):
        self.wire.now = now
        self.control.tell(commands, now)

    def reports(self, now):
        self.wire.now = now
        return self.control.reports(now)

    def pose(self, name):
        return tuple(self.agvs[name].pose)

    def put(self, name, pose):
        """Put a robot somewhere by hand; it has forgotten what it was told."""
        agv = self.agvs[name]
        self.parts[name].append(agv.trace)
        agv.trace = []
        agv.put(pose)

    def step(self, now, seconds):
        for when, name, lasts in self.mishaps.breakdowns:
            if when <= now < when + lasts and name not in self.broken:
                self.broken[name] = when + lasts
        self.broken = {n: end for n, end in self.broken.items() if end > now}
        later = round(now + seconds, 6)
        self.wire.step(later)
        for name, agv in self.agvs.items():
            agv.broken = name in self.broken
            agv.tick(later, seconds)
        if later >= self._told_at + EVERY:
            self._told_at = later
            for agv in self.agvs.values():
                self.wire.state_of(agv)

    @property
    def drives(self):
        return [
            Drive(name, f"part {k}", unwound(rows))
            for name, agv in self.agvs.items()
            for k, rows in enumerate([*self.parts[name], agv.trace])
            if rows
        ]

    @property
    def handled(self):
        return [
            Handled(k, what, n, a, b) for n, v in self.agvs.items() for k, what, a, b in v.handled
        ]

    def close(self):
        pass
