"""Names and attachments as rmw_zenoh and zenoh-bridge-ros2dds expect them."""

from __future__ import annotations

import hashlib
import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from zenoh import KeyExpr, ZBytes
from zenoh.ext import Int64, z_deserialize

from drone_client.errors import LinkError
from drone_client.ros.names import (
    ODOMETRY,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED,
    RANGE,
    Flavour,
    attachment,
    check_frame,
    check_topic,
    gid,
    heard_key,
    key,
    node_name,
    node_token,
    publisher_token,
)

tokens = st.from_regex(r"[A-Za-z][A-Za-z0-9]{0,8}", fullmatch=True)
topics = st.lists(tokens, min_size=1, max_size=4).map("/".join)
MESSAGES = {
    POSE_STAMPED: "geometry_msgs/msg/PoseStamped",
    POSE_WITH_COVARIANCE_STAMPED: "geometry_msgs/msg/PoseWithCovarianceStamped",
}


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.dds_name)
@pytest.mark.parametrize("store", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_type_hashes_are_those_that_rosbags_computes(message, store):
    """From the definitions themselves (REP 2016)."""
    assert message.type_hash == get_typestore(store).hash_rihs01(MESSAGES[message])


def test_the_hashes_of_what_is_heard_are_those_of_jazzy():
    """Range has another in Humble: it is heard by any hash, and read as far as both agree."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    assert ODOMETRY.type_hash == jazzy.hash_rihs01("nav_msgs/msg/Odometry")
    assert RANGE.type_hash == jazzy.hash_rihs01("sensor_msgs/msg/Range")
    for message in (ODOMETRY, RANGE):
        heard = KeyExpr(heard_key(Flavour.RMW_ZENOH, "vio/odometry", message, 7))
        assert heard.includes(KeyExpr(key(Flavour.RMW_ZENOH, "vio/odometry", message, 7)))
        assert not heard.includes(KeyExpr(key(Flavour.RMW_ZENOH, "vio/odometry", message, 8)))
        assert heard_key(Flavour.BRIDGE, "vio/odometry", message, 7) == "vio/odometry"


def describe(name: str, fields: list[tuple[str, int, str, int]]) -> dict:
    """A type in the words of REP 2016: name, id, nested type, length of the array."""
    return {
        "type_name": f"geometry_msgs/msg/{name}" if "/" not in name else name,
        "fields": [
            {
                "name": field,
                "type": {
                    "type_id": type_id,
                    "capacity": length,
                    "string_capacity": 0,
                    "nested_type_name": nested,
                },
            }
            for field, type_id, nested, length in fields
        ],
    }


def test_type_hashes_are_those_of_the_descriptions():
    """SHA-256 of the description written out by hand, without rosbags."""
    nested, double, string, int32, uint32 = 1, 11, 17, 6, 7
    double_array = double + 48
    point = describe("Point", [(n, double, "", 0) for n in "xyz"])
    quaternion = describe("Quaternion", [(n, double, "", 0) for n in "xyzw"])
    pose = describe(
        "Pose",
        [
            ("position", nested, "geometry_msgs/msg/Point", 0),
            ("orientation", nested, "geometry_msgs/msg/Quaternion", 0),
        ],
    )
    time = describe(
        "builtin_interfaces/msg/Time", [("sec", int32, "", 0), ("nanosec", uint32, "", 0)]
    )
    header = describe(
        "std_msgs/msg/Header",
        [("stamp", nested, "builtin_interfaces/msg/Time", 0), ("frame_id", string, "", 0)],
    )
    with_covariance = describe(
        "PoseWithCovariance",
        [("pose", nested, "geometry_msgs/msg/Pose", 0), ("covariance", double_array, "", 36)],
    )
    parts = [time, point, pose, quaternion, header]
    for message, name, inner, more in (
        (POSE_STAMPED, "PoseStamped", "Pose", []),
        (
            POSE_WITH_COVARIANCE_STAMPED,
            "PoseWithCovarianceStamped",
            "PoseWithCovariance",
            [with_covariance],
        ),
    ):
        described = {
            "type_description": describe(
                name,
                [
                    ("header", nested, "std_msgs/msg/Header", 0),
                    ("pose", nested, f"geometry_msgs/msg/{inner}", 0),
                ],
            ),
            "referenced_type_descriptions": sorted(parts + more, key=lambda t: t["type_name"]),
        }
        digest = hashlib.sha256(json.dumps(described).encode()).hexdigest()
        assert message.type_hash == f"RIHS01_{digest}"


@given(topics)
def test_a_topic_is_itself_with_or_without_its_slash(topic):
    """And is a key of Zenoh's in both flavours."""
    assert check_topic(topic) == check_topic("/" + topic) == topic
    assert key(Flavour.BRIDGE, topic, POSE_STAMPED, 0) == topic
    for flavour in Flavour:
        text = key(flavour, topic, POSE_STAMPED, 7)
        assert str(KeyExpr.autocanonize(text)) == text
        assert "*" not in text


def test_the_key_of_rmw_zenoh():
    """Domain, topic, type, hash."""
    assert key(Flavour.RMW_ZENOH, "target_pose", POSE_STAMPED, 0) == (
        "0/target_pose/geometry_msgs::msg::dds_::PoseStamped_/"
        "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
    )


@pytest.mark.parametrize(
    "topic", ["", "/", "a//b", "a/", "//a", "9a", "a/9", "a b", "a-b", "~a", "a*", "a__b", "ä"]
)
def test_what_is_no_topic_is_refused_with_an_example(topic):
    """One line that says what a topic looks like."""
    with pytest.raises(LinkError, match="is no ROS 2 topic.*such as drone_1/target_pose"):
        check_topic(topic)


def test_a_topic_longer_than_dds_allows_is_refused():
    """With the length."""
    with pytest.raises(LinkError, match="300 characters, at most 200"):
        check_topic("a" * 300)


@pytest.mark.parametrize("frame", ["", "/world", "a b", "world/"])
def test_what_is_no_frame_is_refused(frame):
    """tf2 takes none of them."""
    with pytest.raises(LinkError, match="is no ROS 2 frame"):
        check_frame(frame)


def test_names_of_drones_become_names_of_nodes():
    """No hyphen, no two underscores, none at the end."""
    assert node_name("drone-1") == "aerial_contact_drone_1"
    assert node_name("7--x_") == "aerial_contact_7_x"
    assert check_frame("drone_1/odom") == "drone_1/odom"


def test_liveliness_tokens():
    """Slashes of names as percent signs; thirteen parts, none of them empty."""
    assert node_token(3, "ab12", "n") == "@ros2_lv/3/ab12/0/0/NN/%/%/n"
    token = publisher_token(3, "ab12", "n", 2, "a/b", POSE_STAMPED)
    assert token == (
        "@ros2_lv/3/ab12/0/2/MP/%/%/n/%a%b/geometry_msgs::msg::dds_::PoseStamped_/"
        f"{POSE_STAMPED.type_hash}/::,1:,:,:,,"
    )
    assert str(KeyExpr.autocanonize(token)) == token
    parts = token.split("/")
    assert len(parts) == 13
    assert all(parts)


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_the_attachment_is_what_zenohs_own_deserialiser_reads(sequence, unix_ns, publisher_gid):
    """Two numbers and a sequence of bytes; 33 bytes in all."""
    data = attachment(sequence, unix_ns, publisher_gid)
    assert len(data) == 33
    assert data == struct.pack("<qq", sequence, unix_ns) + b"\x10" + publisher_gid
    read = z_deserialize(tuple[Int64, Int64, bytes], ZBytes(data))
    assert read == (sequence, unix_ns, publisher_gid)


def test_a_gid_of_another_length_is_refused():
    """It would end the subscriber's process."""
    with pytest.raises(ValueError, match="15 bytes"):
        attachment(1, 0, bytes(15))
    assert len(gid("token")) == 16
    assert gid("token") != gid("tokem")
