"""VIO and lidar out of ROS 2: bytes that rosbags wrote, a real Zenoh session, the vehicle."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.autopilot.simulated import SimulatedAutopilot
from drone_client.errors import LinkError
from drone_client.odometry import OdometrySample, RangeSample
from drone_client.odometry.choose import open_odometry
from drone_client.odometry.feed import OdometryFeed
from drone_client.odometry.jump import Jump, JumpReason
from drone_client.odometry.ros_samples import SampleError, odometry_sample, range_sample
from drone_client.odometry.source import MemoryOdometry
from drone_client.odometry.zenoh import RosOdometry
from drone_client.ros.cdr_read import read_odometry, read_range
from drone_client.ros.names import ODOMETRY, RANGE, Flavour, key
from drone_client.settings import ClientSettings
from rgbd_wire.clock import ManualClock, MonotonicClock
from tests.service_process import free_port
from tests.unit.drone_client.builders import MS, SECOND, eventually, pose, rotation_of
from tests.unit.drone_client.ros_robot import (
    AGE_NS,
    BODY,
    COVARIANCE,
    HUMBLE,
    JAZZY,
    NOW_NS,
    UNIX_NS,
    VELOCITY_BODY,
    Robot,
    odometry_cdr,
    range_cdr,
)


@pytest.mark.parametrize("store", [HUMBLE, JAZZY], ids=["humble", "jazzy"])
@pytest.mark.parametrize("little_endian", [True, False])
@given(st.text("abcé_/", max_size=20), st.text("abc_", max_size=20))
def test_odometry_is_read_as_rosbags_wrote_it(store, little_endian, frame, child):
    """Every number, whatever the names do to the alignment, in either byte order."""
    got = read_odometry(odometry_cdr(store, frame=frame, child=child, little_endian=little_endian))
    assert (got.unix_ns, got.frame_id, got.child_frame_id) == (UNIX_NS - AGE_NS, frame, child)
    np.testing.assert_array_equal(got.position, BODY.translation)
    np.testing.assert_array_equal(got.q_wxyz, BODY.q_wxyz)
    np.testing.assert_array_equal(got.pose_covariance, COVARIANCE)
    np.testing.assert_array_equal(got.velocity_child, VELOCITY_BODY)
    np.testing.assert_array_equal(got.turn_child, (0.01, 0.02, 0.03))


@pytest.mark.parametrize("store", [HUMBLE, JAZZY], ids=["humble", "jazzy"])
@given(st.text("abc_", max_size=9))
def test_a_range_is_read_with_and_without_its_variance(store, frame):
    """Humble's message is four bytes shorter, and what we read stands before them."""
    got = read_range(range_cdr(store, frame=frame))
    assert (got.unix_ns, got.frame_id) == (UNIX_NS - AGE_NS, frame)
    assert (got.min_m, got.max_m, got.range_m) == pytest.approx((0.1, 12.0, 1.25))


@given(st.binary(max_size=900), st.integers(0, 900), st.binary(max_size=4))
def test_what_is_no_message_is_a_value_error(junk, cut, patch):
    """Noise, a message that is cut, one with bytes changed: a ``ValueError`` or numbers."""
    good = odometry_cdr()
    bent = good[:cut] + patch + good[cut + len(patch) :]
    for message in (junk, b"\x00\x01\x00\x00" + junk, good[:cut], bent):
        for read in (read_odometry, read_range):
            with suppress(ValueError):
                read(message)


def test_a_sample_is_the_body_in_a_level_world_on_the_drones_clock():
    """By SciPy: the twist is told in the body and turned into the world (REP 105)."""
    sample = odometry_sample(read_odometry(odometry_cdr()), UNIX_NS, NOW_NS)
    assert sample.t_ns == NOW_NS - AGE_NS
    np.testing.assert_allclose(sample.world_from_body.matrix, BODY.matrix)
    np.testing.assert_allclose(sample.velocity_world, rotation_of(BODY).apply(VELOCITY_BODY))
    np.testing.assert_array_equal(sample.covariance, COVARIANCE)


