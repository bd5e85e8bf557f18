"""Bags written by rosbags' and mcap's own writers."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from tests.unit.drone_client.builders import HEIGHT, SECOND, WIDTH

T0_NS = 1_700_000_000 * SECOND
LATER_NS = 3600 * SECOND
"""Received an hour after the header's stamp: nobody may look at it."""
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
COLOR, DEPTH = "/camera/color/image_raw", "/camera/depth/image_rect_raw"
COLOR_FRAME, DEPTH_FRAME = "camera_color_optical_frame", "camera_depth_optical_frame"


class Messages:
    """Makes messages of one ROS; a bag is a list of (topic, type, message, stamp)."""

    def __init__(self, store=ROS2) -> None:
        self.store = store
        self.ros1 = store is ROS1

    def make(self, kind: str, **fields):
        """A message by its short name."""
        return self.store.types[kind](**fields)

    def header(self, t_ns: int, frame: str = ""):
        """A header; ROS 1's counts."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=t_ns // SECOND, nanosec=t_ns % SECOND)
        more = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def image(self, t_ns: int, picture: np.ndarray, encoding: str, padding: int = 0, big=False):
        """A raw picture, with padded rows if asked for."""
        rows = np.ascontiguousarray(picture)
        if big:
            rows = rows.byteswap()
        rows = rows.view(np.uint8).reshape(picture.shape[0], -1)
        rows = np.pad(rows, ((0, 0), (0, padding)))
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(t_ns),
            height=picture.shape[0],
            width=picture.shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=rows.shape[1],
            data=rows.ravel(),
        )

    def compressed(self, t_ns: int, data: bytes, form: str):
        """A compressed picture."""
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(t_ns),
            format=form,
            data=np.frombuffer(data, np.uint8),
        )

    def info(self, frame: str, focal=20.0, model="plumb_bob", d=(), width=WIDTH, height=HEIGHT):
        """A CameraInfo; P has another focal length than K."""
        k = np.array([focal, 0, 7.5, 0, focal + 1, 5.5, 0, 0, 1.0])
        p = np.array([focal - 2, 0, 7, 0, 0, focal - 2, 5, 0, 0, 0, 1.0, 0])
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        matrices = {"d": np.array(d, dtype=np.float64), "k": k, "r": np.eye(3).ravel(), "p": p}
        if self.ros1:
            matrices = {name.upper(): value for name, value in matrices.items()}
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(T0_NS, frame),
            height=height,
            width=width,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **matrices,
        )

    def vector(self, kind: str, xyz):
        """A point or a vector."""
        x, y, z = (float(v) for v in xyz)
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, rotation_vector):
        """Of a rotation vector, by SciPy."""
        x, y, z, w = (float(v) for v in Rotation.from_rotvec(rotation_vector).as_quat())
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def transform(self, t_ns, parent, child, xyz, rotation_vector=(0, 0, 0)):
        """A TFMessage with one transform."""
        transform = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.vector("Vector3", xyz),
            rotation=self.quaternion(rotation_vector),
        )
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(t_ns, parent),
            child_frame_id=child,
            transform=transform,
        )
        return self.make("tf2_msgs/msg/TFMessage", transforms=[stamped])

    def pose(self, xyz, rotation_vector):
        """A plain pose."""
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector("Point", xyz),
            orientation=self.quaternion(rotation_vector),
        )

    def pose_stamped(self, t_ns, xyz, rotation_vector=(0, 0, 0)):
        """A PoseStamped."""
        return self.make(
            "geometry_msgs/msg/PoseStamped",
            header=self.header(t_ns, "odom"),
            pose=self.pose(xyz, rotation_vector),
        )

    def odometry(self, t_ns, xyz, rotation_vector=(0, 0, 0)):
        """An Odometry."""
        still = self.make(
            "geometry_msgs/msg/Twist",
            linear=self.vector("Vector3", (0, 0, 0)),
            angular=self.vector("Vector3", (0, 0, 0)),
        )
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(t_ns, "odom"),
            child_frame_id="base_link",
            pose=self.make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self.pose(xyz, rotation_vector),
                covariance=np.zeros(36),
            ),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=np.zeros(36)
            ),
        )


def png(picture: np.ndarray) -> bytes:
    """As OpenCV writes it; of colours, blue is first."""
    return cv2.imencode(".png", picture)[1].tobytes()


def compressed_depth(picture: np.ndarray, a: float = 0.0, b: float = 0.0) -> bytes:
    """With the head of compressed_depth_image_transport."""
    return struct.pack("<iff", 0, a, b) + png(picture)


def color_of(number: int) -> np.ndarray:
    """A picture that tells its number and its channels apart; red is first."""
    return np.full((HEIGHT, WIDTH, 3), (200, 100, number), np.uint8)


def depth_of(number: int) -> np.ndarray:
    """Millimetres."""
    return np.full((HEIGHT, WIDTH), 1000 + number, np.uint16)


def camera_messages(m: Messages, color=COLOR, depth=DEPTH):
    """CameraInfo of both, and the transform between them, depth hanging on colour."""
    return [
        (color.rpartition("/")[0] + "/camera_info", m.info(COLOR_FRAME, d=(0.1, 0.2, 0, 0, 0.3))),
        (depth.rpartition("/")[0] + "/camera_info", m.info(DEPTH_FRAME, focal=30.0)),
        ("/tf_static", m.transform(T0_NS, "camera_link", COLOR_FRAME, (0.0, 0.02, 0.0))),
        (
            "/tf_static",
            m.transform(T0_NS, COLOR_FRAME, DEPTH_FRAME, (-0.059, 0.001, 0.002), (0, 0.01, 0)),
        ),
    ]


def pictures(m: Messages, count: int = 3, color=COLOR, depth=DEPTH):
    """So many pairs at 30 Hz, depth 4 ms late, numbered by their pixels."""
    out = []
    for n in range(count):
        t_ns = T0_NS + n * SECOND // 30
        out.append((color, m.image(t_ns, color_of(n), "rgb8")))
        out.append((depth, m.image(t_ns + 4_000_000, depth_of(n), "16UC1")))
    return out


def write_ros2(folder: Path, messages, m: Messages, storage=StoragePlugin.SQLITE3) -> Path:
    """By rosbags."""
    with Ros2Writer(folder, version=9, storage_plugin=storage) as writer:
        _write(writer, messages, m.store.serialize_cdr, m.store)
    return folder


def write_ros1(path: Path, messages, m: Messages) -> Path:
    """By rosbags, for ROS 1."""
    with Ros1Writer(path) as writer:
        _write(writer, messages, m.store.serialize_ros1, m.store)
    return path


def _write(writer, messages, serialize, store):
    connections = {}
    for number, (topic, message) in enumerate(messages):
        kind = message.__msgtype__
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        data = serialize(message, kind)
        writer.write(connections[topic], T0_NS + LATER_NS + number, data)


def write_mcap(
    path: Path,
    messages,
    m: Messages,
    *,
    compression=CompressionType.ZSTD,
    chunk_bytes=4096,
    encoding="cdr",
    finish=True,
    **options,
) -> Path:
    """By mcap; without ``finish`` as a recorder leaves it that lost power between two chunks."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=chunk_bytes, compression=compression, **options)
        writer.start(profile="ros2", library="test")
        channels = {}
        for number, (topic, message) in enumerate(messages):
            kind = message.__msgtype__
            if topic not in channels:
                text, _ = m.store.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, encoding, schema)
            data = bytes(m.store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], T0_NS + LATER_NS + number, data, T0_NS + number)
        if finish:
            writer.finish()
    return path
