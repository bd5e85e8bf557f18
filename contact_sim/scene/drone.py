"""The drone's body: a quadrotor of 650 mm with a compliant arm ahead, for MuJoCo.

Where things are comes from the client's ``Airframe``, so that a drone with another camera or a
longer arm is flown by describing it once. Propellers are discs that touch and are not drawn; what
a camera of the drone can see of it, the arm above all, is.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from contact_sim.errors import VehicleError
from contact_sim.scene import SEEN_GROUP, TOUCHED_GROUP
from contact_sim.vehicle.rotors import DRAG_TORQUE_M, LAG_S, MAX_THRUST_N, Mixer
from drone_client.airframe import Airframe
from drone_client.cbf.keep_out import BodyPart
from drone_client.cbf.vector import Vec3
from drone_client.mission.arm import Arm
from drone_client.mission.contact import ContactSettings
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Array, Pose

TIMESTEP_S = 0.002
MASS_KG = 3.3
"""With arm and battery."""
INERTIA_KGM2 = (0.045, 0.052, 0.088)
"""Of a 650 mm frame of that weight about its own axes, without what moves of the arm."""
ARM = Arm()
"""The arm that the client expects; stiffness, damping and travel are its."""
TIP_MASS_KG = 0.04
TIP_RADIUS_M = 0.012
MATTE = "drone/rubber"
"""What does not shine: a bright spot on the tip looks like a ring of the target."""
LAMP_ABOVE_M = 0.04
LAMP_RGB = (0.26, 0.26, 0.27)
ROD_RADIUS_M = 0.004
ROD_FROM_M = 0.14
"""Where along the body's x the rod comes out of its tube."""
TIP_FRICTION = (0.6, 0.005, 1e-4)
"""Rubber on a painted board: sliding, turning [m], rolling [m]."""
LIDAR_DROP_M = 0.04
"""So far below the middle of the body its lidars are; the default airframe's arm is above them."""

# The drone touches the world and not itself: its geoms collide with what has contype 1.
_DRONE_BIT, _WORLD_BIT = 2, 1
_CAMERA_FROM_RDF = np.diag([1.0, -1.0, -1.0])
"""MuJoCo's cameras look along their -z, with y up."""


def add_drone(
    spec: mujoco.MjSpec, airframe: Airframe, rig: RgbdCamera, world_from_body: Pose
) -> None:
    """Put the drone into a world; sets the world's time step, gravity and solver too.

    Adds body ``drone`` with joint ``drone/free`` and arm joint ``drone/arm`` (negative: pressed
    in), geoms ``drone/body``, ``drone/propeller_0`` to ``_3`` and ``drone/tip``, cameras
    ``drone/color`` and ``drone/depth``, sites ``drone/imu``, ``drone/lidar_down`` and
    ``drone/lidar_ahead``, and for each rotor a site and an actuator ``drone/rotor_0`` to ``_3``.

    Args:
        spec: the world.
        airframe: where camera and tip are, and the room that propellers take: its discs, in their
            order.
        rig: the two cameras.
        world_from_body: where it is at the start.

    Raises:
        VehicleError: the airframe has no X of four propellers, or its arm is none that reaches
            ahead.
    """
    discs = _propellers(airframe)
    tip = airframe.body_from_tip
    if not tip.translation[0] > ROD_FROM_M + ARM.travel_m:
        raise VehicleError(
            f"the arm must reach ahead of the body: body_from_tip has x = {tip.translation[0]:g} m,"
            f" at least {ROD_FROM_M + ARM.travel_m:g} m are needed"
        )
    _set_physics(spec)
    spec.add_material(name=MATTE, specular=0.0, shininess=0.0)
    body = spec.worldbody.add_body(
        name="drone", pos=world_from_body.translation, quat=world_from_body.q_wxyz
    )
    body.add_joint(name="drone/free", type=mujoco.mjtJoint.mjJNT_FREE)
    # The battery is put where it balances the arm.
    body.explicitinertial = 1
    body.mass = MASS_KG - TIP_MASS_KG
    body.inertia = INERTIA_KGM2
    body.ipos = -TIP_MASS_KG / body.mass * (tip.translation - _tip_axis(tip) * TIP_RADIUS_M)
    _add_hull(body, discs)
    _add_arm(body, tip)
    _add_rotors(spec, body, discs)
    _add_camera(body, "drone/color", airframe.body_from_camera, rig.color)
    body_from_depth = airframe.body_from_camera @ rig.color_from_depth
    _add_camera(body, "drone/depth", body_from_depth, rig.depth)
    _add_lamp(body, airframe.body_from_camera)
    body.add_site(name="drone/imu", group=TOUCHED_GROUP)
    body.add_site(name="drone/lidar_down", pos=(0.0, 0.0, -LIDAR_DROP_M), group=TOUCHED_GROUP)
    body.add_site(
        name="drone/lidar_ahead",
        pos=(ContactSettings().lidar_ahead_m, 0.0, -LIDAR_DROP_M),
        group=TOUCHED_GROUP,
    )


def rotor_places(airframe: Airframe) -> tuple[Vec3, ...]:
    """Where the rotors are in the body [m], in the order of the actuators.

    Raises:
        VehicleError: they are no X of four.
    """
    return tuple(disc.center_body for disc in _propellers(airframe))


def _propellers(airframe: Airframe) -> tuple[BodyPart, ...]:
    parts = dict.fromkeys(part for plane in airframe.keep_outs for part in plane.parts)
    discs = tuple(part for part in parts if part.axis_body is not None)
    Mixer.of([disc.center_body for disc in discs])  # says what is wrong with them
    for disc in discs:
        assert disc.axis_body is not None
        if abs(disc.axis_body[2]) < 0.999:
            raise VehicleError(
                f"the propeller at {disc.center_body} is not level: axis {disc.axis_body}"
            )
    return discs


