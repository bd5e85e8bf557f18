"""The tracking camera: right but for its drift, its noise, its latency and its faults."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.errors import VehicleError
from contact_sim.sensing.vio import Moving, Vio, VioSettings
from drone_client.odometry import OdometrySample
from rgbd_wire.quaternion import about_up
from tests.unit.drone_client.builders import MS, SECOND, rotation_of

PERIOD_NS = 5 * MS
START = Moving(0, (1.0, 2.0, 3.0), about_up(0.5), (0.0, 0.0, 0.0))
RIGHT = VioSettings(
    latency_ns=0,
    scale=0.0,
    walk_per_root_m=0.0,
    walk_per_root_s=0.0,
    yaw_walk=0.0,
    yaw_drift_radps=0.0,
    position_noise_m=0.0,
    velocity_noise_mps=0.0,
    attitude_noise_rad=0.0,
)


def at(t_ns: int, speed_mps: float = 1.0) -> Moving:
    """Flying east from the start."""
    way_m = speed_mps * t_ns / SECOND
    return Moving(t_ns, (1.0 + way_m, 2.0, 3.0), about_up(0.5), (speed_mps, 0.0, 0.0))


def flown(vio: Vio, seconds: float, speed_mps: float = 1.0) -> list[OdometrySample]:
    samples = []
    for t_ns in range(PERIOD_NS, round(seconds * SECOND) + 1, PERIOD_NS):
        vio.measure(at(t_ns, speed_mps))
        while (says := vio.due(t_ns)) is not None:
            samples.append(says.sample)
    return samples


def test_a_right_one_says_what_is():
    """Without errors it gives the true pose and velocity, with the stamp of the moment."""
    samples = flown(Vio(RIGHT, stream(0, "vio"), START), 1.0)
    assert len(samples) == 200
    last = samples[-1]
    assert last.t_ns == SECOND
    assert last.world_from_body.translation == pytest.approx([2.0, 2.0, 3.0])
    assert rotation_of(last.world_from_body).as_rotvec() == pytest.approx([0.0, 0.0, 0.5])
    assert last.velocity_world == pytest.approx([1.0, 0.0, 0.0])
    assert last.resets == 0


def test_it_drifts_by_about_a_half_to_one_percent_of_the_way():
    """Over twenty metres, in many flights: the middle one and the worst of ten."""
    errors = []
    for seed in range(60):
        last = flown(Vio(VioSettings(), stream(seed, "vio"), START), 20.0)[-1]
        true = at(last.t_ns)
        errors.append(math.dist(last.world_from_body.translation, true.position_world) / 20.0)
    assert 0.002 < np.median(errors) < 0.01
    assert 0.005 < np.quantile(errors, 0.9) < 0.02


def test_its_heading_walks():
    """A minute turns its world by about half a degree, and the velocity with it."""
    turned = []
    for seed in range(40):
        vio = Vio(VioSettings(period_ns=100 * MS), stream(seed, "vio"), START)
        for t_ns in range(100 * MS, 60 * SECOND + 1, 100 * MS):
            vio.measure(at(t_ns, 0.0))
        turned.append(vio.yaw_error_rad)
    expected = math.hypot(0.0005 * math.sqrt(60.0), 0.0002 * 60.0)
    assert np.std(turned) == pytest.approx(expected, rel=0.3)


def test_in_a_turned_world_the_velocity_is_turned_too():
    """With a heading that runs away, place and velocity go the same way, not the true one."""
    vio = Vio(replace(RIGHT, yaw_drift_radps=0.05), stream(1, "vio"), START)
    a, b = flown(vio, 20.0)[-2:]
    moved = (b.world_from_body.translation - a.world_from_body.translation) * SECOND / PERIOD_NS
    assert abs(vio.yaw_error_rad) > 0.2
    assert b.velocity_world == pytest.approx(moved, abs=0.002)
    assert b.velocity_world[1] == pytest.approx(math.sin(vio.yaw_error_rad), abs=0.002)
    heading = rotation_of(b.world_from_body).as_rotvec()[2]
    assert heading == pytest.approx(0.5 + vio.yaw_error_rad, abs=1e-6)


def test_what_it_says_fits_what_it_said_before():
    """Between two samples the place moves as the velocities say: no jump for a watch to see."""
    samples = flown(Vio(VioSettings(), stream(5, "vio"), START), 5.0)
    for a, b in zip(samples, samples[1:], strict=False):
        moved = b.world_from_body.translation - a.world_from_body.translation
        assert np.linalg.norm(moved - a.velocity_world * (b.t_ns - a.t_ns) / SECOND) < 0.006


def test_noise_is_that_of_the_settings():
    """Held still and without drift: spread of place, velocity and attitude."""
    settings = VioSettings(
        latency_ns=0,
        walk_per_root_m=0.0,
        walk_per_root_s=0.0,
        yaw_walk=0.0,
        yaw_drift_radps=0.0,
    )
    samples = flown(Vio(settings, stream(2, "vio"), START), 20.0, 0.0)
    places = np.array([s.world_from_body.translation for s in samples])
    velocities = np.array([s.velocity_world for s in samples])
    true = rotation_of(samples[0].world_from_body).from_rotvec([0.0, 0.0, 0.5])
    turns = np.array([(rotation_of(s.world_from_body) * true.inv()).as_rotvec() for s in samples])
    assert places.std(axis=0) == pytest.approx([settings.position_noise_m] * 3, rel=0.06)
    assert velocities.std(axis=0) == pytest.approx([settings.velocity_noise_mps] * 3, rel=0.06)
    assert turns.std(axis=0) == pytest.approx([settings.attitude_noise_rad] * 3, rel=0.06)


def test_a_sample_comes_out_after_its_latency():
    """With the stamp of when it was measured."""
    vio = Vio(VioSettings(latency_ns=6 * MS), stream(0, "vio"), START)
    vio.measure(at(10 * MS))
    assert vio.due(15 * MS) is None
    says = vio.due(16 * MS)
    assert says is not None
    assert says.t_ns == 10 * MS
    assert vio.due(16 * MS) is None


def test_a_jump_moves_every_place_after_it_and_is_not_counted():
    """The place leaps, the velocity does not, and the source claims no reset."""
    vio = Vio(RIGHT, stream(0, "vio"), START)
    flown(vio, 1.0)
    vio.jump((0.3, -0.1, 0.0))
    vio.measure(at(SECOND + PERIOD_NS))
    says = vio.due(SECOND + PERIOD_NS)
    assert says is not None
    sample = says.sample
    assert sample.world_from_body.translation == pytest.approx([2.305, 1.9, 3.0])
    assert sample.velocity_world == pytest.approx([1.0, 0.0, 0.0])
    assert sample.resets == 0


def test_it_falls_silent_and_comes_back():
    """Nothing comes while it is out; afterwards it knows what way was flown."""
    vio = Vio(RIGHT, stream(0, "vio"), START)
    vio.out(True)
    assert flown(vio, 1.0) == []
    vio.out(False)
    vio.measure(at(2 * SECOND))
    says = vio.due(2 * SECOND)
    assert says is not None
    sample = says.sample
    assert sample.world_from_body.translation == pytest.approx([3.0, 2.0, 3.0])


@pytest.mark.parametrize("by", [(1.0, 2.0), (math.nan, 0.0, 0.0), (1e6, 0.0, 0.0)])
def test_no_jump_at_all_is_refused(by):
    """What was wrong with it is said."""
    with pytest.raises(VehicleError, match="three numbers"):
        Vio(RIGHT, stream(0, "vio"), START).jump(by)


def test_bad_settings_are_refused():
    """The field at fault is named."""
    with pytest.raises(ValueError, match="scale"):
        VioSettings(scale=1.0)
