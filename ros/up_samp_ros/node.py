"""The node: robots of a floor that is operated, driven by Nav2.

Each robot has its namespace: goals go to ``NAME/follow_path`` (``nav2_msgs/action/FollowPath``) and
``NAME/spin`` (``nav2_msgs/action/Spin``), where it is comes from tf.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, PoseStamped
from nav2_msgs.action import FollowPath, Spin
from nav_msgs.msg import Path
from rclpy.action import ActionClient
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_ros import Buffer, TransformException, TransformListener
from visualization_msgs.msg import Marker, MarkerArray

from up_samp_ros.driver import Driver, Ended, Pose
from up_samp_ros.link import Link, LostError

SUCCEEDED = 4
"""``action_msgs/msg/GoalStatus.STATUS_SUCCEEDED``."""
PARAMETERS = {
    "url": "http://127.0.0.1:8080",
    "token": "",
    "operator_token": "",
    "robots": [""],
    "map_frame": "map",
    "base_frame": "{robot}/base_link",
    "controller": "FollowPath",
    "goal_checker": "",
    "work": "wait",
}
"""What may be set, and what it is else: ``robots``: all of the floor where none is named; ``work``:
what is done at a place is over after its time (``wait``), or once its name is heard (``topic``).
"""


class Nav2Robot:
    """A robot's navigation by Nav2; where it is, by tf."""

    def __init__(self, node: BridgeNode, name: str) -> None:
        self.node, self.name = node, name
        self.frame = str(node.told["base_frame"]).format(robot=name)
        self.path = ActionClient(node, FollowPath, f"{name}/follow_path")
        self.spin = ActionClient(node, Spin, f"{name}/spin")
        self.shown = node.create_publisher(Path, f"{name}/plan", 1)
        self.works = node.create_publisher(String, f"{name}/up_samp/do", 10)
        node.create_subscription(String, f"{name}/up_samp/done", self._worked, 10)
        node.create_subscription(BatteryState, f"{name}/battery_state", self._charged, 1)
        self._battery: float | None = None
        self._doing: tuple[str, Ended] = "", _nothing
        self._goal = 0
        self._handle: Any = None
        self._lock = threading.Lock()

    def pose(self) -> Pose | None:
        """Return where tf has the robot now."""
        try:
            found = self.node.tf.lookup_transform(self.node.told["map_frame"], self.frame, Time())
        except TransformException:
            return None
        at, turn = found.transform.translation, found.transform.rotation
        return at.x, at.y, 2.0 * math.atan2(turn.z, turn.w)

    def battery(self) -> float | None:
        """Return the level that was heard last on ``NAME/battery_state`` (percent)."""
        return self._battery

    def _charged(self, message: BatteryState) -> None:
        share = message.percentage
        self._battery = None if math.isnan(share) else 100.0 * share

    def follow(self, poses: Sequence[Pose], ended: Ended) -> None:
        """Give Nav2's controller another path; it goes over from the one before."""
        goal = FollowPath.Goal()
        goal.path = self._path(poses)
        goal.controller_id = self.node.told["controller"]
        goal.goal_checker_id = self.node.told["goal_checker"]
        self._send(self.path, goal, ended)

    def turn(self, angle: float, ended: Ended) -> None:
        """Let Nav2's behaviours turn the robot."""
        goal = Spin.Goal()
        goal.target_yaw = angle
        goal.time_allowance = Duration(sec=60)
        self._send(self.spin, goal, ended)

    def _send(self, client: ActionClient, goal: Any, ended: Ended) -> None:
        with self._lock:
            self._goal += 1
            number = self._goal

        def over(future: Any) -> None:
            if number == self._goal:
                ended(future.result().status == SUCCEEDED)

        def accepted(future: Any) -> None:
            handle = future.result()
            if number != self._goal:
                if handle.accepted and self._handle is None:
                    handle.cancel_goal_async()  # it was stopped meanwhile
                return
            if not handle.accepted:
                ended(False)
                return
            self._handle = handle
            handle.get_result_async().add_done_callback(over)

        client.send_goal_async(goal).add_done_callback(accepted)

    def stop(self) -> None:
        """Cancel what is under way; no goal before ends any more."""
        with self._lock:
            self._goal += 1
            handle, self._handle = self._handle, None
        if handle is not None:
            handle.cancel_goal_async()

    def work(self, command: dict[str, Any], ended: Ended) -> None:
        """Tell on ``NAME/up_samp/do`` what is to be done; it is over after its time, or once its
        activity is heard on ``NAME/up_samp/done``.
        """
        self._doing = command["activity"], ended
        self.works.publish(String(data=json.dumps(command)))
        if self.node.told["work"] == "wait":
            done = String(data=command["activity"])
            timer = threading.Timer(command["seconds"], self._worked, [done])
            timer.daemon = True
            timer.start()

    def _worked(self, message: String) -> None:
        name, ended = self._doing
        if message.data == name:
            ended(True)

    def planned(self, poses: Sequence[Pose]) -> None:
        """Show the way to the end of the motion on ``NAME/plan``."""
        self.shown.publish(self._path(poses))

    def _path(self, poses: Sequence[Pose]) -> Path:
        path = Path()
        path.header.frame_id = self.node.told["map_frame"]
        path.header.stamp = self.node.get_clock().now().to_msg()
        for pose in poses:
            there = PoseStamped()
            there.header = path.header
            _put(there.pose, pose)
            path.poses.append(there)
        return path


