"""Poses over real Zenoh sessions on loopback, as a ROS 2 subscriber would read them."""

from __future__ import annotations

import json
import queue

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore
from zenoh.ext import Int64, z_deserialize

from drone_client.errors import LinkError
from drone_client.ros.names import POSE_STAMPED, POSE_WITH_COVARIANCE_STAMPED, Flavour
from drone_client.ros.publish import open_ros
from drone_client.ros.zenoh import RosPoses
from drone_client.settings import ClientSettings
from rgbd_wire.clock import ManualClock
from tests.service_process import free_port
from tests.unit.drone_client.builders import eventually, pose

STORE = get_typestore(Stores.ROS2_JAZZY)
MS = 1_000_000
UNIX_NS = 1_800_000_000_123_456_789
T_CAPTURE_NS = 5_000 * MS
NOW_NS = T_CAPTURE_NS + 80 * MS
COVARIANCE = np.arange(36.0).reshape(6, 6)
POSE = pose((1.0, -2.0, 3.0), (0.1, 0.2, -0.3))
PLAIN = "geometry_msgs/msg/PoseStamped"
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class Session:
    """The other end: the bridge, or ROS 2's own router."""

    def __init__(self, endpoint: str, mode: str = "router", connect: bool = False) -> None:
        config = zenoh.Config()
        for path, value in {
            "mode": mode,
            "connect/endpoints" if connect else "listen/endpoints": [endpoint],
            "listen/endpoints" if connect else "connect/endpoints": [],
            "open/return_conditions/connect_scouted": False,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": False,
        }.items():
            config.insert_json5(path, json.dumps(value))
        self.zenoh = zenoh.open(config)
        self.samples: queue.Queue[zenoh.Sample] = queue.Queue()
        self.tokens: queue.Queue[zenoh.Sample] = queue.Queue()

    def subscribe(self, *keys: str) -> None:
        for key in keys:
            callback = zenoh.handlers.Callback(self.samples.put, indirect=False)
            self.zenoh.declare_subscriber(key, callback)

    def watch_tokens(self, key: str) -> None:
        self.zenoh.liveliness().declare_subscriber(key, self.tokens.put, history=True)

    def take(self) -> zenoh.Sample:
        return self.samples.get(timeout=20)


@pytest.fixture
def start():
    """Starts things that are closed whatever becomes of the test, the newest first."""
    started = []

    def start(make, *args, **kwargs):
        started.append(make(*args, **kwargs))
        return started[-1]

    yield start
    for thing in reversed(started):
        (thing.zenoh if isinstance(thing, Session) else thing).close()


@pytest.fixture
def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


def poses_to(endpoint: str, **options) -> RosPoses:
    return RosPoses(
        "drone-1",
        (endpoint,),
        "/drone_1/target_pose",
        ManualClock(NOW_NS),
        unix_ns=lambda: UNIX_NS,
        **options,
    )


def publish_until_heard(poses: RosPoses, session: Session) -> dict[str, zenoh.Sample]:
    """The first sample of each of the two keys: a subscription takes a moment to get round."""
    heard: dict[str, zenoh.Sample] = {}

    def holds() -> bool:
        poses.publish(POSE, COVARIANCE, T_CAPTURE_NS)
        while not session.samples.empty():
            sample = session.samples.get()
            heard.setdefault(str(sample.key_expr), sample)
        return len(heard) == 2

    assert eventually(lambda: poses.connected, timeout_s=20)
    assert eventually(holds, timeout_s=20)
    return heard


def assert_is_the_pose(message, ros_pose, frame_id="world"):
    stamp = message.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == UNIX_NS - 80 * MS
    assert message.header.frame_id == frame_id
    p, q = ros_pose.position, ros_pose.orientation
    assert [p.x, p.y, p.z] == POSE.translation.tolist()
    assert [q.w, q.x, q.y, q.z] == POSE.q_wxyz.tolist()


@pytest.mark.parametrize("mode", ["router", "peer"])
def test_a_bridge_gets_both_messages_on_bare_topic_names(start, endpoint, mode):
    """The stamp is the capture time on the drone's wall clock; nothing is attached."""
    bridge = start(Session, endpoint, mode)
    bridge.subscribe("drone_1/*")
    poses = start(poses_to, endpoint, frame_id="odom")
    heard = publish_until_heard(poses, bridge)
    plain = heard["drone_1/target_pose"]
    message = STORE.deserialize_cdr(plain.payload.to_bytes(), PLAIN)
    assert_is_the_pose(message, message.pose, "odom")
    other = heard["drone_1/target_pose_with_covariance"]
    message = STORE.deserialize_cdr(other.payload.to_bytes(), WITH_COVARIANCE)
    assert_is_the_pose(message, message.pose.pose, "odom")
    assert message.pose.covariance.tolist() == COVARIANCE.ravel().tolist()
    assert plain.attachment is other.attachment is None
    assert plain.congestion_control == zenoh.CongestionControl.DROP
    assert poses.errors == 0
    assert poses.published > 0


