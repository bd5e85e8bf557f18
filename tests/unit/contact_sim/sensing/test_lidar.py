"""The lidar: rays against geometry, its range and its noise."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.errors import VehicleError
from contact_sim.scene.drone import LIDAR_DROP_M, add_drone
from contact_sim.sensing.lidar import Lidar, LidarSettings
from drone_client.airframe import Airframe
from drone_client.mission.contact import ContactSettings
from rgbd_wire.quaternion import about_up, from_vector
from tests.unit.contact_sim.flights import (
    AIRFRAME,
    BOARD_X_M,
    HEIGHT_M,
    RIG,
    plain_world,
)
from tests.unit.drone_client.builders import pose

QUIET = LidarSettings(noise_m=0.0)
AHEAD_M = ContactSettings().lidar_ahead_m
LEVEL = (1.0, 0.0, 0.0, 0.0)


def rig_at(
    place=(0.0, 0.0, HEIGHT_M),
    settings=QUIET,
    looks_down=True,
    spec=None,
    airframe=AIRFRAME,
    arm_m=0.0,
):
    spec = spec or plain_world()
    add_drone(spec, airframe, RIG, pose(place))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.joint("drone/arm").qpos[:] = -arm_m
    mujoco.mj_forward(model, data)
    site = "drone/lidar_down" if looks_down else "drone/lidar_ahead"
    lidar = Lidar(settings, stream(0, site), model, site, looks_down=looks_down)
    return lambda q=LEVEL, at=place: lidar.measure(data, 7, at, q)


def test_down_is_the_height_and_ahead_the_way_to_the_board():
    """Level before the wall; the arm and the body are not what it sees."""
    down, ahead = rig_at()(), rig_at(looks_down=False)()
    assert down.distance_m == pytest.approx(HEIGHT_M - LIDAR_DROP_M)
    assert down.looks_down
    assert ahead.distance_m == pytest.approx(BOARD_X_M - AHEAD_M)
    assert not ahead.looks_down
    assert down.t_ns == 7


def test_a_slanted_beam_is_longer():
    """Rolled by 20 degrees, the way along the beam is what counts."""
    angle = math.radians(20.0)
    distance_m = rig_at()(from_vector((angle, 0.0, 0.0))).distance_m
    assert distance_m == pytest.approx(
        (HEIGHT_M - LIDAR_DROP_M * math.cos(angle)) / math.cos(angle)
    )


def test_it_sees_nothing_out_of_its_range():
    """Into the open, beyond 12 m and nearer than 10 cm it says zero, which is no distance."""
    away = rig_at(looks_down=False)(about_up(math.pi))
    high = rig_at((0.0, 0.0, 14.0))()
    low = rig_at((0.0, 0.0, 0.1))()
    for sample in (away, high, low):
        assert sample.distance_m == 0.0
        assert not sample.valid


def test_noise_is_a_centimetre():
    """Spread and mean over many samples."""
    measure = rig_at(settings=LidarSettings())
    distances = np.array([measure().distance_m for _ in range(3000)])
    assert distances.std() == pytest.approx(0.01, rel=0.06)
    assert distances.mean() == pytest.approx(HEIGHT_M - LIDAR_DROP_M, abs=1e-3)


def test_it_looks_through_the_body_that_it_sits_in():
    """From the middle of the body the ground is what it sees."""
    spec = plain_world()
    add_drone(spec, AIRFRAME, RIG, pose((0.0, 0.0, HEIGHT_M)))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    lidar = Lidar(QUIET, stream(0, "x"), model, "drone/imu", looks_down=True)
    assert lidar.measure(data, 0, (0.0, 0.0, HEIGHT_M), LEVEL).distance_m == pytest.approx(HEIGHT_M)


def armed(tip_m, down_rad=0.0) -> Airframe:
    """With its tip there, the arm pointing down by so much."""
    return Airframe(body_from_tip=pose(tip_m, (0.0, down_rad, 0.0)))


@pytest.mark.parametrize("arm_m", [0.0, 0.03])
@pytest.mark.parametrize("z_m", [-0.02, -0.03, -0.035, -0.04, -0.045, -0.05, -0.06, 0.03])
def test_an_arm_in_the_beam_is_not_seen(z_m, arm_m):
    """Whatever height it is at, at rest and pressed in: the board is, and in the open nothing."""
    ahead = rig_at(looks_down=False, airframe=armed((0.55, 0.0, z_m)), arm_m=arm_m)
    assert ahead().distance_m == pytest.approx(BOARD_X_M - AHEAD_M, abs=1e-9)
    assert ahead(about_up(math.pi)).distance_m == 0.0


@pytest.mark.parametrize("degrees", [2.0, 5.0, 10.0, 20.0, 40.0])
def test_an_arm_that_crosses_the_beam_is_not_seen(degrees):
    """Its rod comes from above and its tip is below."""
    down = math.radians(degrees)
    airframe = armed((0.55, 0.0, -0.55 * math.tan(down)), down)
    measure = rig_at(looks_down=False, airframe=airframe)
    assert measure().distance_m == pytest.approx(BOARD_X_M - AHEAD_M, abs=1e-9)
    assert measure(about_up(math.pi)).distance_m == 0.0


def test_with_the_tip_in_the_beam_a_touched_board_is_seen():
    """Pressed into it by a fraction of a millimetre, as at a real touch."""
    place = (BOARD_X_M - 0.55 + 0.0003, 0.0, HEIGHT_M)
    measure = rig_at(place, looks_down=False, airframe=armed((0.55, 0.0, -LIDAR_DROP_M)))
    assert measure().distance_m == pytest.approx(0.55 - 0.0003 - AHEAD_M, abs=1e-9)


def test_an_arm_that_points_down_is_not_seen_from_above():
    """Its rod leads from behind the beam to before it."""
    measure = rig_at(airframe=armed((0.25, 0.0, -0.8), math.radians(60.0)))
    assert measure().distance_m == pytest.approx(HEIGHT_M - LIDAR_DROP_M, abs=1e-9)


def test_what_is_only_touched_is_not_seen():
    """A stand-in for a rough surface, which no camera sees, is not in the way of the beam."""
    spec = plain_world()
    spec.worldbody.add_geom(
        name="proxy",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.5, 0.5, 0.1),
        pos=(0.0, 0.0, 0.5),
        group=3,
    )
    assert rig_at(spec=spec)().distance_m == pytest.approx(HEIGHT_M - LIDAR_DROP_M)


def test_a_model_without_its_site_is_refused():
    """The error says who makes it."""
    with pytest.raises(VehicleError, match="add_drone"):
        Lidar(QUIET, stream(0, "x"), plain_world().compile(), "drone/lidar_down", looks_down=True)


def test_bad_settings_are_refused():
    """The field at fault is named."""
    with pytest.raises(ValueError, match="noise_m"):
        LidarSettings(noise_m=1.0)
