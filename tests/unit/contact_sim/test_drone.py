"""The drone's body: weight, places, and an arm that swings as its equation says."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from contact_sim.errors import VehicleError
from contact_sim.scene import SEEN_GROUP, TOUCHED_GROUP
from contact_sim.scene.drone import (
    ARM,
    MASS_KG,
    TIMESTEP_S,
    TIP_FRICTION,
    TIP_MASS_KG,
    TIP_RADIUS_M,
    add_drone,
    rotor_places,
)
from drone_client.airframe import Airframe
from rgbd_wire.geometry import Pose
from tests.unit.contact_sim.flights import AIRFRAME, BOARD_X_M, HEIGHT_M, REACH_M, RIG, plain_world
from tests.unit.drone_client.builders import pose, rotation_of

START = pose((0.3, -0.2, HEIGHT_M), (0.0, 0.0, 0.4))


def built(start: Pose = START, airframe: Airframe = AIRFRAME, spec=None):
    spec = spec or plain_world()
    add_drone(spec, airframe, RIG, start)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def falling(arm_m: float = 0.0):
    """Far above the ground, without thrust; the arm pressed in by so much."""
    model, data = built(pose((0.0, 0.0, 500.0)))
    data.joint("drone/arm").qpos[:] = -arm_m
    return model, data


def test_it_weighs_what_it_should_and_is_balanced():
    """3.3 kg in all, the centre of mass in the body's origin."""
    model, data = built()
    drone = model.body("drone").id
    assert model.body_subtreemass[drone] == pytest.approx(MASS_KG)
    assert data.subtree_com[drone] == pytest.approx(START.translation, abs=1e-9)


def test_the_tip_is_where_the_client_believes_it():
    """The front of the ball at rest is the airframe's tip."""
    _, data = built()
    ball, tip = data.geom("drone/tip"), START @ AIRFRAME.body_from_tip
    front = ball.xpos + TIP_RADIUS_M * tip.rotation[:, 0]
    assert front == pytest.approx(tip.translation, abs=1e-9)


def test_cameras_look_from_where_the_rig_has_them():
    """Their places, and that MuJoCo's -z is the camera's z, y its -y."""
    _, data = built()
    for name, body_from_camera in (
        ("drone/color", AIRFRAME.body_from_camera),
        ("drone/depth", AIRFRAME.body_from_camera @ RIG.color_from_depth),
    ):
        expected = START @ body_from_camera
        camera = data.camera(name)
        assert camera.xpos == pytest.approx(expected.translation, abs=1e-9)
        turned = camera.xmat.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
        assert turned == pytest.approx(rotation_of(expected).as_matrix(), abs=1e-9)


def test_propellers_are_the_airframe_s_discs():
    """Place and radius; they can be touched and are not seen; the body is seen."""
    model, _ = built()
    discs = [p for p in AIRFRAME.keep_outs[0].parts if p.axis_body is not None]
    for i, disc in enumerate(discs):
        geom = model.geom(f"drone/propeller_{i}")
        assert geom.pos == pytest.approx(disc.center_body)
        assert geom.size[0] == disc.radius_m
        assert geom.group == TOUCHED_GROUP
    assert model.geom("drone/body").group == SEEN_GROUP
    assert rotor_places(AIRFRAME) == tuple(disc.center_body for disc in discs)


def test_a_rotor_lifts_turns_and_lags():
    """Thrust along the body's z, drag torque about it, and a first-order lag of the motor."""
    model, data = falling()
    data.ctrl[:] = 8.0
    steps = 20
    for _ in range(steps):
        mujoco.mj_step(model, data)
    reached = 8.0 * (1.0 - math.exp(-steps * TIMESTEP_S / 0.04))
    assert data.act == pytest.approx([reached] * 4, rel=1e-6)
    mujoco.mj_forward(model, data)
    acceleration = data.qacc[model.joint("drone/free").dofadr[0] + 2]
    assert acceleration == pytest.approx(4.0 * reached / MASS_KG - 9.81, rel=1e-6)
    # all four alike do not turn it, the two of one diagonal do
    assert data.qvel[model.joint("drone/free").dofadr[0] + 5] == pytest.approx(0.0, abs=1e-9)
    data.act[:] = (8.0, 0.0, 0.0, 8.0)
    mujoco.mj_forward(model, data)
    assert data.qacc[model.joint("drone/free").dofadr[0] + 5] > 1.0