def _set_physics(spec: mujoco.MjSpec) -> None:
    option = spec.option
    option.timestep = TIMESTEP_S
    option.gravity = (0.0, 0.0, -9.81)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # Round cones, and friction as stiff as the normal force: a pressed tip does not creep.
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    # A state that is no number must be seen, and not be put back to the start in silence.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def _add_hull(body: mujoco.MjsBody, discs: tuple[BodyPart, ...]) -> None:
    body.add_geom(
        name="drone/body",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.11, 0.09, 0.035),
        rgba=(0.08, 0.08, 0.09, 1.0),
        group=SEEN_GROUP,
        contype=_DRONE_BIT,
        conaffinity=_WORLD_BIT,
    )
    for i, disc in enumerate(discs):
        body.add_geom(
            name=f"drone/propeller_{i}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=disc.center_body,
            size=(disc.radius_m, 0.006, 0.0),
            rgba=(0.1, 0.1, 0.1, 0.3),
            group=TOUCHED_GROUP,
            contype=_DRONE_BIT,
            conaffinity=_WORLD_BIT,
        )
        x, y, z = disc.center_body
        body.add_geom(
            name=f"drone/boom_{i}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(0.0, 0.0, 0.0, x, y, z - 0.03),
            size=(0.008, 0.0, 0.0),
            rgba=(0.05, 0.05, 0.05, 1.0),
            group=SEEN_GROUP,
            contype=0,
            conaffinity=0,
        )


def _tip_axis(tip: Pose) -> Array:
    return np.asarray(tip.rotation[:, 0])


def _add_arm(body: mujoco.MjsBody, tip: Pose) -> None:
    """Ball and rod on a slide, with a spring and a damper, and a stop where its travel ends."""
    axis = _tip_axis(tip)
    arm = body.add_body(name="drone/slider", pos=tip.translation - TIP_RADIUS_M * axis)
    arm.explicitinertial = 1
    arm.ipos = (0.0, 0.0, 0.0)
    arm.mass = TIP_MASS_KG
    arm.inertia = (8e-6, 8e-6, 8e-6)
    arm.add_joint(
        name="drone/arm",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=axis,
        stiffness=ARM.stiffness_npm,
        damping=ARM.damping_nspm,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        # a little room ahead: the stop there must not be felt where the arm is at rest
        range=(-ARM.travel_m, 0.002),
        solref_limit=(0.006, 1.0),
    )
    arm.add_geom(
        name="drone/tip",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(TIP_RADIUS_M, 0.0, 0.0),
        material=MATTE,
        rgba=(0.06, 0.06, 0.06, 1.0),
        group=SEEN_GROUP,
        contype=_DRONE_BIT,
        conaffinity=_WORLD_BIT,
        # What the tip is made of decides, whatever it touches: stiff, with rubber's friction.
        priority=1,
        friction=TIP_FRICTION,
        condim=4,
        solref=(0.006, 1.0),
        solimp=(0.95, 0.99, 0.0005, 0.5, 2.0),
    )
    length_m = float(tip.translation @ axis) - ROD_FROM_M - TIP_RADIUS_M
    arm.add_geom(
        name="drone/rod",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=(*(-max(length_m, 0.01) * axis), 0.0, 0.0, 0.0),
        size=(ROD_RADIUS_M, 0.0, 0.0),
        material=MATTE,
        rgba=(0.05, 0.05, 0.05, 1.0),
        group=SEEN_GROUP,
        contype=0,
        conaffinity=0,
    )


def _add_rotors(spec: mujoco.MjSpec, body: mujoco.MjsBody, discs: tuple[BodyPart, ...]) -> None:
    mixer = Mixer.of([disc.center_body for disc in discs])
    for i, (disc, spin) in enumerate(zip(discs, mixer.spin, strict=True)):
        name = f"drone/rotor_{i}"
        body.add_site(name=name, pos=disc.center_body, group=TOUCHED_GROUP)
        spec.add_actuator(
            name=name,
            trntype=mujoco.mjtTrn.mjTRN_SITE,
            target=name,
            gear=(0.0, 0.0, 1.0, 0.0, 0.0, spin * DRAG_TORQUE_M),
            ctrllimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            ctrlrange=(0.0, MAX_THRUST_N),
            dyntype=mujoco.mjtDyn.mjDYN_FILTEREXACT,
            dynprm=(LAG_S, *([0.0] * 9)),
        )


def _add_lamp(body: mujoco.MjsBody, body_from_camera: Pose) -> None:
    """A lamp beside the camera, as drones in tunnels carry one: it lights what is near."""
    body.add_light(
        name="drone/lamp",
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        pos=body_from_camera.translation + (0.0, 0.0, LAMP_ABOVE_M),
        dir=body_from_camera.rotation[:, 2],
        cutoff=60.0,
        exponent=4.0,
        diffuse=LAMP_RGB,
        specular=LAMP_RGB,
        attenuation=(0.3, 0.0, 1.0),
        castshadow=0,
        range=20.0,
    )


def _add_camera(
    body: mujoco.MjsBody, name: str, body_from_camera: Pose, intrinsics: CameraIntrinsics
) -> None:
    rotation = body_from_camera.rotation @ _CAMERA_FROM_RDF
    pose = Pose.from_rotation(rotation, body_from_camera.translation)
    # What the renderer needs besides, such as where the middle is, it takes from the rig itself.
    half = math.atan2(0.5 * intrinsics.height, intrinsics.fy)
    body.add_camera(
        name=name,
        pos=pose.translation,
        quat=pose.q_wxyz,
        resolution=(intrinsics.width, intrinsics.height),
        fovy=math.degrees(2.0 * half),
    )