class BridgeNode(Node):
    """Robots of a floor, each with a thread that asks and tells, and what is to be seen."""

    def __init__(self) -> None:
        super().__init__("up_samp_bridge")
        self.told: dict[str, Any] = {
            name: self.declare_parameter(name, usual).value for name, usual in PARAMETERS.items()
        }
        self.tf = Buffer()
        self.listener = TransformListener(self.tf, self)
        self.link = Link(self.told["url"], self.told["token"])
        self.site = self.link.site()
        names = [n for n in self.told["robots"] if n] or list(self.site["robots"])
        self.drivers = [Driver(n, self.link, Nav2Robot(self, n), time.monotonic) for n in names]
        self.markers = self.create_publisher(MarkerArray, "up_samp/footprints", 1)
        self.create_timer(0.5, self.show)
        self.operator = Link(self.told["url"], self.told["operator_token"])
        if self.told["operator_token"]:
            self.create_service(Trigger, "up_samp/hold", self._deed(self._hold))
            self.create_service(Trigger, "up_samp/release", self._deed(self.operator.release))
        self.running = True

    def begin(self) -> None:
        """Ask and tell from now on, in a thread for each robot."""
        for driver in self.drivers:
            threading.Thread(target=self.drive, args=(driver,), daemon=True).start()

    def drive(self, driver: Driver) -> None:
        """Drive a robot until the node ends; what is wrong is said once."""
        said = ""
        while self.running:
            driver.step()
            if driver.problem not in ("", said):
                self.get_logger().warning(f"{driver.robot}: {driver.problem}")
            said = driver.problem
            if said:
                time.sleep(0.2)

    def close(self) -> None:
        """Stop all robots."""
        self.running = False
        for driver in self.drivers:
            driver.base.stop()

    def _hold(self) -> None:
        self.operator.hold("by the service up_samp/hold")

    def _deed(self, do: Callable[[], None]) -> Callable[[Any, Any], Any]:
        def done(_: Any, answer: Any) -> Any:
            try:
                do()
                answer.success = True
            except LostError as error:
                answer.success, answer.message = False, str(error)
            return answer

        return done

    def show(self) -> None:
        """Show robots' footprints, doors and blocked areas where they are by the floor."""
        try:
            floor = self.link.floor()
        except LostError:
            return
        bodies = {**self.site["robots"], **self.site["doors"]}
        things = {**floor["robots"], **floor["doors"]}
        shapes = [(n, bodies[n], found["pose"]) for n, found in things.items()]
        shapes += [(f"area {n}", c, (0.0, 0.0, 0.0)) for n, c in floor["areas"].items()]
        shown = MarkerArray()
        gone = Marker()
        gone.action = Marker.DELETEALL
        shown.markers = [gone, *(self._outline(*shape) for shape in shapes)]
        self.markers.publish(shown)

    def _outline(self, name: str, corners: Sequence[Sequence[float]], pose: Pose) -> Marker:
        marker = Marker()
        marker.header.frame_id = self.told["map_frame"]
        marker.ns, marker.type, marker.action = name, Marker.LINE_STRIP, Marker.ADD
        marker.scale.x = 0.03
        marker.color.a = 1.0
        marker.color.r = 1.0 if name.startswith("area") else 0.2
        _put(marker.pose, pose)
        marker.points = [Point(x=float(x), y=float(y), z=0.0) for x, y in (*corners, corners[0])]
        return marker


def _put(there: Any, pose: Pose) -> None:
    """Write a pose into a message's."""
    there.position.x, there.position.y = float(pose[0]), float(pose[1])
    there.orientation.z, there.orientation.w = math.sin(pose[2] / 2), math.cos(pose[2] / 2)


def _nothing(_: bool) -> None:
    """Nobody waits for it."""


def main(arguments: list[str] | None = None) -> None:
    """Run the node until it is stopped."""
    rclpy.init(args=arguments)
    node = BridgeNode()
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    node.begin()
    try:
        executor.spin()
    except KeyboardInterrupt:
        pass
    finally:
        node.close()
        rclpy.try_shutdown()
