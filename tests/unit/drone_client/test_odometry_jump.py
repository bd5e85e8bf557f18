"""The watch over the odometry: silent in flight, however noisy; awake when the world moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drone_client.odometry.jump import (
    FARTHEST_M,
    JumpReason,
    JumpSettings,
    JumpWatch,
    Motion,
)
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, SECOND, pose, rotation_of

PERIOD_NS = 20 * MS
NOISE_M, NOISE_MPS, NOISE_RAD = 0.005, 0.03, 0.003
"""Of a sample, one standard deviation along each axis; twice what a good VIO has."""


def flight(
    samples: int,
    seed: int,
    period_ns: int = PERIOD_NS,
    noise: tuple[float, float, float] = (NOISE_M, NOISE_MPS, NOISE_RAD),
) -> Iterator[Motion]:
    """A gentle robot in gusts, seen by a noisy VIO with a biased velocity and uneven times.

    Velocities of 0.3 m/s and accelerations of 1 m/s^2 at one sigma, sway of 0.1 rad at 2 Hz.
    """
    rng = np.random.default_rng(seed)
    dt = period_ns / SECOND
    acceleration, velocity, place = np.zeros(3), np.zeros(3), np.array([1.0, 2.0, 1.5])
    bias = rng.normal(scale=0.02, size=3)
    t_ns, sway = 0, rng.uniform(0, 6.28, 3)
    for _ in range(samples):
        step = dt * rng.uniform(0.6, 1.4)
        acceleration = acceleration * np.exp(-step / 0.3) + rng.normal(
            scale=np.sqrt(1 - np.exp(-2 * step / 0.3)), size=3
        )
        before = velocity
        velocity = np.clip(velocity + step * (acceleration - velocity / 0.3), -1.0, 1.0)
        place = place + step * 0.5 * (before + velocity)
        t_ns += round(step * SECOND)
        angles = np.array([0.1, 0.1, 0.2]) * np.sin(
            2 * np.pi * np.array([2.0, 2.0, 0.3]) * t_ns / SECOND + sway
        )
        seen = pose(place + noise[0] * rng.normal(size=3), angles + noise[2] * rng.normal(size=3))
        yield Motion(t_ns, seen, velocity + bias + noise[1] * rng.normal(size=3))


def moved(motion: Motion, by: Pose) -> Motion:
    """The same in a world that has moved."""
    velocity = None if motion.velocity_world is None else by.rotation @ motion.velocity_world
    return motion._replace(world_from_body=by @ motion.world_from_body, velocity_world=velocity)


def reasons(samples: list[Motion], settings: JumpSettings | None = None) -> list[JumpReason]:
    watch = JumpWatch(settings)
    return [jump.reason for m in samples if (jump := watch.see(m)) is not None]


@pytest.mark.parametrize(("seed", "period_ms"), [(1, 10), (2, 20), (3, 33), (4, 100)])
def test_a_noisy_flight_raises_no_alarm(seed, period_ms):
    """Not one in 5000 samples at each rate; docs/odometry.md has a longer run."""
    watch = JumpWatch()
    for motion in flight(5_000, seed, period_ms * MS):
        assert watch.see(motion) is None
    assert not watch.jumps


@pytest.mark.parametrize("period_ms", [10, 20, 33])
@pytest.mark.parametrize(
    ("size", "reason"), [(0.1, JumpReason.POSITION), (0.3, JumpReason.POSITION)]
)
def test_every_jump_of_ten_centimetres_is_seen(period_ms, size, reason):
    """At the very sample, in any direction, all of 50; nothing after it is one."""
    rng = np.random.default_rng(period_ms)
    for trial in range(50):
        samples = list(flight(30, trial, period_ms * MS))
        away = rng.normal(size=3)
        by = pose(size * away / np.linalg.norm(away))
        at = int(rng.integers(2, 28))
        watch = JumpWatch()
        seen = [watch.see(m if i < at else moved(m, by)) for i, m in enumerate(samples)]
        assert [i for i, jump in enumerate(seen) if jump] == [at]
        assert seen[at].reason is reason
        assert seen[at].t_ns == samples[at].t_ns


@pytest.mark.parametrize("size_rad", [0.1, -0.3, 2.0])
def test_every_turn_of_the_world_is_seen(size_rad):
    """About the vertical, where the robot stands: the place alone would not tell."""
    for trial in range(50):
        samples = list(flight(30, trial))
        place = samples[20].world_from_body.translation
        turn = pose((0, 0, 0), (0, 0, size_rad))
        by = Pose(place - turn.rotation @ place, turn.q_wxyz)
        got = reasons([m if i < 20 else moved(m, by) for i, m in enumerate(samples)])
        assert len(got) == 1
        assert got[0] in (JumpReason.ATTITUDE, JumpReason.VELOCITY, JumpReason.POSITION)


def test_a_jump_of_the_velocity_is_seen():
    """A place that goes on and a velocity that cannot be."""
    samples = list(flight(20, 5))
    wrong = [
        m if i < 10 else m._replace(velocity_world=m.velocity_world + (1.0, 0, 0))
        for i, m in enumerate(samples)
    ]
    assert reasons(wrong)[0] is JumpReason.VELOCITY


@pytest.mark.parametrize("over_s", [0.2, 0.5, 1.0])
def test_a_jump_that_was_smoothed_is_seen(over_s):
    """30 cm spread over up to a second: no two samples contradict each other, all together do."""
    for trial in range(20):
        samples = list(flight(200, trial))
        begin_ns = samples[60].t_ns
        watch = JumpWatch()
        found = None
        for m in samples:
            share = np.clip((m.t_ns - begin_ns) / SECOND / over_s, 0, 1)
            found = found or watch.see(moved(m, pose((0, 0.3 * share, 0))))
        assert found is not None
        assert found.t_ns <= begin_ns + over_s * SECOND
        assert found.reason in (JumpReason.SLIDE, JumpReason.POSITION)


def test_drift_is_no_jump():
    """Ten centimetres a second, ten times what odometry is granted, is still drift."""
    samples = flight(3000, 6)
    drifting = [moved(m, pose((0.1 * m.t_ns / SECOND, 0, 0))) for m in samples]
    assert reasons(drifting) == []


def test_the_sources_own_count_is_believed():
    """One reset is one jump, small as it may be; counts that wrap around are a change as well."""
    samples = [m._replace(resets=255 if i < 5 else 0) for i, m in enumerate(flight(10, 7))]
    assert reasons(samples) == [JumpReason.RESET]


def test_a_silence_is_a_jump():
    """Longer than the settings allow, and nobody knows; up to that it is not."""
    m = Motion(SECOND, pose((1, 0, 0)), np.zeros(3))
    gap_ns = JumpSettings().gap_ns
    assert reasons([m, m._replace(t_ns=m.t_ns + gap_ns)]) == []
    assert reasons([m, m._replace(t_ns=m.t_ns + gap_ns + 1)]) == [JumpReason.GAP]


def test_late_samples_are_left_out_and_a_clock_that_goes_back_is_a_jump():
    """A late or a second copy teaches nothing; far back, and the source has begun again."""
    m = Motion(10 * SECOND, pose((1, 0, 0)), np.zeros(3))
    watch = JumpWatch()
    assert watch.see(m) is None
    for late_ms in (0, 1, 100):
        far = m._replace(t_ns=m.t_ns - late_ms * MS, world_from_body=pose((9, 9, 9)))
        assert watch.see(far) is None
    assert watch.left_out == 3
    assert watch.see(m._replace(t_ns=m.t_ns + 20 * MS)) is None
    jump = watch.see(m._replace(t_ns=SECOND))
    assert jump.reason is JumpReason.CLOCK
    assert watch.see(m._replace(t_ns=SECOND + 20 * MS)) is None


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e9])
def test_no_number_is_one_jump_however_often(bad):
    """It has diverged; what comes after is another world, and that is told once."""
    good = list(flight(10, 8))
    wrong = good[4]._replace(velocity_world=np.array([0, bad, 0]))
    watch = JumpWatch()
    seen = [watch.see(m) for m in (*good[:4], wrong, wrong, *good[5:])]
    assert [j.reason for j in seen if j] == [JumpReason.NOT_A_NUMBER]
    assert watch.jumps[JumpReason.NOT_A_NUMBER] == 1
    far = good[0]._replace(world_from_body=pose((2 * FARTHEST_M, 0, 0)))
    assert reasons([good[0], far._replace(t_ns=good[1].t_ns)]) == [JumpReason.NOT_A_NUMBER]


def test_a_source_without_velocity_may_move_as_fast_as_the_robot_can():
    """Then only what no robot can do is a jump."""
    m = Motion(SECOND, pose(), None)
    slow, fast = pose((0.08, 0, 0)), pose((0.3, 0, 0))
    assert reasons([m, Motion(m.t_ns + PERIOD_NS, slow)]) == []
    assert reasons([m, Motion(m.t_ns + PERIOD_NS, fast)]) == [JumpReason.POSITION]


anything = st.floats(allow_nan=True, allow_infinity=True)
motions = st.builds(
    Motion,
    st.integers(-(2**63), 2**63 - 1),
    st.builds(
        lambda t, r: pose(t, r),
        st.tuples(*[st.floats(-1e300, 1e300)] * 3),
        st.tuples(*[st.floats(-3, 3)] * 3),
    ),
    st.none() | st.builds(lambda v: np.array(v), st.tuples(anything, anything, anything)),
    st.integers(-1, 300),
)


@given(st.lists(motions, max_size=8))
def test_nothing_makes_it_raise(samples):
    """Whatever comes: a jump with a sentence, or none; and the first is never one."""
    watch = JumpWatch()
    for i, motion in enumerate(samples):
        jump = watch.see(motion)
        if i == 0:
            assert jump is None
        if jump is not None:
            assert jump.t_ns == motion.t_ns
            assert "jumped" in jump.sentence


@given(st.integers(0, 2**32 - 1), st.tuples(*[st.floats(-100, 100)] * 3), st.floats(-3, 3))
def test_where_the_world_lies_makes_no_difference(seed, shift, yaw):
    """The same flight, told in any other world, is judged the same."""
    samples = list(flight(15, seed))
    by = pose((0.3, 0, 0))
    jumped = [m if i < 9 else moved(m, by) for i, m in enumerate(samples)]
    elsewhere = [moved(m, pose(shift, (0, 0, yaw))) for m in jumped]
    assert reasons(elsewhere) == reasons(jumped) == [JumpReason.POSITION]


@pytest.mark.parametrize("name", list(JumpSettings.__dataclass_fields__))
def test_settings_are_bounded(name):
    """Neither a number out of bounds nor NaN gets in, and the error names the field."""
    for value in (np.nan, -1.0, 1e12):
        with pytest.raises(ValueError, match=name):
            replace(JumpSettings(), **{name: value})


def test_the_generator_is_no_straw_man():
    """The flight of these tests moves, turns and shakes as its text says."""
    samples = list(flight(3000, 9))
    velocities = np.array([m.velocity_world for m in samples])
    assert 0.1 < velocities.std() < 0.6
    turns = Rotation.concatenate([rotation_of(m.world_from_body) for m in samples])
    assert (turns[1:] * turns[:-1].inv()).magnitude().max() > 0.02
