"""The few calls of ROS 2 that the bridge makes, and a world in simulated time behind them: robots
that follow paths and spin. Messages have the fields that their definitions name, and no others.
"""

import math
import sys
from importlib import resources
from types import ModuleType, SimpleNamespace

import numpy as np

DEFINITIONS = """
MSG: nav2_msgs/action/FollowPath
nav_msgs/Path path
string controller_id
string goal_checker_id
MSG: nav2_msgs/action/Spin
float32 target_yaw
builtin_interfaces/Duration time_allowance
MSG: std_msgs/msg/String
string data
MSG: sensor_msgs/msg/BatteryState
float32 percentage
MSG: std_srvs/srv/Trigger
bool success
string message
"""
NUMBERS = ("int", "uint", "float", "byte", "char")
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def messages():
    """Return message classes by (package, name), from their definitions."""
    text = resources.files("up_samp.export").joinpath("ros2_messages.txt").read_text("utf-8")
    found = {}
    for line in (text + DEFINITIONS).splitlines():
        words = line.partition("#")[0].split()
        if not words or line.startswith("="):
            continue
        if words[0] == "MSG:":
            package, *_, name = words[1].split("/")
            fields = found[package, name] = {}
        elif "=" in line.partition("#")[0]:
            name, value = "".join(words[1:]).split("=")
            fields[name] = int(value)
        else:
            fields[words[1]] = words[0]
    found["visualization_msgs", "Marker"] |= {"ADD": 0, "DELETEALL": 3, "LINE_STRIP": 4}
    return {key: made(key, fields, found) for key, fields in found.items()}


def made(key, fields, every):
    kinds = {n: kind for n, kind in fields.items() if isinstance(kind, str)}

    def usual(kind):
        if kind.endswith("]"):
            return []
        if kind == "string":
            return ""
        if kind == "bool":
            return False
        if kind.startswith(NUMBERS):
            return 0.0 if kind.startswith("float") else 0
        package, name = kind.split("/")
        return made((package, name), every[package, name], every)()

    def init(self, **given):
        for name, kind in kinds.items():
            setattr(self, name, given.pop(name) if name in given else usual(kind))
        assert not given, f"{key} has no {given}"

    body = {"__slots__": tuple(kinds), "__init__": init}
    return type(key[1], (), body | {n: v for n, v in fields.items() if n not in kinds})


class Future:
    def __init__(self):
        self.calls, self.found = [], None

    def add_done_callback(self, call):
        self.calls.append(call)

    def set(self, found):
        self.found = found
        for call in self.calls:
            call(self)

    def result(self):
        return self.found


class Handle:
    """A goal of a robot: what is left of it."""

    def __init__(self, robot, kind, goal, accepted=True):
        self.robot, self.kind, self.goal, self.accepted = robot, kind, goal, accepted
        self.over, self.status = Future(), None

    def get_result_async(self):
        return self.over

    def cancel_goal_async(self):
        self.end(CANCELED)

    def end(self, status):
        if self.status is None:
            self.status = status
            self.over.set(SimpleNamespace(status=status))


