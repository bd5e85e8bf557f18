"""The lidar: what cannot be is not believed, what is slanted is upright, what is old is gone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.odometry import RangeSample
from drone_client.odometry.lidar import Lidar, LidarSettings, RangeVerdict, upright
from tests.unit.drone_client.builders import MS, SECOND, pose, rotation_of

PERIOD_NS = 20 * MS


def feed(lidar: Lidar, distances: list[float], looks_down: bool = True, t0_ns: int = 0) -> int:
    """Samples at 50 Hz; the time of the last one."""
    t_ns = t0_ns
    for i, distance in enumerate(distances):
        t_ns = t0_ns + i * PERIOD_NS
        lidar.see(RangeSample(t_ns, distance, looks_down=looks_down))
    return t_ns


def test_a_steady_distance_is_believed_after_three():
    """One or two say nothing yet: either could be the outlier."""
    lidar = Lidar()
    assert lidar.see(RangeSample(0, 1.5)) is None
    assert lidar.see(RangeSample(PERIOD_NS, 1.5)) is None
    third = RangeSample(2 * PERIOD_NS, 1.51)
    assert lidar.see(third) is third
    assert lidar.newest(2 * PERIOD_NS) is third
    assert lidar.verdicts == {RangeVerdict.UNDECIDED: 2, RangeVerdict.TAKEN: 1}


@pytest.mark.parametrize("spike_m", [0.2, 0.9, 3.0, 11.0])
def test_a_single_echo_is_outvoted(spike_m):
    """Whatever a cable or dust sends back: neither the autopilot nor the mission hears of it."""
    lidar = Lidar()
    t_ns = feed(lidar, [1.5] * 6)
    before = lidar.newest(t_ns)
    assert lidar.see(RangeSample(t_ns + PERIOD_NS, spike_m)) is None
    assert lidar.newest(t_ns + PERIOD_NS) is before
    assert lidar.verdicts[RangeVerdict.OUTLIER] == 1
    assert lidar.see(RangeSample(t_ns + 2 * PERIOD_NS, 1.5)) is not None


def test_another_surface_is_believed_once_it_is_the_majority():
    """Over a step in the ground: two samples are held back, the third is not."""
    lidar = Lidar()
    t_ns = feed(lidar, [1.5] * 6)
    taken = [lidar.see(RangeSample(t_ns + i * PERIOD_NS, 0.6)) for i in range(1, 5)]
    assert [t is not None for t in taken] == [False, False, True, True]


def test_a_fast_climb_is_no_outlier():
    """One metre a second with 2 cm of noise: every sample is taken."""
    lidar = Lidar()
    rng = np.random.default_rng(3)
    feed(lidar, list(0.5 + 1.0 * np.arange(300) * 0.02 + 0.02 * rng.normal(size=300)))
    assert lidar.verdicts[RangeVerdict.OUTLIER] == 0


def test_an_old_distance_says_nothing():
    """Nor one from the future."""
    lidar = Lidar()
    t_ns = feed(lidar, [2.0] * 5, looks_down=False)
    stale_ns = LidarSettings().stale_ns
    assert lidar.forward_m(t_ns + stale_ns) == 2.0
    assert lidar.forward_m(t_ns + stale_ns + 1) is None
    assert lidar.forward_m(t_ns - 1) is None


@pytest.mark.parametrize("distance_m", [0.05, 12.5, math.inf, -math.inf, math.nan, -1.0])
def test_what_it_cannot_measure_is_nothing_at_once(distance_m):
    """A beam into the open does not leave the last wall standing there."""
    lidar = Lidar()
    t_ns = feed(lidar, [2.0] * 5, looks_down=False) + PERIOD_NS
    sample = RangeSample(t_ns, distance_m, looks_down=False)
    assert lidar.see(sample) is sample  # the autopilot is told that it sees nothing
    assert lidar.forward_m(t_ns) is None
    assert lidar.verdicts[RangeVerdict.OUT_OF_RANGE] == 1


@pytest.mark.parametrize(("min_m", "max_m"), [(-1, 5), (5, 1), (0.1, math.inf), (math.nan, 9)])
def test_a_sensor_that_misstates_itself_is_not_believed(min_m, max_m):
    """Its bounds are what tells a distance from nonsense."""
    lidar = Lidar()
    for i in range(5):
        lidar.see(RangeSample(i * PERIOD_NS, 2.0, min_m, max_m))
    assert lidar.newest(4 * PERIOD_NS) is None


def test_late_and_repeated_samples_have_no_vote():
    """And a clock that went back far begins anew."""
    lidar = Lidar()
    t_ns = feed(lidar, [2.0] * 5, t0_ns=SECOND)
    assert lidar.see(RangeSample(t_ns, 2.0)) is None
    assert lidar.see(RangeSample(t_ns - 40 * MS, 2.0)) is None
    assert lidar.verdicts[RangeVerdict.LATE] == 2
    assert lidar.see(RangeSample(5 * MS, 7.0)) is None
    assert lidar.newest(5 * MS) is None
    assert lidar.verdicts[RangeVerdict.UNDECIDED] == 3


@given(
    st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-3, 3), st.floats(0.3, 3), st.booleans()
)
def test_a_slanted_beam_is_set_upright(roll, pitch, yaw, height, down):
    """By SciPy: the beam meets level ground, or an upright wall ahead, at its length."""
    body = pose((0, 0, height), (0, 0, yaw))
    body = body @ pose((0, 0, 0), (roll, pitch, 0))
    axis = rotation_of(body).apply([0, 0, -1] if down else [1, 0, 0])
    share = -axis[2] if down else math.hypot(axis[0], axis[1])
    if share < math.cos(LidarSettings().tilt_max_rad) + 1e-6:
        return
    lidar = Lidar()
    t_ns = feed(lidar, [height / share] * 5, looks_down=down)
    assert lidar.upright_m(t_ns, body) == pytest.approx(height, rel=1e-9)


def test_too_slanted_is_nothing():
    """A height by a beam that looks at the wall is none, and none without an attitude."""
    lidar = Lidar()
    t_ns = feed(lidar, [2.0] * 5)
    assert lidar.upright_m(t_ns, pose((0, 0, 0), (0.34, 0, 0))) is not None
    assert lidar.upright_m(t_ns, pose((0, 0, 0), (0.36, 0, 0))) is None
    assert lidar.upright_m(t_ns, pose((0, 0, 0), (math.pi, 0, 0))) is None
    assert lidar.upright_m(t_ns, None) is None
    assert upright(pose(), looks_down=True) == 1.0


def test_only_a_forward_beam_is_a_distance_to_the_wall():
    """The mission must not take the ground for the board."""
    lidar = Lidar()
    t_ns = feed(lidar, [0.5] * 5)
    assert lidar.newest(t_ns) is not None
    assert lidar.forward_m(t_ns) is None


anything = st.floats(allow_nan=True, allow_infinity=True)


@given(
    st.lists(
        st.builds(
            RangeSample, st.integers(-(2**63), 2**63), anything, anything, anything, st.booleans()
        ),
        max_size=12,
    )
)
def test_nothing_makes_it_raise(samples):
    """And what it believes is always a distance that the sensor can measure."""
    lidar = Lidar()
    for sample in samples:
        lidar.see(sample)
        newest = lidar.newest(sample.t_ns)
        if newest is not None:
            assert newest.min_m <= newest.distance_m <= newest.max_m < math.inf
    assert lidar.verdicts.total() == len(samples)


@pytest.mark.parametrize("name", list(LidarSettings.__dataclass_fields__))
def test_settings_are_bounded(name):
    """And the error names the field."""
    for value in (math.nan, -1, 10**12):
        with pytest.raises(ValueError, match=name):
            replace(LidarSettings(), **{name: value})
    with pytest.raises(ValueError, match="odd"):
        LidarSettings(window=4)
