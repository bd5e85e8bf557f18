"""The CDR bytes, read and written by rosbags, which learned them from ROS 2's own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from drone_client.ros.cdr import pose_stamped, pose_with_covariance_stamped
from rgbd_wire.geometry import Pose, quaternion_from_rotation, rotation_from_vector

STORES = [get_typestore(store) for store in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY)]
PLAIN = "geometry_msgs/msg/PoseStamped"
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"

numbers = st.floats(-1e6, 1e6)
unix_times = st.integers(0, 2**31 * 10**9 - 1)
frames = st.text("abcdefghij_/0123456789ä", min_size=1, max_size=24)
poses = st.builds(
    lambda t, r: Pose(np.array(t), quaternion_from_rotation(rotation_from_vector(np.array(r)))),
    st.tuples(numbers, numbers, numbers),
    st.tuples(*[st.floats(-3, 3)] * 3),
)
covariances = st.lists(st.floats(-1e12, 1e12), min_size=36, max_size=36).map(
    lambda values: np.array(values).reshape(6, 6)
)


def read_back(store, data, kind):
    message = store.deserialize_cdr(data, kind)
    # One way to write a message: what we wrote is what rosbags writes
    assert bytes(store.serialize_cdr(message, kind)) == data
    return message


def assert_header_and_pose(header, ros_pose, unix_ns, frame_id, pose):
    assert header.stamp.sec * 10**9 + header.stamp.nanosec == unix_ns
    assert header.stamp.nanosec < 10**9
    assert header.frame_id == frame_id
    p, q = ros_pose.position, ros_pose.orientation
    assert [p.x, p.y, p.z] == pose.translation.tolist()
    assert [q.w, q.x, q.y, q.z] == pose.q_wxyz.tolist()


@pytest.mark.parametrize("store", STORES, ids=["humble", "jazzy"])
@given(unix_ns=unix_times, frame_id=frames, pose=poses)
def test_pose_stamped(store, unix_ns, frame_id, pose):
    """Every number comes back, whatever the frame's length does to the alignment."""
    message = read_back(store, pose_stamped(unix_ns, frame_id, pose), PLAIN)
    assert_header_and_pose(message.header, message.pose, unix_ns, frame_id, pose)


@pytest.mark.parametrize("store", STORES, ids=["humble", "jazzy"])
@given(unix_ns=unix_times, frame_id=frames, pose=poses, covariance=covariances)
def test_pose_with_covariance_stamped(store, unix_ns, frame_id, pose, covariance):
    """The covariance by rows: x, y, z, rotation about X, Y, Z."""
    data = pose_with_covariance_stamped(unix_ns, frame_id, pose, covariance)
    message = read_back(store, data, WITH_COVARIANCE)
    assert_header_and_pose(message.header, message.pose.pose, unix_ns, frame_id, pose)
    assert message.pose.covariance.tolist() == covariance.ravel().tolist()


def test_the_bytes_of_a_pose():
    """Byte by byte, for someone who writes another reader."""
    data = pose_stamped(
        1_500_000_007, "w", Pose(np.array([1.0, 2.0, 3.0]), np.array([1.0, 0, 0, 0]))
    )
    assert data == bytes.fromhex(
        "00010000"  # plain CDR, little-endian
        "01000000 0765cd1d"  # 1 s, 500 000 007 ns
        "02000000 7700 0000"  # two bytes of text, then up to a multiple of 8
        "000000000000f03f 0000000000000040 0000000000000840"
        "0000000000000000 0000000000000000 0000000000000000 000000000000f03f"  # x y z w
    )


@given(poses, st.tuples(*[st.floats(-0.02, 0.02)] * 3))
def test_a_small_rotation_vector_from_the_left_is_three_fixed_axis_angles(pose, vector):
    """ROS's convention and ours agree to first order, at any attitude of the target."""
    f = np.array(vector)
    attitude = pose.rotation
    turned = rotation_from_vector(f) @ attitude
    angles = Rotation.from_matrix(turned @ attitude.T).as_euler("xyz")  # small letters: fixed axes
    assert np.abs(angles - f).max() <= f @ f + 1e-12


def test_times_before_the_epoch_count_upwards_from_a_second():
    """The nanoseconds are never negative."""
    message = STORES[0].deserialize_cdr(pose_stamped(-1, "w", Pose.identity()), PLAIN)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (-1, 999_999_999)


@pytest.mark.parametrize(
    "make",
    [
        lambda: pose_stamped(2**31 * 10**9, "w", Pose.identity()),
        lambda: pose_stamped(0, "w\0", Pose.identity()),
        lambda: pose_with_covariance_stamped(0, "w", Pose.identity(), np.zeros(21)),
    ],
    ids=["after 2038", "NUL in the frame", "covariance of 21 numbers"],
)
def test_what_cannot_be_written_is_refused(make):
    """Rather than written wrongly."""
    with pytest.raises(ValueError, match="32 bits|NUL|shape"):
        make()