def test_rmw_zenoh_gets_its_keys_attachments_and_tokens(start, endpoint):
    """A subscriber that is a peer behind the router, as ROS 2 nodes are."""
    router = start(Session, endpoint)
    router.watch_tokens("@ros2_lv/7/**")
    node = start(Session, endpoint, "peer", connect=True)
    keys = {
        f"7/drone_1/target_pose/{POSE_STAMPED.dds_name}/{POSE_STAMPED.type_hash}": PLAIN,
        "7/drone_1/target_pose_with_covariance/"
        f"{POSE_WITH_COVARIANCE_STAMPED.dds_name}/{POSE_WITH_COVARIANCE_STAMPED.type_hash}": (
            WITH_COVARIANCE
        ),
    }
    node.subscribe(*keys)
    poses = start(poses_to, endpoint, flavour=Flavour.RMW_ZENOH, domain=7)
    heard = publish_until_heard(poses, node)
    assert heard.keys() == keys.keys()
    gids = set()
    for key, sample in heard.items():
        message = STORE.deserialize_cdr(sample.payload.to_bytes(), keys[key])
        assert_is_the_pose(message, message.pose if keys[key] == PLAIN else message.pose.pose)
        attached = sample.attachment.to_bytes()
        assert len(attached) == 33
        sequence, unix_ns, gid = z_deserialize(tuple[Int64, Int64, bytes], sample.attachment)
        assert sequence >= 1
        assert unix_ns == UNIX_NS
        gids.add(gid)
    assert len(gids) == 2
    tokens = [router.tokens.get(timeout=20) for _ in range(3)]
    kinds = sorted(str(token.key_expr).split("/")[5] for token in tokens)
    assert kinds == ["MP", "MP", "NN"]
    assert all("aerial_contact_drone_1" in str(token.key_expr) for token in tokens)
    poses.close()
    gone = [router.tokens.get(timeout=20) for _ in range(3)]
    assert [token.kind for token in gone] == [zenoh.SampleKind.DELETE] * 3


def test_the_domain_of_the_settings_is_published_in(start, endpoint):
    """Nodes of another ``ROS_DOMAIN_ID`` than 0 hear it as well."""
    router = start(Session, endpoint)
    router.subscribe("7/drone_1/**")
    settings = ClientSettings(
        ros_topic="drone_1/target_pose",
        ros_connect=endpoint,
        ros_flavour=Flavour.RMW_ZENOH,
        ros_domain=7,
    )
    poses = start(open_ros, settings, ManualClock(NOW_NS))
    assert all(key.startswith("7/") for key in publish_until_heard(poses, router))


def test_sequences_count_up_one_by_one_on_each_topic(start, endpoint):
    """rmw_zenoh tells from them what was lost."""
    router = start(Session, endpoint)
    router.subscribe("0/drone_1/**")
    poses = start(poses_to, endpoint, flavour=Flavour.RMW_ZENOH)
    publish_until_heard(poses, router)
    while poses.published < 30:
        poses.publish(POSE, COVARIANCE, T_CAPTURE_NS)
        # Each pose is waited for: a burst may be dropped, and then tells nothing of the numbers
        sequences = []
        while sequences != [poses.published] * 2:
            sample = router.take()
            sequence = z_deserialize(tuple[Int64, Int64, bytes], sample.attachment)[0]
            assert sequence <= poses.published
            if sequence == poses.published:
                sequences.append(sequence)


def test_nobody_there_at_first_then_there_then_away_and_back(start, endpoint):
    """Poses are dropped and counted until somebody listens; the way comes back by itself."""
    poses = start(poses_to, endpoint)
    for _ in range(5):
        poses.publish(POSE, COVARIANCE, T_CAPTURE_NS)
    assert (poses.not_connected, poses.published, poses.errors) == (5, 0, 0)
    for _ in range(2):
        bridge = Session(endpoint)
        try:
            bridge.subscribe("drone_1/**")
            publish_until_heard(poses, bridge)
        finally:
            bridge.zenoh.close()
    assert poses.errors == 0


def test_what_cannot_be_written_is_counted_and_not_raised(start, endpoint):
    """A wall clock past 2038, and a session that is closed."""
    start(Session, endpoint)
    poses = start(RosPoses, "d", (endpoint,), "t", ManualClock(), unix_ns=lambda: 2**31 * 10**9)
    assert eventually(lambda: poses.connected, timeout_s=20)
    poses.publish(POSE, COVARIANCE, 0)
    assert (poses.published, poses.errors) == (0, 1)
    late = start(poses_to, endpoint)
    assert eventually(lambda: late.connected, timeout_s=20)
    late.close()
    late.publish(POSE, COVARIANCE, T_CAPTURE_NS)
    assert (late.published, late.errors) == (0, 1)


def test_closing_while_nobody_is_there_takes_no_second_try(endpoint):
    """The thread that opens the session ends with it."""
    poses = poses_to(endpoint)
    poses.close()
    assert eventually(lambda: not poses._opener.is_alive(), timeout_s=20)
    poses.publish(POSE, COVARIANCE, T_CAPTURE_NS)
    assert poses.not_connected == 1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"endpoints": ()}, "no endpoint"),
        ({"endpoints": ("127.0.0.1:7447",)}, "did you mean tcp/127.0.0.1:7447"),
        ({"endpoints": ("tls/127.0.0.1:7447",)}, "over tcp/ alone"),
        ({"topic": "9 lives"}, "is no ROS 2 topic"),
        ({"topic": "ends_"}, "two underscores"),
        ({"frame_id": "/world"}, "is no ROS 2 frame"),
        ({"domain": 233}, "ROS domain 233, expected 0 to 232"),
    ],
)
def test_wrong_settings_are_refused_before_anything_starts(change, says):
    """With a sentence that says what is expected."""
    good = {"endpoints": ("tcp/127.0.0.1:7447",), "topic": "t", "frame_id": "world", "domain": 0}
    with pytest.raises(LinkError, match=says):
        RosPoses("d", clock=ManualClock(), **(good | change))