@pytest.mark.parametrize(
    "covariance", [np.zeros((6, 6)), -np.eye(6), np.full((6, 6), np.nan), 1e9 * np.eye(6)]
)
def test_a_covariance_that_says_nothing_is_none(covariance):
    """ROS has several ways not to know."""
    message = read_odometry(odometry_cdr(covariance=covariance))
    assert odometry_sample(message, UNIX_NS, NOW_NS).covariance is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"unix_ns": UNIX_NS - 2 * SECOND}, "stamp"),
        ({"unix_ns": UNIX_NS + 30 * MS}, "stamp"),
        ({"unix_ns": 0}, "stamp"),
        ({"velocity": np.array([np.nan, 0, 0])}, "not_a_number"),
    ],
)
def test_what_makes_no_sample_says_why(changes, reason):
    """A clock that is not this machine's, a filter that has diverged."""
    with pytest.raises(SampleError, match=reason):
        odometry_sample(read_odometry(odometry_cdr(**changes)), UNIX_NS, NOW_NS)


def test_a_quaternion_that_is_none_makes_no_sample():
    """All zeros: what an unset message holds."""
    message = read_odometry(odometry_cdr())._replace(q_wxyz=np.zeros(4))
    with pytest.raises(SampleError, match="not_a_pose"):
        odometry_sample(message, UNIX_NS, NOW_NS)
    assert range_sample(read_range(range_cdr()), UNIX_NS, NOW_NS, looks_down=False).valid


@pytest.fixture
def start():
    """Starts things that are closed whatever becomes of the test, the newest first."""
    started = []

    def start(make, *args, **kwargs):
        started.append(make(*args, **kwargs))
        return started[-1]

    yield start
    for thing in reversed(started):
        (thing.zenoh if isinstance(thing, Robot) else thing).close()


@pytest.fixture
def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.mark.parametrize("flavour", list(Flavour))
def test_vio_and_lidars_reach_the_autopilot_over_zenoh(start, endpoint, flavour):
    """Bytes of a ROS 2 node, a real session, and what the vehicle's estimator is given."""
    robot = start(Robot, endpoint)
    source = start(
        RosOdometry,
        (endpoint,),
        ManualClock(NOW_NS),
        vio_topic="/vio/odometry",
        lidar_topic="/lidar",
        ahead_topic="/wall",
        flavour=flavour,
        domain=3,
        unix_ns=lambda: UNIX_NS,
    )
    vehicle = SimulatedAutopilot(ManualClock(NOW_NS), pose())
    feed = OdometryFeed(source, vehicle)
    assert feed.tick(NOW_NS) is None
    assert eventually(lambda: source.connected, timeout_s=20)
    step = iter(range(10_000))

    def heard() -> bool:
        unix_ns = UNIX_NS - AGE_NS + next(step) * 1000
        robot.put(key(flavour, "vio/odometry", ODOMETRY, 3), odometry_cdr(unix_ns=unix_ns))
        robot.put(key(flavour, "lidar", RANGE, 3), range_cdr(HUMBLE, unix_ns, 1.25))
        robot.put(key(flavour, "wall", RANGE, 3), range_cdr(JAZZY, unix_ns, 2.5))
        forward_m = feed.tick(NOW_NS)
        known = (forward_m, vehicle.given_odometry, feed.height.newest(NOW_NS))
        return all(k is not None for k in known)

    assert eventually(heard, timeout_s=20)
    assert feed.tick(NOW_NS) == 2.5
    given = vehicle.given_odometry
    np.testing.assert_allclose(given.world_from_body.matrix, BODY.matrix)
    np.testing.assert_allclose(given.velocity_world, rotation_of(BODY).apply(VELOCITY_BODY))
    assert NOW_NS - AGE_NS <= given.t_ns <= NOW_NS
    assert feed.height.newest(NOW_NS).distance_m == 1.25
    assert not source.refused


def test_what_is_no_message_is_counted_and_the_next_one_is_taken(start, endpoint):
    """Junk, an old stamp, a message of megabytes: no exception, and no sample."""
    robot = start(Robot, endpoint)
    source = start(
        RosOdometry,
        (endpoint,),
        ManualClock(NOW_NS),
        vio_topic="vio",
        unix_ns=lambda: UNIX_NS,
    )
    assert eventually(lambda: source.connected, timeout_s=20)

    def junk() -> bool:
        for message in (b"", b"junk", bytes(900_000), odometry_cdr(unix_ns=5)):
            robot.put("vio", message)
        return source.refused["malformed"] >= 3 and source.refused["stamp"] >= 1

    assert eventually(junk, timeout_s=20)
    assert source.odometry() is None

    def good() -> bool:
        robot.put("vio", odometry_cdr())
        return source.odometry() is not None

    assert eventually(good, timeout_s=20)
    assert source.taken["odometry"] >= 1
    assert source.height() is source.ahead() is None


