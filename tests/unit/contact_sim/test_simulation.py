"""The whole drone in the air and on the board: as PX4 flies, steady, and the same every time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from contact_sim.errors import VehicleError, WorldError
from contact_sim.scene.drone import ARM, MASS_KG
from contact_sim.sensing.vio import VioSettings
from contact_sim.simulation import Simulation, SimulationSettings, Truth
from contact_sim.vehicle.estimator import EstimatorSettings
from contact_sim.vehicle.wind import WindSettings
from drone_client.mission import Phase
from tests.unit.contact_sim.flights import (
    BOARD,
    BOARD_X_M,
    HEIGHT_M,
    PERFECT,
    REACH_M,
    SECOND_STEPS,
    Pilot,
    simulation,
)

DT_S = 0.02
"""Between two looks."""
LOOK_STEPS = 10


def watched(sim: Simulation, seconds: float) -> list[Truth]:
    """How it flies, looked at 50 times a second."""
    truths = []
    for _ in range(round(seconds / DT_S)):
        sim.step(LOOK_STEPS)
        truths.append(sim.truth)
    return truths


def tilt_rad(truth: Truth) -> float:
    return math.acos(min(1.0, truth.world_from_body.rotation[2, 2]))


def test_time_is_what_is_stepped():
    """Two milliseconds a step, from zero."""
    sim = simulation()
    assert sim.t_ns == 0
    sim.step(3)
    assert sim.t_ns == sim.truth.t_ns == sim.snapshot().t_ns == 6_000_000


def test_a_perfect_hover_stands_still():
    """With sensors that are right, ten seconds move it by less than a tenth of a millimetre."""
    sim = simulation(settings=PERFECT)
    places = [t.world_from_body.translation for t in watched(sim, 10.0)]
    assert np.abs(np.array(places) - [0.0, 0.0, HEIGHT_M]).max() < 1e-4


@pytest.mark.parametrize("seed", range(6))
def test_a_hover_holds_within_a_centimetre(seed):
    """In still air and with real sensors: one centimetre in three seconds, three in ten.

    Nothing holds its place but the velocity that it believes, as in PX4's offboard mode.
    """
    sim = simulation(seed)
    places = np.array([t.world_from_body.translation for t in watched(sim, 10.0)])
    off_m = np.linalg.norm(places - [0.0, 0.0, HEIGHT_M], axis=1)
    assert off_m[:150].max() < 0.01
    assert off_m.max() < 0.03


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("speed_mps", [-0.4, 0.05, 0.4])
def test_a_velocity_is_followed_as_px4_follows_it(axis, speed_mps):
    """It is there to 63 % after 0.2 to 0.45 s, overshoots little, and stays on its way."""
    sim = simulation(settings=PERFECT)
    sim.step(SECOND_STEPS)
    wanted = np.zeros(3)
    wanted[axis] = speed_mps
    sim.set_velocity(wanted, 0.0)
    truths = watched(sim, 3.0)
    share = np.array([t.velocity_world[axis] for t in truths]) / speed_mps
    assert 0.2 < DT_S * (1 + np.argmax(share > 1.0 - math.exp(-1.0))) < 0.45
    assert share.max() < 1.15
    assert np.abs(share[-25:] - 1.0).max() < 0.05
    others = np.array([np.delete(t.velocity_world, axis) for t in truths])
    assert np.abs(others).max() < 0.1 * abs(speed_mps)


def test_a_yaw_rate_is_followed_on_the_spot():
    """0.4 rad/s are there within half a second, and the drone does not leave its place."""
    sim = simulation(settings=PERFECT)
    sim.set_velocity((0.0, 0.0, 0.0), 0.4)
    truths = watched(sim, 3.0)
    rates = np.array([t.rates_body[2] for t in truths])
    assert np.abs(rates[25:] - 0.4).max() < 0.05
    place = truths[-1].world_from_body.translation
    assert place == pytest.approx([0.0, 0.0, HEIGHT_M], abs=0.02)


def test_it_flies_where_the_world_says_at_any_heading():
    """A velocity is of the world, not of the body."""
    sim = simulation(settings=PERFECT, turned_rad=2.0)
    sim.set_velocity((0.0, 0.3, 0.0), 0.0)
    assert watched(sim, 3.0)[-1].velocity_world == pytest.approx([0.0, 0.3, 0.0], abs=0.01)


def test_px4_s_limits_are_kept():
    """Told to fly like mad, it leans no further, climbs and sinks no faster than PX4 lets it."""
    loop = SimulationSettings().loop
    for wanted in ((0.0, 60.0, 60.0), (-60.0, 0.0, -60.0)):
        sim = simulation(settings=PERFECT, start=(0.0, 0.0, 15.0))
        sim.set_velocity(wanted, 50.0)
        truths = watched(sim, 5.0)
        most_rad = math.atan(loop.mpc_acc_hor_max_mps2 / (9.81 - loop.mpc_acc_down_max_mps2))
        assert max(tilt_rad(t) for t in truths) < 1.15 * most_rad < loop.mpc_tiltmax_air_rad
        climbing = np.array([t.velocity_world[2] for t in truths])
        assert climbing.max() < 1.15 * loop.mpc_z_vel_max_up_mps
        assert climbing.min() > -1.15 * loop.mpc_z_vel_max_dn_mps
        assert max(np.hypot(*t.velocity_world[:2]) for t in truths) < loop.mpc_xy_vel_max_mps
        turning = [abs(t.rates_body[2]) for t in truths]
        assert max(turning) < 1.2 * loop.mpc_yawrauto_max_radps


def test_wind_leans_it_and_does_not_carry_it_away():
    """In 5 m/s with gusts it leans by about six degrees, and wanders by less than half a metre."""
    sim = simulation(1, SimulationSettings(wind=WindSettings(mean_world=(0.0, 5.0, 0.0))))
    truths = watched(sim, 20.0)
    tilts = np.degrees([tilt_rad(t) for t in truths[100:]])
    assert 3.5 < tilts.mean() < 8.0
    places = np.array([t.world_from_body.translation for t in truths])
    assert np.linalg.norm(places - places[0], axis=1).max() < 0.5


def test_a_gust_is_felt_and_survived():
    """A gust of 6 m/s for two seconds pushes it along, and afterwards it stands again."""
    sim = simulation(0)
    sim.step(SECOND_STEPS)
    sim.wind.gust((0.0, 6.0, 0.0), 2.0)
    truths = watched(sim, 6.0)
    assert max(t.velocity_world[1] for t in truths) > 0.1
    assert max(t.wind_world[1] for t in truths) == pytest.approx(6.0, abs=0.01)
    assert np.abs(truths[-1].velocity_world).max() < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_it_pushes_on_the_board_steadily(seed):
    """Told to go on at 5 cm/s it stays on the board, upright, and pushes as its spring says."""
    sim = simulation(seed, start=(BOARD_X_M - REACH_M - 0.04, 0.0, HEIGHT_M))
    sim.set_velocity((0.05, 0.0, 0.0), 0.0)
    truths = watched(sim, 10.0)
    hit = next(i for i, t in enumerate(truths) if t.tip_force_n > 0.0)
    after = truths[hit:]
    off_m = [BOARD_X_M - t.tip_world[0] for t in after]
    assert max(off_m) < 0.005
    assert max(tilt_rad(t) for t in truths) < math.radians(5.0)
    steady = after[-150:]
    assert all(t.tip_force_n > 0.2 for t in steady)
    for t in steady:
        pressed_n = ARM.stiffness_npm * t.arm_m
        assert t.tip_force_n == pytest.approx(pressed_n, abs=0.25)
        # the drone leans into the wall by as much as it pushes
        leaning_n = MASS_KG * 9.81 * math.tan(math.asin(-t.world_from_body.rotation[2, 0]))
        assert t.tip_force_n == pytest.approx(leaning_n, abs=0.35)
    assert {touch.part for touch in steady[-1].touches} == {"drone/tip"}
    assert sim.truth.worst_impact_mps == pytest.approx(0.05, abs=0.015)


def test_it_comes_off_the_board_when_it_is_told_to():
    """Sent back at 15 cm/s after a push, it is free within a second and turns to nothing else."""
    sim = simulation(2, start=(BOARD_X_M - REACH_M - 0.01, 0.0, HEIGHT_M))
    sim.set_velocity((0.05, 0.0, 0.0), 0.0)
    sim.step(5 * SECOND_STEPS)
    sim.set_velocity((-0.15, 0.0, 0.0), 0.0)
    last = watched(sim, 1.0)[-1]
    assert last.tip_force_n == 0.0
    assert last.tip_world[0] < BOARD_X_M - 0.02
    assert last.arm_m == pytest.approx(0.0, abs=5e-4)


def test_the_same_seed_and_commands_are_the_same_flight_bit_for_bit():
    """Also when the steps are taken in other portions; another seed is another flight."""
    settings = SimulationSettings(wind=WindSettings(mean_world=(0.0, 2.0, 0.0)))

    def flown(seed: int, portion: int) -> tuple[bytes, ...]:
        sim = simulation(seed, settings, start=(BOARD_X_M - REACH_M - 0.02, 0.0, HEIGHT_M))
        kept = []
        for k in range(12):
            sim.set_velocity((0.05, 0.01 * k, 0.0), 0.02 * k)
            for _ in range(120 // portion):
                sim.step(portion)
            assert sim.vio is not None
            assert sim.height is not None
            kept.append(sim.snapshot().qpos.tobytes())
            kept.append(sim.vio.world_from_body.translation.tobytes())
            kept.append(np.array(sim.height.distance_m).tobytes())
            kept.append(sim.estimate.velocity_world.tobytes())
        assert sim.contacts.impacts
        return tuple(kept)

    first = flown(3, 120)
    assert flown(3, 120) == first
    assert flown(3, 1) == first
    assert flown(4, 120) != first


def test_the_scene_is_not_changed():
    """A scene can be flown in again: the drone is put into a copy."""
    sim = simulation()
    Simulation(sim.scene, sim.airframe, sim.rig, 1)
    assert sim.scene.spec.compile().nbody == 1


def test_a_snapshot_is_a_copy():
    """What was taken does not move with the drone, and knows which lamps are out."""
    sim = simulation()
    before = sim.snapshot()
    kept = before.qpos.copy()
    sim.set_velocity((1.0, 0.0, 0.0), 0.0)
    sim.lamp_out("lamp")
    sim.step(SECOND_STEPS)
    assert (before.qpos == kept).all()
    assert before.lamps_out == frozenset()
    assert sim.snapshot().lamps_out == {"lamp"}
    assert not (sim.snapshot().qpos == kept).all()


def test_sensors_come_at_their_rates_with_simulated_stamps():
    """In a second 200 poses of the VIO and 100 distances, each stamped with when it was."""
    sim = simulation(1)
    poses, heights = set(), set()
    for _ in range(SECOND_STEPS):
        sim.step()
        if sim.vio is not None:
            poses.add(sim.vio.t_ns)
            assert 0 <= sim.t_ns - sim.vio.t_ns <= 14_000_000
        assert sim.height is not None
        assert sim.ahead is not None
        heights.add(sim.height.t_ns)
        assert 0 <= sim.t_ns - sim.height.t_ns < 10_000_000
    assert len(poses) == pytest.approx(200, abs=2)
    assert len(heights) == pytest.approx(100, abs=1)
    assert sim.height.distance_m == pytest.approx(HEIGHT_M - 0.04, abs=0.05)
    assert sim.ahead.distance_m == pytest.approx(BOARD_X_M - 0.1, abs=0.05)


def test_the_estimate_follows_the_odometry_and_not_the_truth():
    """In a world that drifts by a tenth, the vehicle is told a place that is off by a tenth."""
    vio = VioSettings(scale=0.1)
    sim = simulation(0, replace(PERFECT, vio=vio), start=(0.0, 0.0, HEIGHT_M), turned_rad=3.1)
    sim.set_velocity((-1.0, 0.0, 0.0), 0.0)
    sim.step(10 * SECOND_STEPS)
    assert sim.vio is not None
    way_m = -sim.truth.world_from_body.translation[0]
    told_m = -sim.estimate.world_from_body.translation[0]
    assert abs(told_m - way_m) > 0.08 * way_m
    assert told_m == pytest.approx(-sim.vio.world_from_body.translation[0], abs=0.05)


def test_a_jump_of_the_vio_comes_through_as_a_reset():
    """Refused at first; after a second the estimate leaps and counts it, and the drone stands."""
    sim = simulation(1)
    sim.step(SECOND_STEPS)
    sim.vio_camera.jump((0.5, 0.0, 0.0))
    sim.step(SECOND_STEPS // 2)
    assert sim.estimate.resets == 0
    assert sim.estimate.world_from_body.translation[0] == pytest.approx(0.0, abs=0.02)
    sim.step(SECOND_STEPS)
    assert sim.estimate.resets == 1
    assert sim.estimate.world_from_body.translation[0] == pytest.approx(0.5, abs=0.02)
    assert np.abs(sim.truth.world_from_body.translation - [0, 0, HEIGHT_M]).max() < 0.05


def test_without_vio_it_hovers_on_and_says_when_it_is_lost():
    """Three seconds of silence move it by less than a tenth of a metre; after five it is lost."""
    sim = simulation(1)
    sim.step(SECOND_STEPS)
    sim.vio_camera.out(True)
    sim.step(3 * SECOND_STEPS)
    assert sim.estimate.valid
    assert np.abs(sim.truth.world_from_body.translation - [0, 0, HEIGHT_M]).max() < 0.1
    sim.step(3 * SECOND_STEPS)
    assert not sim.estimate.valid


def test_the_client_may_feed_the_estimator_itself():
    """Then only what is given counts: 50 samples a second, 40 ms late, are enough to hover by."""
    settings = SimulationSettings(
        feeds_itself=False, estimator=EstimatorSettings(height_by_lidar=True)
    )
    sim = simulation(2, settings)
    waiting = []
    for _ in range(50 * 5):
        sim.step(10)
        waiting.append((sim.vio, sim.height))
        if len(waiting) > 2:
            odometry, height = waiting.pop(0)
            sim.give_odometry(odometry)
            sim.give_range(height)
    assert sim.estimate.valid
    assert sim.estimate.resets == 0
    off = sim.estimate.world_from_body.translation - sim.truth.world_from_body.translation
    assert np.abs(off).max() < 0.02
    assert np.abs(sim.truth.world_from_body.translation - [0, 0, HEIGHT_M]).max() < 0.04
    hungry = simulation(2, settings)
    hungry.step(6 * SECOND_STEPS)
    assert not hungry.estimate.valid


@pytest.mark.parametrize(
    ("velocity", "rate"),
    [((math.nan, 0.0, 0.0), 0.0), ((0.0, 1e9, 0.0), 0.0), ((0.0, 0.0, 0.0), math.inf)],
)
def test_a_command_that_is_none_is_refused(velocity, rate):
    """The error has the numbers in it, and the drone flies on as before."""
    sim = simulation()
    with pytest.raises(VehicleError, match="no command to fly"):
        sim.set_velocity(velocity, rate)
    sim.step(10)


@pytest.mark.parametrize("x_m", [1e6, math.nan])
def test_physics_that_diverge_are_an_error_and_no_new_start(x_m, tmp_path, monkeypatch, caplog):
    """A drone that is nowhere any more is told, with when and where; no file is left behind."""
    monkeypatch.chdir(tmp_path)
    sim = simulation()
    sim.step(5)
    sim._data.joint("drone/free").qpos[0] = x_m
    with pytest.raises(VehicleError, match=r"diverged at 0\.010 s: the drone is at"):
        sim.step(5)
    assert list(tmp_path.iterdir()) == []
    assert ("MuJoCo" in caplog.text) == math.isnan(x_m)


def test_bad_requests_are_refused():
    """Steps that are no number of steps, a lamp that there is not, a seed that is none."""
    sim = simulation()
    with pytest.raises(VehicleError, match="number of steps"):
        sim.step(-1)
    with pytest.raises(VehicleError, match="no lamp 'sun'; the scene has: lamp"):
        sim.lamp_out("sun")
    with pytest.raises(WorldError, match="a seed is"):
        simulation(-1)


def test_the_client_flies_it_to_the_board_and_back():
    """The real filters and mission: from three metres to a gentle touch of the middle, and back."""
    sim = simulation(0, start=(BOARD_X_M - 3.0 - REACH_M, 0.2, HEIGHT_M + 0.1), turned_rad=0.15)
    pilot = Pilot(sim)
    pilot.fly(60.0)
    assert pilot.phases[-3:] == [Phase.CONTACT, Phase.RETREAT, Phase.DONE]
    touched = pilot.first_touch
    assert touched is not None
    lateral = (BOARD.inverse() @ touched.tip_world)[1:]
    assert np.linalg.norm(lateral) < 0.02
    assert sim.truth.worst_impact_mps < 0.05
    assert sim.contacts.worst_force_n["drone/tip"] < 5.0
    assert set(sim.contacts.worst_force_n) == {"drone/tip"}
    assert pilot.touching_s > 1.5
    tip_x = (BOARD.inverse() @ sim.truth.tip_world)[0]
    assert tip_x > 0.7
