"""Drives one robot of a plan by Nav2: ``python3 follow_legs.py r1.yaml RUN --namespace r1``.

``up-samp export --to nav2`` writes this file beside the robots' legs; it needs ROS 2 with
``nav2_simple_commander``, and nothing of ``up_samp``. Each leg begins once all that it waits for
has happened. What begins and happens is told to all robots on the topic ``/up_samp/RUN/events``, as
JSON in a ``std_msgs/String``: RUN is a new name each time that a plan is driven, the same for all
of its robots. Write into ``act`` what yours do where a leg is no drive.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

_Leg = Mapping[str, Any]


def act(leg: _Leg) -> None:
    """Do the activity ``leg["do"]``. To be replaced: this waits as long as it lasts."""
    print(f"leg {leg['leg']}: {leg['do']}, {leg['seconds']:g} s")
    time.sleep(leg["seconds"])


class Follower:
    """Does a robot's legs: ``navigator`` is a ``BasicNavigator``, ``maps`` are files by name."""

    def __init__(self, navigator: Any, maps: Mapping[str, str], run: str) -> None:
        from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
        from std_msgs.msg import String

        self.navigator, self.maps = navigator, maps
        self.heard: dict[str, float] = {}
        self.message = String
        # whoever comes later is told all the same
        kept = QoSProfile(
            history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        topic = f"/up_samp/{run}/events"
        self.publisher = navigator.create_publisher(String, topic, kept)
        navigator.create_subscription(String, topic, lambda m: self.hear(m.data), kept)

    def hear(self, event: str) -> None:
        """Remember an event, and when it was heard of first."""
        self.heard.setdefault(event, time.monotonic())

    def tell(self, events: Sequence[Sequence[Any]]) -> None:
        """Tell all robots what has happened."""
        for event in events:
            text = json.dumps(event)
            self.hear(text)
            self.publisher.publish(self.message(data=text))

    def wait_for(self, wait: Mapping[str, Any]) -> None:
        """Return when an event is as many seconds ago as asked for."""
        import rclpy

        event = json.dumps(wait["event"])
        while time.monotonic() < self.heard.get(event, float("inf")) + wait["seconds"]:
            rclpy.spin_once(self.navigator, timeout_sec=0.1)

    def follow(self, leg: _Leg) -> None:
        """Do a leg; the program ends where Nav2 does not come to the end of its path."""
        for wait in leg["wait_for"]:
            self.wait_for(wait)
        self.tell(leg["begins"])
        if "path" in leg:
            self.drive(leg)
        else:
            act(leg)
        if "lands" in leg:
            self.navigator.changeMap(self.maps[leg["lands"]["map"]])
            self.navigator.setInitialPose(stamped(leg["lands"]["pose"]))
            self.navigator.clearAllCostmaps()
        self.tell(leg["happens"])

    def drive(self, leg: _Leg) -> None:
        """Follow a leg's path to its end."""
        from nav2_simple_commander.robot_navigator import TaskResult
        from nav_msgs.msg import Path as PathMessage

        path = PathMessage()
        path.header.frame_id = "map"
        path.poses = [stamped(pose["pose"]) for pose in leg["path"]["poses"]]
        if not self.navigator.followPath(path):
            sys.exit(f"leg {leg['leg']} ({leg['activity']}): Nav2 rejects the path")
        while not self.navigator.isTaskComplete():
            pass  # asking waits for a tenth of a second
        result = self.navigator.getResult()
        if result != TaskResult.SUCCEEDED:
            sys.exit(f"leg {leg['leg']} ({leg['activity']}): Nav2 stopped before its end: {result}")


def stamped(pose: Mapping[str, Any]) -> Any:
    """Return a pose of a leg as a ``PoseStamped`` of no time: transforms are the latest ones."""
    from geometry_msgs.msg import PoseStamped

    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.position.x, message.pose.position.y = pose["position"]["x"], pose["position"]["y"]
    message.pose.orientation.z = pose["orientation"]["z"]
    message.pose.orientation.w = pose["orientation"]["w"]
    return message


def main(arguments: Sequence[str] | None = None) -> None:
    """Drive the robot of the file that is named, then tell latecomers what has happened."""
    parser = argparse.ArgumentParser(description="Drives one robot of a plan by Nav2.")
    parser.add_argument("legs", type=Path, help="the robot's file of legs (YAML)")
    parser.add_argument("run", help="a new name for each run (letters, digits), as other robots")
    parser.add_argument("--namespace", default="", help="the robot's namespace")
    args = parser.parse_args(arguments)
    plan = yaml.safe_load(args.legs.read_text(encoding="utf-8"))
    import rclpy
    from nav2_simple_commander.robot_navigator import BasicNavigator

    rclpy.init()
    navigator = BasicNavigator(namespace=args.namespace)
    follower = Follower(navigator, plan["maps"], args.run)
    if any("path" in leg for leg in plan["legs"]):
        navigator.waitUntilNav2Active()
    for leg in plan["legs"]:
        follower.follow(leg)
    rclpy.spin(navigator)


if __name__ == "__main__":
    main()