def test_nobody_there_is_no_sample_and_no_wait(endpoint):
    """The flight begins without it; closing takes no second try."""
    source = RosOdometry((endpoint,), ManualClock(NOW_NS), vio_topic="vio")
    assert source.odometry() is None
    source.close()
    assert not source.connected


@pytest.mark.parametrize(
    ("endpoints", "topics", "says"),
    [
        ((), {"vio_topic": "vio"}, "no endpoint"),
        (("tls/a:1",), {"vio_topic": "vio"}, "over tcp/ alone"),
        (("tcp/a:1",), {}, "no topic"),
        (("tcp/a:1",), {"lidar_topic": "9"}, "is no ROS 2 topic"),
        (("tcp/a:1",), {"vio_topic": "vio", "domain": 999}, "ROS domain 999"),
    ],
)
def test_what_cannot_be_heard_is_said_at_once(endpoints, topics, says):
    """Before any thread starts."""
    with pytest.raises(LinkError, match=says):
        RosOdometry(endpoints, ManualClock(NOW_NS), **topics)


class Given:
    """An estimator that keeps all it is given."""

    def __init__(self) -> None:
        self.odometry: list[OdometrySample] = []
        self.ranges: list[RangeSample] = []

    def give_odometry(self, sample: OdometrySample) -> None:
        self.odometry.append(sample)

    def give_range(self, sample: RangeSample) -> None:
        self.ranges.append(sample)


def test_each_sample_is_given_once_and_a_jump_is_counted_into_it():
    """The autopilot's estimator learns of the jump as MAVLink says it: by the count of resets."""
    source, estimator, jumps = MemoryOdometry(), Given(), []
    feed = OdometryFeed(source, estimator, jumps.append)
    sample = OdometrySample(0, pose(), np.zeros(3))
    for i in range(6):
        where = pose((0.3, 0, 0)) if i >= 4 else pose()
        source.newest_odometry = replace(sample, t_ns=i * 20 * MS, world_from_body=where)
        feed.tick(i * 20 * MS)
        feed.tick(i * 20 * MS + MS)
    assert [s.resets for s in estimator.odometry] == [0, 0, 0, 0, 1, 1]
    assert [j.reason for j in jumps] == [JumpReason.POSITION]
    assert feed.given == 6


def test_who_hears_of_a_jump_may_ask_for_the_counts():
    """From its own thread, and from another that it waits for: nobody waits for ever."""
    source, counted = MemoryOdometry(), []

    def on_jump(_jump: Jump) -> None:
        counted.append(feed.counts())
        other = threading.Thread(target=lambda: counted.append(feed.counts()), daemon=True)
        other.start()
        other.join(timeout=20)

    def fly() -> None:
        for i, x in enumerate((0.0, 0.0, 0.3)):
            where = pose((x, 0, 0))
            source.newest_odometry = OdometrySample(i * 20 * MS, where, np.zeros(3))
            feed.tick(i * 20 * MS)

    feed = OdometryFeed(source, Given(), on_jump)
    flying = threading.Thread(target=fly, daemon=True)
    flying.start()
    flying.join(timeout=40)
    assert not flying.is_alive()
    assert [(c["odometry_jumps"], c["odometry_given"]) for c in counted] == [(1, 3), (1, 3)]


def test_what_is_no_number_or_late_is_not_given():
    """The estimator hears nothing rather than nonsense; after it the count has changed."""
    source, estimator = MemoryOdometry(), Given()
    feed = OdometryFeed(source, estimator)
    good = OdometrySample(SECOND, pose(), np.zeros(3))
    for sample in (
        good,
        replace(good, t_ns=SECOND - 10 * MS),
        replace(good, t_ns=SECOND + 20 * MS, velocity_world=np.array([np.inf, 0, 0])),
        replace(good, t_ns=SECOND + 40 * MS),
    ):
        source.newest_odometry = sample
        feed.tick(sample.t_ns)
    assert [(s.t_ns, s.resets) for s in estimator.odometry] == [(SECOND, 0), (SECOND + 40 * MS, 1)]


