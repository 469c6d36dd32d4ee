"""Robots behind HTTP whose drivers are plain Python: a floor in simulated time, real requests."""

import json
import math
import urllib.request
from urllib.parse import quote, urlencode

import numpy as np

from up_samp.execution.floor import Drive, Handled
from up_samp.operate.remote import RemoteRobots

SPEED = 1.0


class Client:
    """What whoever drives a robot sends, and the answers."""

    def __init__(self, url, token):
        self.url, self.token = url, token

    def __call__(self, path, body=None, **query):
        headers = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body).encode()
        url = f"{self.url}{quote(path)}?{urlencode(query)}"
        with urllib.request.urlopen(urllib.request.Request(url, data, headers), timeout=30) as told:
            return json.loads(told.read())


class PlainRobot:
    """Drives along its path as far as it may, and does what is to be done at a place."""

    def __init__(self, name, pose, noise=0.0):
        self.name, self.pose, self.noise = name, tuple(pose), noise
        self.random = np.random.default_rng(len(name))
        self.motion, self.rows, self.s = "", None, 0.0
        self.work, self.over = None, ()
        self.rows_driven, self.handled = [], []
        self.broken = False

    def step(self, client, now, seconds):
        if not self.broken:
            command = client(f"/v1/robots/{self.name}/command", wait=0)
            getattr(self, command["kind"])(client, command, now, seconds)
            client(f"/v1/robots/{self.name}/reports", self.told(command))
        self.rows_driven.append([now, *self.pose])

    def hold(self, client, command, now, seconds):
        pass

    def go(self, client, command, now, seconds):
        if command["motion"] != self.motion:
            path = client(f"/v1/robots/{self.name}/path")
            assert path["motion"] == command["motion"]
            self.motion = path["motion"]
            self.rows = np.array([p for piece in path["pieces"] for p in piece["poses"]])
            self.limits = [(p["poses"][-1][0], p["speed"]) for p in path["pieces"]]
            self.s = self.rows[0, 0]
            assert math.dist(self.pose[:2], self.rows[0, 1:3]) < 0.3
        self.s = max(self.s, min(self.farthest(seconds), command["until"]))
        found = [float(np.interp(self.s, self.rows[:, 0], self.rows[:, k])) for k in (1, 2, 3)]
        self.pose = tuple(found)

    def farthest(self, seconds):
        """How far it comes, piece by piece no faster than it may."""
        s = self.s
        for end, speed in self.limits:
            if s < end and seconds > 0:
                went = min(end - s, min(SPEED, speed) * seconds)
                s, seconds = s + went, seconds - went / min(SPEED, speed)
        return s

    def do(self, client, command, now, seconds):
        if self.work is None or self.work[0] != command["activity"]:
            self.work = command["activity"], now
        name, since = self.work
        if now >= since + command["seconds"] and command["may_end"] and name not in self.over:
            self.over = (*self.over, name)
            self.handled.append(Handled(command["action"], command["order"], self.name, since, now))

    def told(self, command):
        wrong = self.random.uniform(-self.noise, self.noise, 2)
        x, y, theta = self.pose
        told = {"pose": [x + wrong[0], y + wrong[1], theta], "battery": 80}
        if command["kind"] == "go":
            told["motion"] = self.motion
            if self.s >= self.rows[-1, 0] - 1e-3:
                told["done"] = self.motion
        if command["kind"] == "do" and command["activity"] in self.over:
            told["done"] = command["activity"]
        return told


class HttpFloor(RemoteRobots):
    """The robots of an operation in simulated time, driven over HTTP once ``client`` is set."""

    def __init__(self, site, mishaps, seed):
        super().__init__(site)
        self.initial = {n: site.places[r.start].pose for n, r in site.robots.items()}
        noise = mishaps.delays.noise
        self.robots = {n: PlainRobot(n, pose, noise) for n, pose in self.initial.items()}
        self.client = None

    def step(self, now, seconds):
        for robot in self.robots.values() if self.client else ():
            robot.step(self.client, round(now + seconds, 6), seconds)

    @property
    def drives(self):
        return [Drive(n, "all", r.rows_driven) for n, r in self.robots.items() if r.rows_driven]

    @property
    def handled(self):
        return [h for r in self.robots.values() for h in r.handled]
