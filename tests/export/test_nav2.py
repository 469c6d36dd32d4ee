"""Behaviour trees for Nav2, and the script that drives legs, against fakes of ROS and Nav2.

The fakes have the calls that the script makes, by the signatures of ``nav2_simple_commander`` and
``rclpy`` of ROS 2 Jazzy. A real Nav2 was not tried.
"""

import json
import sys
import threading
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import pytest
import yaml

from up_samp import Fleet
from up_samp.execution import with_dependencies
from up_samp.export import export_plan

NODES = {"Sequence": {"name"}, "FollowPath": {"name", "path"}, "Wait": {"name", "wait_duration"}}
"""Nodes of BehaviorTree.CPP 4 and of Nav2, with the ports that are used of them:
ros-navigation/navigation2, nav2_behavior_tree/nav2_tree_nodes.xml.
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Return the folder of two robots that cross each other's way, and their files by robot."""
    fleet = Fleet("examples/maps/two_rooms.yaml")
    fleet.add_robot_type("agv", (0.8, 0.6), model="diff")
    for name, at in {"a": (3, 3), "b": (25, 3), "c": (25, 12), "d": (3, 12)}.items():
        fleet.add_place(name, *at)
    fleet.add_robot("r1", "agv", "a")
    fleet.add_robot("r2", "agv", "b")
    fleet.add_task("look", "c", duration=1, robots=["r1"])
    fleet.add_task("wipe", "d", duration=1, robots=["r2"], after="look")
    result = fleet.solve(timeout=60, first_plan=True)
    assert result.plan is not None, result.explain()
    folder = tmp_path_factory.mktemp("nav2")
    files = export_plan(with_dependencies(fleet.problem, result.data), "nav2", folder)
    legs = {f.stem: yaml.safe_load(f.read_text()) for f in files if f.suffix == ".yaml"}
    assert {f.name for f in files if f.suffix == ".py"} == {"follow_legs.py"}
    return folder, legs


def test_trees_have_the_legs_in_their_order_and_nodes_that_nav2_knows(exported):
    folder, legs = exported
    awaited = [w["event"] for r in legs.values() for leg in r["legs"] for w in leg["wait_for"]]
    assert awaited
    for robot in legs.values():
        told = list(dict.fromkeys(leg["tree"] for leg in robot["legs"]))
        assert told == sorted(told)
        for tree in told:
            root = ElementTree.parse(folder / tree).getroot()
            assert root.tag == "root"
            assert root.attrib == {"BTCPP_format": "4", "main_tree_to_execute": "legs"}
            (main,) = root
            assert (main.tag, main.attrib) == ("BehaviorTree", {"ID": "legs"})
            (sequence,) = main
            own = [leg for leg in robot["legs"] if leg["tree"] == tree]
            assert all(set(n.attrib) <= NODES[n.tag] for n in main.iter() if n is not main)
            for node, leg in zip(sequence, own, strict=True):
                assert node.get("name") == f"leg {leg['leg']}: {leg['activity']}"
                check_node(node, leg)
            # whoever sends a tree waits before it, and tells what has happened after it
            assert not any(leg["wait_for"] for leg in own[1:])
            assert not any(event in awaited for leg in own[:-1] for event in leg["happens"])


def check_node(node, leg):
    if node.tag == "Wait":
        assert float(node.get("wait_duration")) == leg["seconds"]
        return
    stamp, frame, *fields = node.get("path").split(";")
    poses = leg["path"]["poses"]
    assert (stamp, frame, len(fields)) == ("0", "map", 9 * len(poses))
    for k, pose in enumerate(poses):
        own = fields[9 * k : 9 * k + 9]
        at, turn = pose["pose"]["position"], pose["pose"]["orientation"]
        assert own[:2] == ["0", "map"]
        assert [float(v) for v in own[2:]] == [at["x"], at["y"], 0, 0, 0, turn["z"], turn["w"]]


class Topics:
    """Publishers and subscriptions of all robots; who comes later gets what was told before."""

    def __init__(self):
        self.told, self.ears, self.lock = [], [], threading.Lock()

    def publish(self, topic, message):
        with self.lock:
            self.told.append((topic, message))
            for other, hear in self.ears:
                if other == topic:
                    hear(message)

    def subscribe(self, topic, hear):
        with self.lock:
            self.ears.append((topic, hear))
            for other, message in self.told:
                if other == topic:
                    hear(message)


