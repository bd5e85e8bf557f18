"""The world that a flight is given: the drone in it is the one that the client believes in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from contact_sim.errors import VehicleError
from contact_sim.flight.plugin import open_simulator
from contact_sim.flight.world import SimulatedWorld
from contact_sim.scene import build_scene
from drone_client.airframe import Airframe
from drone_client.errors import WorldError
from drone_client.fly.simulator import SimulatorRequest
from rgbd_wire.clock import ManualClock, MonotonicClock
from rgbd_wire.geometry import Pose, rotation_from_vector

SCENE = build_scene("tunnel", 0)
USUAL = Airframe()


def with_tip(x_m: float, y_m: float = 0.0) -> Airframe:
    return replace(USUAL, body_from_tip=Pose(np.array([x_m, y_m, 0.0]), Pose.identity().q_wxyz))


def with_propellers(radius_m: float, how_many: int = 4) -> Airframe:
    (wall,) = USUAL.keep_outs
    discs = [replace(part, radius_m=radius_m) for part in wall.parts if part.axis_body is not None]
    return replace(USUAL, keep_outs=(replace(wall, parts=tuple(discs[:how_many])),))


def test_arm_and_camera_are_where_the_airframe_has_them(tmp_path):
    """A longer arm, aside, and a camera that is turned: in the truth, and in the drawn model."""
    camera = Pose.from_rotation(
        rotation_from_vector(np.array([0.0, 0.0, 0.1])) @ USUAL.body_from_camera.rotation,
        np.array([0.1, 0.05, 0.12]),
    )
    airframe = replace(with_tip(0.7, 0.1), body_from_camera=camera)
    world = SimulatedWorld(SCENE, 0, ManualClock(0), tmp_path, airframe=airframe)
    with world.live.look() as (simulation, _):
        truth, model = simulation.truth, simulation.model
    body_from_world = truth.world_from_body.inverse()
    np.testing.assert_allclose(body_from_world @ truth.tip_world, [0.7, 0.1, 0.0], atol=1e-3)
    np.testing.assert_allclose(model.camera("drone/color").pos, camera.translation)


@pytest.mark.parametrize(
    ("airframe", "says"),
    [
        (with_tip(0.1), "the arm must reach ahead of the body"),
        (with_tip(3.0), "has no room where the flight begins: the board is 2.5"),
        (with_propellers(2.9), "has no room where the flight begins: drone/propeller_. is on"),
        (with_propellers(0.17, how_many=3), "four rotors are needed"),
    ],
)
def test_a_drone_that_cannot_be_built_is_refused_before_anything_starts(tmp_path, airframe, says):
    """In one line, and no file, thread or process has come of it."""
    with pytest.raises(VehicleError, match=says):
        SimulatedWorld(SCENE, 0, ManualClock(0), tmp_path, airframe=airframe)
    folder = tmp_path / "run"
    request = SimulatorRequest(
        "tunnel", 0, "clean", None, "d", folder, starts_service=True, airframe=airframe
    )
    with pytest.raises(WorldError, match=says):
        open_simulator(request, MonotonicClock())
    assert not folder.exists()


def test_a_drone_that_touches_nothing_has_flown_safely(tmp_path):
    """It hovers, and says so; what a touch would tell is not known."""
    world = SimulatedWorld(SCENE, 0, ManualClock(0), tmp_path)
    report = world.report()
    assert (report["safe"], report["collisions"], report["touched"]) == (True, (), False)


def test_a_sample_is_the_same_one_until_there_is_a_newer(tmp_path):
    """Whoever looks twice knows that nothing is new; its stamp is the drone's clock."""
    clock = ManualClock(7_000_000_000)
    odometry = SimulatedWorld(SCENE, 0, clock, tmp_path).odometry
    with odometry._live.look() as (simulation, offset_ns):
        simulation.step(20)
    for ask in (odometry.odometry, odometry.height, odometry.ahead):
        sample = ask()
        assert sample is not None
        assert offset_ns < sample.t_ns <= offset_ns + 40_000_000
        assert ask() is sample
    with odometry._live.look() as (simulation, _):
        simulation.step(20)
    for ask, before in ((odometry.odometry, sample), (odometry.height, sample)):
        assert ask().t_ns > before.t_ns
