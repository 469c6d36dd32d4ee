"""Definitions of the ROS 2 messages that recordings hold, each with all it is made of.

They are the common interfaces of ROS 2 (``std_msgs``, ``geometry_msgs``, ``nav_msgs``,
``tf2_msgs``, ``visualization_msgs``), field by field; a recording carries them along.
"""

from __future__ import annotations

_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "nav_msgs/MapMetaData": (
        "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\n"
        "uint32 height\ngeometry_msgs/Pose origin"
    ),
    "visualization_msgs/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] colors\nstring text\nstring mesh_resource\n"
        "bool mesh_use_embedded_materials"
    ),
}

_TOPS = {
    "nav_msgs/msg/OccupancyGrid": (
        "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data"
    ),
    "nav_msgs/msg/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "visualization_msgs/msg/MarkerArray": "visualization_msgs/Marker[] markers",
}


def _whole(text: str) -> str:
    """Return a definition followed by the definitions of all it is made of."""
    needed: list[str] = []
    todo = [text]
    while todo:
        for line in todo.pop().splitlines():
            part = line.split()[0].removesuffix("[]")
            if part in _PARTS and part not in needed:
                needed.append(part)
                todo.append(_PARTS[part])
    rule = "\n" + "=" * 80 + "\n"
    return rule.join([text, *(f"MSG: {name}\n{_PARTS[name]}" for name in needed)])


DEFINITIONS = {name: _whole(text) for name, text in _TOPS.items()}
"""Definitions by the names of their types."""
