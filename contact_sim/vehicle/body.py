"""The drone in MuJoCo's numbers: read as plain floats, and pushed by its rotors and the air."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from contact_sim.scene.drone import TIP_RADIUS_M
from contact_sim.vehicle.rotors import Thrusts
from drone_client.cbf.vector import Vec3, moved
from rgbd_wire.geometry import Array, Pose, vec3
from rgbd_wire.quaternion import Quaternion, rotate


class BodyState(NamedTuple):
    """How the drone is and moves at a moment."""

    position_world: Vec3
    q_world_from_body: Quaternion
    velocity_world: Vec3
    """Of the body's origin [m/s]."""
    rates_body: Vec3
    """[rad/s]"""
    arm_m: float
    """Negative: pressed in."""
    arm_mps: float

    @property
    def world_from_body(self) -> Pose:
        """As a pose."""
        return Pose(np.array(self.position_world), np.array(self.q_world_from_body))


class Motion(NamedTuple):
    """What is needed to know how fast any point of the drone moves."""

    position_world: Vec3
    velocity_world: Vec3
    spin_world: Vec3
    """[rad/s]"""
    arm_world: Vec3
    """Direction in which the arm's coordinate grows."""
    arm_mps: float

    def point_velocity(self, place_world: Vec3, *, on_arm: bool) -> Vec3:
        """Velocity [m/s] of what is at a place, of the body or of the arm's sliding part."""
        x, y, z = (p - o for p, o in zip(place_world, self.position_world, strict=True))
        a, b, c = self.spin_world
        u, v, w = self.velocity_world
        k = self.arm_mps if on_arm else 0.0
        d, e, f = self.arm_world
        return u + b * z - c * y + k * d, v + c * x - a * z + k * e, w + a * y - b * x + k * f


class Body:
    """The drone that ``add_drone`` has put into a model."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        # Views of MuJoCo's own numbers, which stay where they are
        self._q, self._v = data.qpos, data.qvel
        free, arm = model.joint("drone/free"), model.joint("drone/arm")
        self._at_q, self._at_v = int(free.qposadr[0]), int(free.dofadr[0])
        self._at_arm_q, self._at_arm_v = int(arm.qposadr[0]), int(arm.dofadr[0])
        self._force_world = data.xfrc_applied[int(model.body("drone").id)]
        self._act, self._ctrl = data.act, data.ctrl
        self._rotors = [int(model.actuator(f"drone/rotor_{i}").id) for i in range(4)]
        self._motors = [int(model.actuator_actadr[i]) for i in self._rotors]
        x, y, z = model.jnt_axis[arm.id].tolist()
        self._arm_body: Vec3 = (x, y, z)
        slider = vec3(model.body("drone/slider").pos)
        self._tip_body = moved(slider, self._arm_body, TIP_RADIUS_M)

    def read(self) -> BodyState:
        """The state now."""
        q, v = self._q.tolist(), self._v.tolist()
        i, j = self._at_q, self._at_v
        return BodyState(
            (q[i], q[i + 1], q[i + 2]),
            (q[i + 3], q[i + 4], q[i + 5], q[i + 6]),
            (v[j], v[j + 1], v[j + 2]),
            (v[j + 3], v[j + 4], v[j + 5]),
            q[self._at_arm_q],
            v[self._at_arm_v],
        )

    def motion(self, state: BodyState) -> Motion:
        """The same for the speed of its points."""
        q = state.q_world_from_body
        return Motion(
            state.position_world,
            state.velocity_world,
            rotate(q, state.rates_body),
            rotate(q, self._arm_body),
            state.arm_mps,
        )

    def tip_world(self, state: BodyState) -> Array:
        """Where the tip's front is, pressed in or not (3,) [m]."""
        tip_body = moved(self._tip_body, self._arm_body, state.arm_m)
        tip_world = rotate(state.q_world_from_body, tip_body)
        return np.array(moved(state.position_world, tip_world))

    def spin_up(self, thrust_n: float) -> None:
        """Let all rotors turn with this thrust already, each."""
        self._act[self._motors] = self._ctrl[self._rotors] = thrust_n

    def lift(self, thrusts: Thrusts) -> None:
        """What the rotors shall do from now on [N]; they lag."""
        a, b, c, d = self._rotors
        # One by one: quicker than a list of places
        ctrl = self._ctrl
        ctrl[a], ctrl[b], ctrl[c], ctrl[d] = thrusts

    def push(self, force_world: Vec3) -> None:
        """What the air does from now on [N], in the centre of mass."""
        force = self._force_world
        force[0], force[1], force[2] = force_world
