"""Where the drone was: interpolated between what is known, and None where nobody can know."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Slerp

from drone_client.pose_buffer import MAX_EXTRAPOLATION_NS, MAX_GAP_NS, PoseBuffer
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, pose, poses, rotation_of


def assert_same(a: Pose | None, b: Pose | None, atol: float = 1e-12) -> None:
    """Both are the same pose, or neither is one."""
    if a is None or b is None:
        assert a is b
        return
    np.testing.assert_allclose(a.translation, b.translation, atol=atol)
    assert (rotation_of(a) * rotation_of(b).inv()).magnitude() <= max(atol, 1e-7)


@given(
    st.lists(st.tuples(st.integers(1, MAX_GAP_NS), poses), min_size=2, max_size=8),
    st.floats(0, 1),
)
def test_interpolates_as_scipy_does(steps, share):
    """Between neighbours: linear in translation, SLERP in rotation."""
    buffer = PoseBuffer()
    times = np.cumsum([gap for gap, _ in steps])
    known = [p for _, p in steps]
    for t, p in zip(times, known, strict=True):
        assert buffer.add(int(t), p)
    t = int(times[0] + share * (times[-1] - times[0]))
    got = buffer.at(t)
    assert got is not None

    i = min(int(np.searchsorted(times, t, side="right")) - 1, len(times) - 2)
    s = (t - times[i]) / (times[i + 1] - times[i])
    a, b = known[i], known[i + 1]
    np.testing.assert_allclose(
        got.translation, (1 - s) * a.translation + s * b.translation, atol=1e-9
    )
    turn = rotation_of(a).inv() * rotation_of(b)
    if turn.magnitude() < np.pi - 1e-3:  # half a turn can go either way
        ends = rotation_of(a).concatenate([rotation_of(a), rotation_of(b)])
        expected = Slerp([0, 1], ends)(s)
        # Under 0.06 rad the code goes straight and normalises: 2e-6 rad off at most
        assert (expected.inv() * rotation_of(got)).magnitude() < 3e-6


def test_a_known_time_gives_the_very_pose():
    """No interpolation where there is nothing between, even beside a gap."""
    buffer = PoseBuffer()
    for i, t in enumerate((0, 1000 * MS, 1010 * MS)):
        buffer.add(t, pose((i, 0, 0)))
    assert [buffer.at(t).translation[0] for t in (0, 1000 * MS, 1010 * MS)] == [0, 1, 2]


@pytest.mark.parametrize("ends", [1, 2])
def test_stands_for_20_ms_outside_and_no_longer(ends):
    """The first and the last pose are good for 20 ms, inclusive; beyond nobody knows."""
    assert MAX_EXTRAPOLATION_NS == 20 * MS
    buffer = PoseBuffer()
    first, last = pose((1, 2, 3)), pose((4, 5, 6), (0, 0, 1))
    buffer.add(1000 * MS, first)
    if ends == 2:
        buffer.add(1100 * MS, last)
    newest, end = (first, 1000 * MS) if ends == 1 else (last, 1100 * MS)
    assert_same(buffer.at(980 * MS), first)
    assert buffer.at(980 * MS - 1) is None
    assert_same(buffer.at(end + 20 * MS), newest)
    assert buffer.at(end + 20 * MS + 1) is None


def test_does_not_bridge_a_gap():
    """Two poses more than 200 ms apart are not interpolated: odometry was lost between them."""
    buffer = PoseBuffer()
    buffer.add(0, pose((0, 0, 0)))
    buffer.add(MAX_GAP_NS, pose((1, 0, 0)))
    buffer.add(2 * MAX_GAP_NS + 1, pose((2, 0, 0)))
    assert_same(buffer.at(MAX_GAP_NS // 2), pose((0.5, 0, 0)))
    assert buffer.at(MAX_GAP_NS + MAX_GAP_NS // 2) is None


def test_an_empty_buffer_knows_nothing():
    """No pose, no answer."""
    assert PoseBuffer().at(0) is None


@given(st.lists(st.integers(0, 50), max_size=30))
def test_only_newer_poses_are_kept(times):
    """A pose that is not newer than all before is refused, and changes nothing."""
    buffer = PoseBuffer()
    newest = -1
    kept = 0
    for i, t in enumerate(times):
        assert buffer.add(t * MS, pose((i, 0, 0))) is (t > newest)
        kept += t > newest
        newest = max(newest, t)
    assert len(buffer) == kept


def test_is_bounded_and_forgets_the_oldest():
    """A flight of any length takes the same memory."""
    buffer = PoseBuffer(capacity=3)
    for i in range(100):
        buffer.add(i * 100 * MS, pose((i, 0, 0)))
    assert len(buffer) == 3
    assert buffer.at(96 * 100 * MS) is None
    assert_same(buffer.at(97 * 100 * MS), pose((97, 0, 0)))


def test_nothing_is_interpolated_across_a_jump():
    """Between the last pose of one world and the first of the next lies no pose of either."""
    buffer = PoseBuffer()
    buffer.add(0, pose((0, 0, 0)))
    buffer.add(50 * MS, pose((1, 0, 0)))
    buffer.begin_epoch(100 * MS)
    buffer.add(100 * MS, pose((9, 0, 0)))
    buffer.add(150 * MS, pose((10, 0, 0)))
    old, new = buffer.find(25 * MS), buffer.find(125 * MS)
    assert (old.epoch, new.epoch, buffer.epoch) == (0, 1, 1)
    assert_same(old.pose, pose((0.5, 0, 0)))
    assert_same(new.pose, pose((9.5, 0, 0)))
    assert buffer.find(70 * MS).epoch == 0  # for 20 ms, as any last pose
    assert buffer.find(70 * MS + 1) is None
    assert buffer.find(100 * MS - 1) is None
    assert buffer.find(100 * MS).epoch == 1


def test_a_pose_of_another_world_is_none_to_whoever_asks_for_one():
    """``at`` knows the present world alone."""
    buffer = PoseBuffer()
    buffer.add(0, pose((0, 0, 0)))
    buffer.begin_epoch(50 * MS)
    assert buffer.at(0) is None
    assert buffer.find(0).epoch == 0
    buffer.add(50 * MS, pose((9, 0, 0)))
    assert buffer.at(0) is None
    assert_same(buffer.at(60 * MS), pose((9, 0, 0)))


def test_a_clock_that_went_back_makes_room_for_the_new_world():
    """Poses of the old one that lie ahead are forgotten, and the new ones are taken."""
    buffer = PoseBuffer()
    for t in (100, 200, 300):
        buffer.add(t * MS, pose((t, 0, 0)))
    buffer.begin_epoch(150 * MS)
    assert buffer.add(150 * MS, pose((9, 0, 0)))
    assert buffer.find(300 * MS) is None
    assert buffer.find(100 * MS).epoch == 0


def test_before_the_first_pose_after_a_jump_nobody_knows():
    """Even where the old world's poses are all gone, the new one does not reach back."""
    buffer = PoseBuffer(capacity=1)
    buffer.begin_epoch(100 * MS)
    buffer.add(100 * MS, pose())
    assert buffer.find(100 * MS - 1) is None
    assert buffer.find(100 * MS).epoch == 1


@given(st.lists(st.tuples(st.integers(1, 60), st.booleans()), min_size=1, max_size=30))
def test_an_answer_lies_between_poses_of_its_own_world(steps):
    """Worlds a thousand metres apart: no answer is anything but what its own epoch said."""
    buffer, t, told = PoseBuffer(), 0, {}
    for gap, jumps in steps:
        t += gap * MS
        if jumps:
            buffer.begin_epoch(t)
        buffer.add(t, pose((1000 * buffer.epoch, 0, 0)))
        told[t] = buffer.epoch
    for ask in range(0, t + 30 * MS, 7 * MS):
        found = buffer.find(ask)
        if found is not None:
            assert found.pose.translation[0] == pytest.approx(1000 * found.epoch)
            before = [epoch for at, epoch in told.items() if at <= ask]
            assert found.epoch == (before[-1] if before else 0)
