"""The estimator: carries on, corrects, refuses, starts again."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_sim.sensing.imu import ImuSample
from contact_sim.vehicle.estimator import Estimator, EstimatorSettings
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, SECOND, pose

DT_S = 0.004
STEP_NS = 4 * MS
STILL = ImuSample((0.0, 0.0, 9.81 * DT_S), (0.0, 0.0, 0.0), DT_S)


def still(settings: EstimatorSettings | None = None, **biases) -> Estimator:
    return Estimator(settings or EstimatorSettings(), 0, pose((1.0, 2.0, 3.0)), **biases)


def seen(t_ns: int, place=(1.0, 2.0, 3.0), turn=(0.0, 0.0, 0.0), **more) -> OdometrySample:
    return OdometrySample(t_ns, pose(place, turn), more.pop("velocity", np.zeros(3)), **more)


def hover(e: Estimator, seconds: float, place=(1.0, 2.0, 3.0), imu: ImuSample = STILL, **more):
    """At rest, with a pose of the VIO after every step."""
    for _ in range(round(seconds / DT_S)):
        e.propagate(e.t_ns + STEP_NS, imu)
        e.feed(seen(e.t_ns, place, **more))


def alone(e: Estimator, seconds: float, imu: ImuSample = STILL) -> None:
    for _ in range(round(seconds / DT_S)):
        e.propagate(e.t_ns + STEP_NS, imu)


def test_a_right_imu_alone_carries_it_round_a_circle():
    """Flown round a level circle while it turns, it comes back to where it was."""
    e = Estimator(EstimatorSettings(), 0, pose((2.0, 0.0, 1.0)))
    e.velocity = (0.0, 2.0, 0.0)  # of a circle of 2 m, at 1 rad/s
    n = round(2.0 * math.pi / DT_S)
    dt_s = 2.0 * math.pi / n
    # in axes that turn with it, the force points inwards all the time
    imu = ImuSample((-2.0 * dt_s, 0.0, 9.81 * dt_s), (0.0, 0.0, dt_s), dt_s)
    for k in range(n):
        e.propagate(round((k + 1) * dt_s * 1e9), imu)
        if k == n // 4:
            assert e.position == pytest.approx((0.0, 2.0, 1.0), abs=0.02)
    assert e.position == pytest.approx((2.0, 0.0, 1.0), abs=1e-3)
    assert e.velocity == pytest.approx((0.0, 2.0, 0.0), abs=1e-3)
    assert np.abs(e.q) == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-6)


def test_biases_of_the_imu_are_learned():
    """After a minute at rest most of what is wrong with the IMU is known, and nothing moves."""
    e = still(EstimatorSettings(ekf2_acc_b_noise=0.1))
    wrong = ImuSample((0.02 * DT_S, 0.0, (9.81 - 0.03) * DT_S), (0.0, 0.0, 0.002 * DT_S), DT_S)
    hover(e, 60.0, imu=wrong)
    assert e.position == pytest.approx((1.0, 2.0, 3.0), abs=1e-3)
    assert e.velocity == pytest.approx((0.0, 0.0, 0.0), abs=2e-3)
    assert e.rates == pytest.approx((0.0, 0.0, 0.0), abs=4e-4)


@pytest.mark.parametrize("late_ns", [0, 30 * MS, 62 * MS])
def test_late_samples_correct_as_well_as_fresh_ones(late_ns):
    """Flying at 1 m/s, a sample is held against what was believed at its time, not against now."""
    e = still()
    e.velocity = (1.0, 0.0, 0.0)
    for k in range(1, 1000):
        e.propagate(k * STEP_NS, STILL)
        then_ns = k * STEP_NS - late_ns
        if then_ns > 0:
            e.feed(seen(then_ns, (1.0 + then_ns / SECOND, 2.0, 3.0)))
    assert e.position == pytest.approx((1.0 + e.t_ns / SECOND, 2.0, 3.0), abs=1e-6)
    assert e.velocity == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert e.resets == e.refused == 0


@pytest.mark.parametrize(("late_ns", "over_m"), [(0, 0.008), (60 * MS, 0.015)])
def test_a_late_error_is_corrected_once_and_not_over_and_over(late_ns, over_m):
    """A place that is off by 5 cm is approached as calmly when it is told 60 ms late, or nearly."""
    e = still()
    path = []
    for k in range(1, 1500):
        e.propagate(k * STEP_NS, STILL)
        then_ns = k * STEP_NS - late_ns
        if then_ns > 0:
            e.feed(seen(then_ns, (1.05, 2.0, 3.0)))
        path.append(e.position[0])
    assert path[-1] == pytest.approx(1.05, abs=2e-3)
    assert max(path) < 1.05 + over_m


def test_an_unsure_estimate_is_corrected_once_by_samples_that_are_late():
    """After a silence each sample weighs much; 60 ms late, they do not all correct the same error.

    Place and heading are off by 6 cm and 0.1 rad: what is beyond them stays below a quarter.
    """
    e = still()
    hover(e, 1.0)
    alone(e, 0.9)
    for k in range(250):
        e.propagate(e.t_ns + STEP_NS, STILL)
        e.feed(seen(e.t_ns - 60 * MS, (1.06, 2.0, 3.0), (0.0, 0.0, 0.1)))
        assert e.position[0] < 1.06 + 0.015
        assert 2.0 * math.asin(e.q[3]) < 0.1 + 0.025
        if k == 25:
            assert e.position[0] > 1.03
    assert e.resets == 0


def test_a_quick_heading_is_corrected_once_too():
    """With a gyro that is trusted little, a heading that is told 60 ms late is no swing."""
    settings = EstimatorSettings(
        ekf2_gyr_noise=0.1, ekf2_gyr_b_noise=0.0, ekf2_eva_noise_rad=0.01, ekf2_hdg_gate=20.0
    )
    e = still(settings)
    headings = []
    for _ in range(250):
        e.propagate(e.t_ns + STEP_NS, STILL)
        e.feed(seen(max(0, e.t_ns - 60 * MS), turn=(0.0, 0.0, 0.1)))
        headings.append(2.0 * math.asin(e.q[3]))
    assert headings[-1] == pytest.approx(0.1, abs=1e-3)
    assert max(headings) < 0.102


def test_a_jump_is_refused_for_a_second_and_then_believed():
    """30 cm in the VIO move the estimate only after a second, all at once, and it is counted."""
    e = still()
    hover(e, 2.0)
    hover(e, 0.9, (1.3, 2.0, 3.0))
    assert e.estimate().world_from_body.translation == pytest.approx([1.0, 2.0, 3.0], abs=2e-3)
    assert e.resets == 0
    hover(e, 0.2, (1.3, 2.0, 3.0))
    assert e.estimate().world_from_body.translation == pytest.approx([1.3, 2.0, 3.0], abs=2e-3)
    assert e.estimate().resets == 1
    hover(e, 3.0, (1.3, 2.0, 3.0))
    assert e.estimate().resets == 1


def test_a_turn_of_the_vio_is_refused_too():
    """Half a radian of heading at once does not fit; after a second it is believed."""
    e = still()
    hover(e, 1.0)
    hover(e, 0.9, turn=(0.0, 0.0, 0.5))
    assert e.resets == 0
    hover(e, 0.2, turn=(0.0, 0.0, 0.5))
    assert e.resets == 1
    w, x, y, z = e.q
    assert Rotation.from_quat([x, y, z, w]).as_rotvec() == pytest.approx([0, 0, 0.5], abs=0.01)


def test_a_reset_that_the_source_counts_is_believed_at_once():
    """Who says itself that it has jumped need not wait for a second."""
    e = still()
    hover(e, 1.0)
    e.feed(replace(seen(e.t_ns, (1.3, 2.0, 3.0)), resets=1))
    assert e.position == pytest.approx((1.3, 2.0, 3.0))
    assert e.resets == 1


def test_without_samples_it_goes_on_and_knows_less_and_less():
    """For five seconds the place is valid, ever less sure; what comes then is a new start."""
    e = still()
    hover(e, 1.0)
    sure_m = e.estimate().sigma_m
    alone(e, 4.9)
    assert e.estimate().valid
    assert e.estimate().sigma_m > 5.0 * sure_m
    assert e.estimate().world_from_body.translation == pytest.approx([1.0, 2.0, 3.0], abs=0.02)
    alone(e, 0.2)
    assert not e.estimate().valid
    hover(e, 0.02, (1.1, 2.0, 3.0))
    assert e.estimate().valid
    assert e.estimate().resets == 1


def test_what_is_no_sample_changes_nothing():
    """A velocity that is no number, or a pose older than what is kept, is refused and counted."""
    e = still()
    hover(e, 1.0)
    before = e.position
    e.feed(seen(e.t_ns, velocity=np.array([0.0, math.nan, 0.0])))
    e.feed(seen(e.t_ns - SECOND, (5.0, 5.0, 5.0)))
    assert e.position == before
    assert e.refused == 2


def test_height_comes_from_the_lidar_where_it_is_told_so():
    """A VIO whose height drifts away does not lift the estimate, and the lidar's is followed."""
    e = still(EstimatorSettings(height_by_lidar=True))
    for k in range(1, 1001):
        e.propagate(k * STEP_NS, STILL)
        e.feed(seen(e.t_ns, (1.0, 2.0, 3.0 + 1e-3 * k)))
        e.feed_range(RangeSample(e.t_ns, 2.5))
        e.feed_range(RangeSample(e.t_ns, 0.0))  # it sees nothing
        e.feed_range(RangeSample(e.t_ns, 2.0, looks_down=False))
    assert e.position == pytest.approx((1.0, 2.0, 3.0), abs=1e-3)
    assert e.resets == e.refused == 0


def test_ranges_are_not_used_otherwise():
    """By default the height is the VIO's."""
    e = still()
    hover(e, 0.5)
    before = e.position
    e.feed_range(RangeSample(e.t_ns, 0.5))
    assert e.position == before


def test_bad_settings_are_refused():
    """The field at fault is named."""
    with pytest.raises(ValueError, match="ekf2_evp_noise_m"):
        EstimatorSettings(ekf2_evp_noise_m=0.0)


def test_the_estimate_is_a_pose():
    """What is told to others is of their types, with its own numbers."""
    e = still()
    estimate = e.estimate()
    assert isinstance(estimate.world_from_body, Pose)
    assert estimate.world_from_body.translation.tolist() == [1.0, 2.0, 3.0]
    assert estimate.t_ns == 0