def test_an_outlier_of_the_lidar_is_not_given():
    """Of six distances with an echo among them, the two first and the echo are held back."""
    source, estimator = MemoryOdometry(), Given()
    feed = OdometryFeed(source, estimator)
    for i, distance in enumerate((1.0, 1.0, 1.0, 1.0, 0.3, 1.0)):
        source.newest_height = RangeSample(i * 20 * MS, distance)
        assert feed.tick(i * 20 * MS) is None  # it looks down: nothing for the mission
    assert [r.distance_m for r in estimator.ranges] == [1.0, 1.0, 1.0]
    counts = feed.counts()
    assert (counts["height_taken"], counts["height_outlier"]) == (3, 1)
    assert counts["odometry_given"] == 0


def test_the_command_line_names_the_topics(endpoint):
    """None named: no source, and no thread; an endpoint out of the settings otherwise."""
    settings = ClientSettings(ros_connect=endpoint)
    assert open_odometry(settings, ManualClock(NOW_NS)) is None
    source = open_odometry(settings, ManualClock(NOW_NS), vio_topic="/vio/odometry")
    assert source is not None
    source.close()
    with pytest.raises(LinkError, match="is no ROS 2 topic"):
        open_odometry(settings, ManualClock(NOW_NS), ahead_topic="a b")


def test_the_domain_of_the_settings_is_listened_to(start, endpoint):
    """And no other: a neighbour's robot says where it is under the same topic."""
    robot, clock = start(Robot, endpoint), MonotonicClock()
    settings = ClientSettings(ros_connect=endpoint, ros_flavour=Flavour.RMW_ZENOH, ros_domain=7)
    source = start(open_odometry, settings, clock, vio_topic="vio/odometry")

    def heard() -> bool:
        near, far = (
            odometry_cdr(unix_ns=time.time_ns()),
            odometry_cdr(unix_ns=time.time_ns(), body=pose((9, 9, 9))),
        )
        robot.put(key(Flavour.RMW_ZENOH, "vio/odometry", ODOMETRY, 0), far)
        robot.put(key(Flavour.RMW_ZENOH, "vio/odometry", ODOMETRY, 7), near)
        return source.odometry() is not None

    assert eventually(heard, timeout_s=20)
    np.testing.assert_allclose(source.odometry().world_from_body.matrix, BODY.matrix)


def test_a_vio_that_falls_silent_is_noticed_and_one_that_never_spoke_is_not() -> None:
    """Half a second without anything new, or with what is no sample; then it speaks again."""
    source = MemoryOdometry()
    feed = OdometryFeed(source, Given())
    feed.tick(SECOND)
    assert not feed.silent(100 * SECOND)  # the autopilot has its own
    source.newest_odometry = OdometrySample(SECOND, pose((1, 2, 3)), np.zeros(3))
    feed.tick(SECOND)
    assert not feed.silent(SECOND + 500 * MS)
    assert feed.silent(SECOND + 501 * MS)
    source.newest_odometry = OdometrySample(2 * SECOND, pose((1, 2, 3)), np.zeros(3))
    feed.tick(2 * SECOND)
    assert not feed.silent(2 * SECOND)


@pytest.mark.parametrize("diverged", [{"at": 1e9}, {"mps": 1e9}])
def test_a_vio_that_diverges_and_goes_on_is_silent_until_it_is_back(diverged) -> None:
    """Its samples come, and not one can be passed on: the estimator flies by its IMU alone."""
    source, estimator = MemoryOdometry(), Given()
    feed = OdometryFeed(source, estimator)

    def say(t_ns: int, at: float = 1.0, mps: float = 0.0) -> None:
        source.newest_odometry = OdometrySample(t_ns, pose((at, 2, 3)), np.full(3, mps))
        feed.tick(t_ns)

    say(SECOND)
    for i in range(1, 100):
        say(SECOND + 20 * i * MS, **diverged)
        assert feed.silent(SECOND + 20 * i * MS) == (20 * i > 500)
    assert len(estimator.odometry) == 1
    say(4 * SECOND)
    assert not feed.silent(4 * SECOND)