def test_the_arm_swings_back_as_its_equation_says():
    """In free fall, pressed in by 3 cm and let go: SciPy's damped two-body oscillator."""
    model, data = falling(0.03)
    reduced_kg = TIP_MASS_KG * (MASS_KG - TIP_MASS_KG) / MASS_KG

    def oscillator(_t, state):
        d, v = state
        return v, -(ARM.stiffness_npm * d + ARM.damping_nspm * v) / reduced_kg

    times = TIMESTEP_S * np.arange(1, 151)
    expected = solve_ivp(
        oscillator, (0.0, times[-1]), (-0.03, 0.0), t_eval=times, rtol=1e-9, atol=1e-12
    ).y[0]
    swung = []
    for _ in times:
        mujoco.mj_step(model, data)
        swung.append(float(data.joint("drone/arm").qpos[0]))
    # the integrator is of first order: half a step of 2 ms of the fastest motion
    assert np.abs(np.array(swung) - expected).max() < 0.0009
    assert swung[-1] == pytest.approx(expected[-1], abs=1e-5)


def test_the_spring_gives_back_no_more_than_it_held():
    """Momentum stays, and no energy comes from nowhere, while the arm swings in free fall."""
    model, data = falling(0.03)
    model.opt.gravity[:] = 0.0
    held_j = 0.5 * ARM.stiffness_npm * 0.03**2
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    mujoco.mj_forward(model, data)
    assert data.energy.sum() == pytest.approx(held_j, rel=1e-6)
    last_j = held_j
    for _ in range(200):
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        assert data.energy.sum() <= last_j + 1e-9
        last_j = float(data.energy.sum())
    mujoco.mj_subtreeVel(model, data)
    assert last_j < 0.01 * held_j
    assert data.subtree_linvel[model.body("drone").id] == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_arm_ends_at_its_stop():
    """Pushed with twice what the spring holds at its end, it goes little further than that."""
    model, data = falling()
    slider = model.body("drone/slider").id
    for _ in range(200):
        axis = data.xmat[slider].reshape(3, 3)[:, 0]
        force = 2.0 * ARM.stiffness_npm * ARM.travel_m * axis
        data.xfrc_applied[slider, :3] = -force
        data.xfrc_applied[model.body("drone").id, :3] = force
        mujoco.mj_step(model, data)
    assert -data.joint("drone/arm").qpos[0] == pytest.approx(ARM.travel_m, abs=0.002)


@pytest.mark.parametrize(("share", "holds"), [(0.85, True), (1.15, False)])
def test_the_tip_holds_on_the_board_until_its_friction_is_exceeded(share, holds):
    """Pressed on and pulled aside, it creeps by less than a millimetre below 0.6 of the force."""
    # The drone lies on air here: without weight, held level and pressed by hand.
    start = pose((BOARD_X_M - REACH_M + 0.01, 0.0, HEIGHT_M))
    model, data = built(start)
    model.opt.gravity[:] = 0.0
    drone, free = model.body("drone").id, model.joint("drone/free").dofadr[0]
    model.dof_damping[free + 3 : free + 6] = 50.0
    model.dof_damping[free : free + 3] = 20.0
    press_n = 3.0
    data.xfrc_applied[drone, 0] = press_n
    for _ in range(500):
        mujoco.mj_step(model, data)
    before = data.geom("drone/tip").xpos.copy()
    slider = model.body("drone/slider").id
    data.xfrc_applied[slider, 1] = share * TIP_FRICTION[0] * press_n
    for _ in range(500):
        mujoco.mj_step(model, data)
    crept = np.linalg.norm(data.geom("drone/tip").xpos[1:] - before[1:])
    assert (crept < 0.001) == holds


def test_airframes_that_it_cannot_be_are_refused():
    """No four propellers, or an arm that does not reach ahead."""
    bare = replace(AIRFRAME, keep_outs=())
    with pytest.raises(VehicleError, match="one in each quarter"):
        built(airframe=bare)
    short = replace(AIRFRAME, body_from_tip=pose((0.1, 0.0, 0.0)))
    with pytest.raises(VehicleError, match="must reach ahead"):
        built(airframe=short)
