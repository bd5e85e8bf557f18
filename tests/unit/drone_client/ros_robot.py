"""A robot that runs ROS 2: bytes that rosbags writes, and the session that they leave by."""

from __future__ import annotations

import json

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

from tests.unit.drone_client.builders import MS, SECOND, pose

HUMBLE, JAZZY = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_JAZZY)
ODOMETRY_TYPE, RANGE_TYPE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Range"
UNIX_NS = 1_800_000_000_123_456_789
NOW_NS = 50 * SECOND
AGE_NS = 30 * MS
BODY = pose((1.0, -2.0, 1.5), (0.1, -0.2, 2.4))
VELOCITY_BODY = np.array([0.3, 0.1, -0.2])
COVARIANCE = np.diag([1e-4, 2e-4, 3e-4, 4e-5, 5e-5, 6e-5])


def ros(store, name: str, **fields):
    return store.types[name](**fields)


def header(store, unix_ns: int, frame: str):
    stamp = ros(
        store,
        "builtin_interfaces/msg/Time",
        sec=unix_ns // SECOND,
        nanosec=unix_ns % SECOND,
    )
    return ros(store, "std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def odometry_cdr(
    store=JAZZY,
    unix_ns=UNIX_NS - AGE_NS,
    body=BODY,
    velocity=VELOCITY_BODY,
    frame="odom",
    child="base_link",
    covariance=COVARIANCE,
    little_endian=True,
) -> bytes:
    """A ``nav_msgs/Odometry`` as a ROS 2 node writes it."""
    x, y, z = body.translation
    w, i, j, k = body.q_wxyz
    place = ros(store, "geometry_msgs/msg/Point", x=x, y=y, z=z)
    turn = ros(store, "geometry_msgs/msg/Quaternion", x=i, y=j, z=k, w=w)
    pose_ = ros(store, "geometry_msgs/msg/Pose", position=place, orientation=turn)
    vector = "geometry_msgs/msg/Vector3"
    twist = ros(
        store,
        "geometry_msgs/msg/Twist",
        linear=ros(store, vector, x=velocity[0], y=velocity[1], z=velocity[2]),
        angular=ros(store, vector, x=0.01, y=0.02, z=0.03),
    )
    message = ros(
        store,
        ODOMETRY_TYPE,
        header=header(store, unix_ns, frame),
        child_frame_id=child,
        pose=ros(
            store, "geometry_msgs/msg/PoseWithCovariance", pose=pose_, covariance=covariance.ravel()
        ),
        twist=ros(
            store, "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
        ),
    )
    return bytes(store.serialize_cdr(message, ODOMETRY_TYPE, little_endian=little_endian))


def range_cdr(store=JAZZY, unix_ns=UNIX_NS - AGE_NS, distance=1.25, frame="lidar") -> bytes:
    """A ``sensor_msgs/Range`` as a ROS 2 node writes it."""
    fields = {
        "header": header(store, unix_ns, frame),
        "radiation_type": 1,
        "field_of_view": 0.05,
        "min_range": 0.1,
        "max_range": 12.0,
        "range": distance,
    }
    if store is JAZZY:
        fields["variance"] = 0.01
    return bytes(store.serialize_cdr(ros(store, RANGE_TYPE, **fields), RANGE_TYPE))


class Robot:
    """What runs ROS 2 on the robot: a bridge, or the router of rmw_zenoh."""

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        for path, value in {
            "mode": "router",
            "listen/endpoints": [endpoint],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": False,
        }.items():
            config.insert_json5(path, json.dumps(value))
        self.zenoh = zenoh.open(config)

    def put(self, where: str, message: bytes) -> None:
        self.zenoh.put(where, message)