@pytest.fixture
def nav2(monkeypatch):
    """Return what robots are asked for, in order: ``(namespace, call, argument)``."""
    topics, calls = Topics(), []

    def message(**fields):
        return SimpleNamespace(
            header=SimpleNamespace(frame_id=""), poses=[], **fields,
            pose=SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace()),
        )  # fmt: skip

    class BasicNavigator:
        def __init__(self, node_name="basic_navigator", namespace=""):
            self.name = namespace

        def __getattr__(self, call):
            if call not in ("waitUntilNav2Active", "changeMap", "setInitialPose",
                            "clearAllCostmaps"):  # fmt: skip
                raise AttributeError(call)
            return lambda *given: calls.append((self.name, call, given))

        def followPath(self, path, controller_id="", goal_checker_id=""):
            calls.append((self.name, "followPath", path))
            return True

        def isTaskComplete(self):
            return True

        def getResult(self):
            return nav2.result

        def create_publisher(self, kind, topic, qos):
            return SimpleNamespace(publish=lambda m: topics.publish(topic, m))

        def create_subscription(self, kind, topic, callback, qos):
            topics.subscribe(topic, callback)

    def module(name, **parts):
        made = ModuleType(name)
        vars(made).update(parts)
        monkeypatch.setitem(sys.modules, name, made)

    navigator = {"BasicNavigator": BasicNavigator, "TaskResult": SimpleNamespace(SUCCEEDED=1)}
    module("nav2_simple_commander")
    module("nav2_simple_commander.robot_navigator", **navigator)
    module("rclpy", init=lambda: None, spin=lambda node: None,
           spin_once=lambda node, timeout_sec: None)  # fmt: skip
    names = SimpleNamespace(KEEP_ALL=1, TRANSIENT_LOCAL=1)
    module("rclpy.qos", QoSProfile=dict, DurabilityPolicy=names, HistoryPolicy=names)
    for package, kind in (("nav_msgs", "Path"), ("geometry_msgs", "PoseStamped"),
                          ("std_msgs", "String")):  # fmt: skip
        module(package)
        module(f"{package}.msg", **{kind: message})
    nav2 = SimpleNamespace(calls=calls, topics=topics, result=1)
    return nav2


def script_of(folder):
    """Return the script's names, as it was written, with activities that take no time."""
    file = folder / "follow_legs.py"
    names = {"__name__": "follow_legs"}
    exec(compile(file.read_text(), str(file), "exec"), names)
    names["act"] = lambda leg: None
    return SimpleNamespace(**names)


def test_the_script_drives_all_legs_and_waits_for_others(exported, nav2):
    folder, legs = exported
    script = script_of(folder)
    threads = [
        threading.Thread(
            target=script.main, args=([str(folder / f"{r}.yaml"), "monday", "--namespace", r],),
            daemon=True,
        )
        for r in ("r2", "r1")
    ]  # fmt: skip
    for thread in threads:  # r2 has to wait for r1
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
        assert not thread.is_alive()
    for robot, data in legs.items():
        own = [(call, given) for name, call, given in nav2.calls if name == robot]
        assert own[0][0] == "waitUntilNav2Active"
        driven = [leg["path"]["poses"] for leg in data["legs"] if "path" in leg]
        assert [call for call, _ in own[1:]] == ["followPath"] * len(driven)
        for (_, path), poses in zip(own[1:], driven, strict=True):
            assert path.header.frame_id == "map"
            assert [p.pose.position.x for p in path.poses] == [
                p["pose"]["position"]["x"] for p in poses
            ]
    told = [json.loads(m.data) for topic, m in nav2.topics.told]
    assert {topic for topic, _ in nav2.topics.told} == {"/up_samp/monday/events"}
    for data in legs.values():
        for leg in data["legs"]:
            for wait in leg["wait_for"]:
                if leg["happens"]:
                    assert told.index(wait["event"]) < told.index(leg["happens"][0])


def test_the_script_stops_where_nav2_does(exported, nav2):
    folder, _ = exported
    nav2.result = 3
    with pytest.raises(SystemExit, match=r"leg 0 \(.*\): Nav2 stopped before its end: 3"):
        script_of(folder).main([str(folder / "r1.yaml"), "tuesday"])
