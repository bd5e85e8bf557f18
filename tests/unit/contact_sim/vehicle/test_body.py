"""The drone in MuJoCo's numbers: against MuJoCo's own kinematics."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.scene.drone import MASS_KG, TIP_RADIUS_M, add_drone
from contact_sim.vehicle.body import Body, Motion
from rgbd_wire.geometry import Pose
from tests.unit.contact_sim.flights import AIRFRAME, RIG, plain_world
from tests.unit.drone_client.builders import pose

numbers = st.floats(-2.0, 2.0)
vectors = st.tuples(numbers, numbers, numbers)


def built() -> tuple[mujoco.MjModel, mujoco.MjData, Body]:
    spec = plain_world()
    # something else that moves, so that the drone's numbers are not the first ones
    ball = spec.worldbody.add_body(name="ball", pos=(5.0, 5.0, 5.0))
    ball.add_freejoint()
    ball.add_geom(size=(0.1, 0.0, 0.0))
    add_drone(spec, AIRFRAME, RIG, pose((0.0, 0.0, 50.0)))
    model = spec.compile()
    data = mujoco.MjData(model)
    return model, data, Body(model, data)


MODEL, DATA, BODY = built()


@given(vectors, vectors, vectors, vectors, st.floats(-0.04, 0.0), st.floats(-1.0, 1.0))
def test_places_and_velocities_are_mujoco_s(place, turn, velocity, rates, arm_m, arm_mps):
    """Of the body, of its spin, and of a point of the arm that slides."""
    at = pose(place, turn)
    DATA.joint("drone/free").qpos[:] = [*at.translation, *at.q_wxyz]
    DATA.joint("drone/free").qvel[:] = [*velocity, *rates]
    DATA.joint("drone/arm").qpos[:], DATA.joint("drone/arm").qvel[:] = arm_m, arm_mps
    mujoco.mj_forward(MODEL, DATA)
    state = BODY.read()
    assert isinstance(state.world_from_body, Pose)
    assert state.world_from_body.translation == pytest.approx(at.translation)
    assert state.world_from_body.rotation == pytest.approx(at.rotation, abs=1e-9)
    tip, slider = DATA.geom("drone/tip"), DATA.body("drone/slider")
    front = tip.xpos + TIP_RADIUS_M * slider.xmat.reshape(3, 3)[:, 0]
    assert BODY.tip_world(state) == pytest.approx(front, abs=1e-9)

    six = np.zeros(6)  # spin and velocity of the ball's centre, in the world's axes
    number, kind = MODEL.geom("drone/tip").id, mujoco.mjtObj.mjOBJ_GEOM
    mujoco.mj_objectVelocity(MODEL, DATA, kind, number, six, 0)
    motion = BODY.motion(state)
    assert motion.spin_world == pytest.approx(six[:3], abs=1e-9)
    assert motion.point_velocity(tuple(tip.xpos), on_arm=True) == pytest.approx(six[3:], abs=1e-9)


def test_a_point_of_the_body_does_not_slide_with_the_arm():
    """The textbook's v + w x r."""
    motion = Motion((1.0, 0.0, 0.0), (0.1, 0.2, 0.3), (0.0, 0.0, 2.0), (0.0, 1.0, 0.0), -0.4)
    expected = np.array([0.1, 0.2, 0.3]) + np.cross([0.0, 0.0, 2.0], [0.0, 0.5, 0.0])
    assert motion.point_velocity((1.0, 0.5, 0.0), on_arm=False) == pytest.approx(expected)


def test_rotors_that_turn_already_and_the_air_move_it_at_once():
    """Spun up to the weight it hangs in the air; pushed aside it goes there, by its mass."""
    model, data, body = built()
    body.spin_up(MASS_KG * 9.81 / 4.0)
    body.push((3.3, 0.0, 0.0))
    mujoco.mj_forward(model, data)
    at = model.joint("drone/free").dofadr[0]
    assert data.qacc[at + 2] == pytest.approx(0.0, abs=1e-9)
    # the tip lags behind on its spring: at first only the body is pushed
    assert data.qacc[at] == pytest.approx(1.0, rel=0.02)
    body.lift((0.0, 0.0, 0.0, 0.0))
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert body.read().velocity_world[2] < -2.0
