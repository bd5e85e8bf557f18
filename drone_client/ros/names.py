"""What a ROS 2 topic is called in Zenoh, for the two ways into ROS 2.

``bridge``: zenoh-bridge-ros2dds takes a topic's bare name as key and finds out the rest.

``rmw_zenoh``: ROS 2 nodes that speak Zenoh themselves subscribe to a key with domain, type and
type hash in it, and read an attachment with every message::

    <domain>/<topic>/<type>/<hash>
    attachment: i64 sequence, i64 Unix time [ns] of sending, u8 16, 16 bytes of the publisher's gid

A message without that attachment is not delivered, and one that is malformed ends the subscriber's
process. ``ros2 topic list`` and its like read liveliness tokens; messages flow without them::

    @ros2_lv/<domain>/<session>/<node>/<node>/NN/<enclave>/<namespace>/<name>
    @ros2_lv/<domain>/<session>/<node>/<id>/MP/<enclave>/<namespace>/<name>/<topic>/<type>/<hash>/<qos>

with ``%`` for each slash in a name (docs/design.md of ros2/rmw_zenoh).
"""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from enum import StrEnum

from drone_client.errors import LinkError

MAX_TOPIC_CHARACTERS = 200
"""DDS takes 255, prefixes and suffixes included."""
MAX_DOMAIN = 232
"""More have no ports in DDS."""
_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
_NODE_ID = 0
_QOS = "::,1:,:,:,,"
"""Reliable, volatile, keep the last one; what is empty has rmw_zenoh's default. A reliable
publisher that keeps the last drops rather than blocks there, too."""


class Flavour(StrEnum):
    """The way into ROS 2."""

    BRIDGE = "bridge"
    """zenoh-bridge-ros2dds."""
    RMW_ZENOH = "rmw_zenoh"
    """ROS 2 nodes on rmw_zenoh_cpp, from Jazzy on: Humble has no type hashes."""


@dataclass(frozen=True, slots=True)
class MessageType:
    """A ROS 2 message type, as rmw_zenoh writes it into its keys."""

    dds_name: str
    type_hash: str
    """REP 2016: SHA-256 of the type's description."""


POSE_STAMPED = MessageType(
    "geometry_msgs::msg::dds_::PoseStamped_",
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
)
POSE_WITH_COVARIANCE_STAMPED = MessageType(
    "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
    "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
)
ODOMETRY = MessageType(
    "nav_msgs::msg::dds_::Odometry_",
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
)
RANGE = MessageType(
    "sensor_msgs::msg::dds_::Range_",
    "RIHS01_b42b62562e93cbfe9d42b82fe5994dfa3d63d7d5c90a317981703f7388adff3a",
)


def check_topic(topic: str) -> str:
    """The topic without its leading slash.

    Raises:
        LinkError: it is no ROS 2 topic name; says what one looks like.
    """
    name = topic.removeprefix("/")
    problem = None
    if not all(_TOKEN.fullmatch(token) for token in name.split("/")):
        problem = "write letters, digits and _ between slashes, no digit first"
    elif "__" in name:
        problem = "ROS 2 allows no two underscores in a row"
    elif len(name) > MAX_TOPIC_CHARACTERS:
        problem = f"{len(name)} characters, at most {MAX_TOPIC_CHARACTERS}"
    if problem is not None:
        raise LinkError(f"{topic!r} is no ROS 2 topic: {problem}; such as drone_1/target_pose")
    return name


def check_frame(frame_id: str) -> str:
    """The frame itself.

    Raises:
        LinkError: it is no name of a frame.
    """
    if not all(_TOKEN.fullmatch(token) for token in frame_id.split("/")):
        raise LinkError(f"{frame_id!r} is no ROS 2 frame; such as world or drone_1/odom")
    return frame_id


def node_name(drone: str) -> str:
    """Name of the node that a drone appears as: ROS 2 allows no hyphen and no digit first."""
    return "aerial_contact_" + re.sub(r"_+", "_", drone.replace("-", "_")).rstrip("_")


def key(flavour: Flavour, topic: str, message: MessageType, domain: int) -> str:
    """Zenoh key of a topic; ``topic`` without leading slash."""
    if flavour is Flavour.BRIDGE:
        return topic
    return f"{domain}/{topic}/{message.dds_name}/{message.type_hash}"


def heard_key(flavour: Flavour, topic: str, message: MessageType, domain: int) -> str:
    """Key to subscribe to: any version of the type, for what we read stands in all of them."""
    if flavour is Flavour.BRIDGE:
        return topic
    return f"{domain}/{topic}/{message.dds_name}/*"


def node_token(domain: int, session: str, node: str) -> str:
    """Key of the liveliness token of a node in the root namespace."""
    return f"@ros2_lv/{domain}/{session}/{_NODE_ID}/{_NODE_ID}/NN/%/%/{node}"


def publisher_token(
    domain: int, session: str, node: str, number: int, topic: str, message: MessageType
) -> str:
    """Key of the liveliness token of a node's publisher; ``number`` tells it from the others."""
    mangled = "%" + topic.replace("/", "%")
    return (
        f"@ros2_lv/{domain}/{session}/{_NODE_ID}/{number}/MP/%/%/{node}"
        f"/{mangled}/{message.dds_name}/{message.type_hash}/{_QOS}"
    )


def gid(token: str) -> bytes:
    """16 bytes that tell a publisher from every other."""
    return hashlib.blake2b(token.encode(), digest_size=_GID_BYTES).digest()


def attachment(sequence: int, unix_ns: int, publisher_gid: bytes) -> bytes:
    """What rmw_zenoh wants beside each message.

    Args:
        sequence: from 1, of this publisher.
        unix_ns: Unix time [ns] of sending.
        publisher_gid: 16 bytes.
    """
    if len(publisher_gid) != _GID_BYTES:
        raise ValueError(f"a gid of {len(publisher_gid)} bytes, expected {_GID_BYTES}")
    return _ATTACHMENT.pack(sequence, unix_ns, _GID_BYTES, publisher_gid)