class World:
    """Robots by name, ``speed`` m/s and 1 rad/s; goals are taken up at the next step. ``fails``: so
    many goals fail first.
    """

    def __init__(self, poses, speed=1.0, fails=0):
        self.poses = {n: list(p) for n, p in poses.items()}
        self.speed, self.fails = speed, fails
        self.goals, self.asked = {}, []
        self.published, self.heard, self.services, self.given = {}, {}, {}, {}
        self.sent, self.rows = [], {n: [] for n in poses}

    def step(self, now, seconds):
        asked, self.asked = self.asked, []
        for robot, kind, goal, future in asked:
            handle = Handle(robot, kind, goal)
            if robot in self.goals:
                self.goals[robot].end(ABORTED)
            self.goals[robot] = handle
            self.sent.append((robot, kind, goal))
            future.set(handle)
            if self.fails:
                self.fails -= 1
                handle.end(ABORTED)
        for robot, handle in [*self.goals.items()]:
            if handle.status is None:
                getattr(self, handle.kind)(robot, handle, seconds)
            if handle.status is not None:
                del self.goals[robot]
        for robot, pose in self.poses.items():
            self.rows[robot].append([now, *pose])

    def follow_path(self, robot, handle, seconds):
        poses = [xyt(p.pose) for p in handle.goal.path.poses]
        pose, left = self.poses[robot], self.speed * seconds
        near = min(range(len(poses)), key=lambda k: (math.dist(poses[k][:2], pose[:2]), -k))
        for goal in poses[near:]:
            gap = math.dist(goal[:2], pose[:2])
            share = min(1.0, left / gap) if gap else 1.0
            turn = math.remainder(goal[2] - pose[2], math.tau)
            pose[:] = [*(a + share * (b - a) for a, b in zip(pose[:2], goal[:2], strict=True)),
                       pose[2] + share * turn]  # fmt: skip
            left -= share * gap
            if left <= 0.0:
                break
        if math.dist(pose[:2], poses[-1][:2]) < 1e-6:
            handle.end(SUCCEEDED)

    def spin(self, robot, handle, seconds):
        goal, pose = handle.goal, self.poses[robot]
        step = float(np.clip(goal.target_yaw, -seconds, seconds))
        pose[2] += step
        goal.target_yaw -= step
        if abs(goal.target_yaw) < 1e-6:
            handle.end(SUCCEEDED)

    def tell(self, topic, message):
        """Publish on a topic, as somebody else."""
        self.heard[topic](message)


def xyt(pose):
    turn = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
    return pose.position.x, pose.position.y, turn


def node_class(world, stamp):
    """Return a class of nodes of which a world hears all that they make."""

    class Node:
        def __init__(self, name):
            self.name = name
            self.logged = []

        def declare_parameter(self, name, usual):
            return SimpleNamespace(value=world.given.get(name, usual))

        def create_publisher(self, kind, topic, depth):
            def publish(message):
                assert isinstance(message, kind)
                world.published.setdefault(topic, []).append(message)

            return SimpleNamespace(publish=publish)

        def create_subscription(self, kind, topic, call, depth):
            world.heard[topic] = call

        def create_service(self, kind, name, call):
            world.services[name] = call

        def create_timer(self, seconds, call):
            pass

        def get_logger(self):
            return SimpleNamespace(warning=self.logged.append)

        def get_clock(self):
            return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: stamp))

    return Node


def client_class(world):
    class ActionClient:
        def __init__(self, node, kind, name):
            self.kind = kind
            self.robot, self.name = name.split("/")

        def send_goal_async(self, goal):
            assert isinstance(goal, self.kind.Goal)
            future = Future()
            world.asked.append((self.robot, self.name, goal, future))
            return future

    return ActionClient


class TransformError(Exception):
    pass


def buffer_class(world):
    class Buffer:
        def lookup_transform(self, target, source, time):
            robot = source.partition("/")[0]
            if target != "map" or robot not in world.poses:
                raise TransformError(source)
            x, y, theta = world.poses[robot]
            at = SimpleNamespace(x=x, y=y, z=0.0)
            turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(theta / 2), w=math.cos(theta / 2))
            return SimpleNamespace(transform=SimpleNamespace(translation=at, rotation=turn))

    return Buffer


def install(monkeypatch, world):
    """Put the fakes in the place of ROS's modules."""
    kinds = messages()
    modules = {
        "rclpy": {"init": lambda args=None: None, "try_shutdown": lambda: None},
        "rclpy.node": {"Node": node_class(world, kinds["builtin_interfaces", "Time"]())},
        "rclpy.action": {"ActionClient": client_class(world)},
        "rclpy.executors": {"MultiThreadedExecutor": object},
        "rclpy.time": {"Time": lambda: None},
        "tf2_ros": {
            "Buffer": buffer_class(world), "TransformException": TransformError,
            "TransformListener": lambda buffer, node: None,
        },
    }  # fmt: skip
    for (package, name), kind in kinds.items():
        action = package == "nav2_msgs"
        part = "action" if action else "srv" if package == "std_srvs" else "msg"
        modules.setdefault(package, {})
        found = SimpleNamespace(Goal=kind) if action else kind
        modules.setdefault(f"{package}.{part}", {})[name] = found
    for name, holds in modules.items():
        module = ModuleType(name)
        module.__dict__.update(holds)
        monkeypatch.setitem(sys.modules, name, module)
