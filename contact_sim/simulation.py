"""The whole drone in its world, stepped together in simulated time.

No threads and no wall clock: whoever steps it says how much time passes, and the same scene, seed
and commands at the same steps give the same flight, bit for bit. One step is 2 ms; IMU, estimator,
velocity loop, rotors and wind run at every second one, VIO and lidars at their own rates.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np

from contact_sim.chance import stream
from contact_sim.contacts import TIP, Contacts, Touch
from contact_sim.errors import VehicleError
from contact_sim.scene import Scene, Snapshot
from contact_sim.scene.drone import MASS_KG, TIMESTEP_S, add_drone, rotor_places
from contact_sim.sensing.imu import Imu, ImuSample, ImuSettings
from contact_sim.sensing.lidar import Lidar, LidarSettings
from contact_sim.sensing.vio import Moving, Vio, VioSettings
from contact_sim.vehicle import velocity_loop
from contact_sim.vehicle.body import Body
from contact_sim.vehicle.estimator import Estimate, Estimator, EstimatorSettings
from contact_sim.vehicle.rotors import MAX_THRUST_N, Mixer, Thrusts
from contact_sim.vehicle.velocity_loop import Craft, LoopSettings, LoopState, Sensed, Setpoint
from contact_sim.vehicle.wind import Wind, WindSettings
from drone_client.airframe import Airframe
from drone_client.cbf.vector import Vec3, is_bounded
from drone_client.odometry import OdometrySample, RangeSample
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Array, Pose

log = logging.getLogger(__name__)

STEP_NS = 2_000_000
CONTROL_STEPS = 2
"""Physics steps from one turn of the velocity loop to the next: 250 Hz."""
LEARNED = 0.98
"""So much of the IMU's biases the estimator knows at the start, in the air."""
MAX_STEPS = 10_000_000
FARTHEST_M = 1e4
"""Nobody flies there, nor to where a place is no number."""
MAX_COMMAND = 100.0
"""A velocity [m/s] or yaw rate [rad/s] beyond this is a fault, not a command."""


@dataclass(frozen=True, slots=True)
class SimulationSettings:
    """How the drone flies and what disturbs it; the defaults are the scene's."""

    loop: LoopSettings = field(default_factory=LoopSettings)
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    imu: ImuSettings = field(default_factory=ImuSettings)
    vio: VioSettings = field(default_factory=VioSettings)
    lidar: LidarSettings = field(default_factory=LidarSettings)
    wind: WindSettings = field(default_factory=WindSettings)
    feeds_itself: bool = True
    """VIO and height go to the estimator by themselves; otherwise only what ``give_odometry`` and
    ``give_range`` pass on, as where the client feeds the autopilot."""
    rotors_from_outside: bool = False
    """An autopilot outside turns the rotors, with ``set_rotors``; they stand still at the start."""


class Truth(NamedTuple):
    """How it really is."""

    t_ns: int
    world_from_body: Pose
    velocity_world: Array  # (3,) [m/s]
    """Of the body's origin."""
    rates_body: Array  # (3,) [rad/s]
    tip_world: Array  # (3,) [m]
    """Where the tip's front really is, pressed in or not."""
    arm_m: float
    """By how much the arm is pressed in."""
    tip_force_n: float
    """Along the normals of all that it touches, in the last step."""
    touches: tuple[Touch, ...]
    """Of the last step."""
    worst_impact_mps: float
    """Of the tip, in this flight."""
    wind_world: Vec3
    """[m/s]"""


class Simulation:
    """A flight. May be used from one thread at a time.

    Its parts take faults: ``vio_camera.jump`` and ``.out``, ``wind.gust``, ``lamp_out``.
    """

    def __init__(
        self,
        scene: Scene,
        airframe: Airframe,
        rig: RgbdCamera,
        seed: int,
        settings: SimulationSettings | None = None,
    ) -> None:
        """Put the drone into the scene, in the air and at rest.

        Args:
            scene: the world; the drone is added to a copy of its ``spec``.
            airframe: where camera, arm and propellers are.
            rig: the cameras.
            seed: of all that is drawn by chance in flight.
            settings: of the vehicle, its sensors and the wind.

        Raises:
            VehicleError: the drone cannot be built with that airframe.
            WorldError: the seed is none.
        """
        self.settings = settings or SimulationSettings()
        self.scene = scene
        self.airframe = airframe
        self.rig = rig
        self._vio_says: Moving | None = None
        self._vio: OdometrySample | None = None
        self.height: RangeSample | None = None
        """The newest of the lidar that looks down; stamps are simulated time."""
        self.ahead: RangeSample | None = None
        """The newest of the lidar that looks forward."""
        # MuJoCo would write its warnings into a file in whatever folder this runs in.
        mujoco.set_mju_user_warning(_tell)
        self._model = model = self._with_drone(scene.bare)
        self._data = mujoco.MjData(model)
        self._body = Body(model, self._data)
        self._mixer = Mixer.of(rotor_places(airframe))
        self._craft = Craft(MASS_KG, 4.0 * MAX_THRUST_N, self._mixer.authority_nm)
        if not self.settings.rotors_from_outside:
            self._body.spin_up(0.25 * MASS_KG * velocity_loop.GRAVITY_MPS2)
        mujoco.mj_forward(model, self._data)

        self._steps = 0
        self._truth: Truth | None = None
        self._setpoint = Setpoint()
        self._thrusts: Thrusts = (0.0, 0.0, 0.0, 0.0)
        self.contacts = Contacts(model)
        self.wind = Wind(self.settings.wind, stream(seed, "wind"), scene.wind_world)
        self._wind_world = self.wind.mean_world
        drag = self.wind.drag(self._wind_world, (0.0, 0.0, 0.0))
        # Whoever hovered until now has learned to lean against the wind.
        self._loop = LoopState(velocity_integral=_scaled(drag, -1.0 / MASS_KG))
        self._imu = Imu(self.settings.imu, stream(seed, "imu"))
        self._state = self._body.read()
        self._sampled = self._state
        self._sampled_steps = 0
        self._imu_sample: ImuSample | None = None
        start = self._moving()
        self.vio_camera = Vio(self.settings.vio, stream(seed, "vio"), start)
        lidar = self.settings.lidar
        self._down = Lidar(
            lidar, stream(seed, "lidar_down"), model, "drone/lidar_down", looks_down=True
        )
        self._forward = Lidar(
            lidar, stream(seed, "lidar_ahead"), model, "drone/lidar_ahead", looks_down=False
        )
        self._vio_due_ns = self._lidar_due_ns = 0
        # And the estimator has learned most of what is wrong with its IMU.
        accel_bias, gyro_bias = (_scaled(bias, LEARNED) for bias in self._imu.biases)
        self._estimator = Estimator(
            self.settings.estimator, 0, scene.world_from_body, accel_bias, gyro_bias
        )
        self._lamps_out: frozenset[str] = frozenset()

    def _with_drone(self, world: mujoco.MjSpec) -> mujoco.MjModel:
        spec = world.copy()
        add_drone(spec, self.airframe, self.rig, self.scene.world_from_body)
        return spec.compile()

    @cached_property
    def model(self) -> mujoco.MjModel:
        """Of world and drone as they look, made when it is first asked for.

        For renderers, which draw it with a state of their own, from snapshots; what is stepped is
        the same without textures.
        """
        return self._with_drone(self.scene.spec)

    @property
    def t_ns(self) -> int:
        """Simulated time."""
        return self._steps * STEP_NS

    def step(self, n: int = 1) -> None:
        """Let ``n`` steps of 2 ms pass.

        Raises:
            VehicleError: ``n`` is no number of steps, or the physics have diverged.
        """
        if not 0 <= n <= MAX_STEPS:
            raise VehicleError(f"a number of steps is 0 to {MAX_STEPS}, not {n}")
        for _ in range(n):
            if self._steps % CONTROL_STEPS == 0:
                self._control()
            before = self._state
            mujoco.mj_step(self._model, self._data)
            self._state = self._body.read()
            if not is_bounded(self._state.position_world, FARTHEST_M):
                raise VehicleError(
                    f"the physics diverged at {self.t_ns / 1e9:.3f} s: the drone is at "
                    f"{self._state.position_world} m"
                )
            if self._data.ncon or self.contacts.touches:
                self.contacts.look(self._data, self.t_ns, self._body.motion(before))
            self._steps += 1
            self._sense()

    def set_velocity(self, velocity_world: Array | Vec3, yaw_rate_radps: float) -> None:
        """What the vehicle flies from now on, until it is told otherwise.

        Args:
            velocity_world: (3,) of the body [m/s], in the odometry's world, as an autopilot takes
                it.
            yaw_rate_radps: counter-clockwise seen from above.

        Raises:
            VehicleError: a number is none, or absurd.
        """
        x, y, z = map(float, velocity_world)
        rate = float(yaw_rate_radps)
        if not is_bounded((x, y, z), MAX_COMMAND) or not abs(rate) <= MAX_COMMAND:
            raise VehicleError(
                f"no command to fly: velocity_world = {(x, y, z)} m/s, yaw rate {rate} rad/s; each "
                f"must be a number of at most {MAX_COMMAND:g}"
            )
        self._setpoint = Setpoint((x, y, z), rate)

    def read_imu(self) -> ImuSample | None:
        """What the IMU gained in the last 4 ms, for an autopilot outside; None: at the beginning.

        Between two turns of the velocity loop only, after an even number of steps: whoever asks
        then can set the rotors by it before the next step.

        Raises:
            VehicleError: there is no sample of now.
        """
        if self._steps % CONTROL_STEPS:
            raise VehicleError(f"the IMU has a sample at every second step, not at {self._steps}")
        self._sample_imu()
        return self._imu_sample

    def set_rotors(self, thrusts_n: Thrusts) -> None:
        """What the rotors shall do from now on [N], in the order of ``rotor_places``; they lag.

        Raises:
            VehicleError: they are the velocity loop's, or a number is no thrust of a rotor.
        """
        if not self.settings.rotors_from_outside:
            raise VehicleError("the velocity loop turns the rotors: set rotors_from_outside")
        if len(thrusts_n) != 4 or not all(0.0 <= t <= MAX_THRUST_N for t in thrusts_n):
            raise VehicleError(
                f"four thrusts from 0 to {MAX_THRUST_N:g} N are needed, not {thrusts_n}"
            )
        self._thrusts = thrusts_n

    def give_odometry(self, sample: OdometrySample) -> None:
        """Pass a pose on to the estimator, stamped in simulated time."""
        self._estimator.feed(sample)

    def give_range(self, sample: RangeSample) -> None:
        """Pass a distance on to the estimator, stamped in simulated time."""
        self._estimator.feed_range(sample)

    def lamp_out(self, name: str) -> None:
        """Put out one of the scene's lamps.

        Raises:
            VehicleError: the scene has no such lamp.
        """
        if name not in self.scene.lamps:
            raise VehicleError(f"no lamp {name!r}; the scene has: {', '.join(self.scene.lamps)}")
        self._lamps_out |= {name}

    @property
    def vio(self) -> OdometrySample | None:
        """The newest of the VIO, the same one as long as there is no newer."""
        says = self._vio_says
        if says is not None and (self._vio is None or self._vio.t_ns != says.t_ns):
            self._vio = says.sample
        return self._vio

    @property
    def estimate(self) -> Estimate:
        """What the autopilot believes, in the odometry's world."""
        return self._estimator.estimate()

    @property
    def drift_m(self) -> float:
        """How far what the autopilot believes of its place is from where it is."""
        return math.dist(self._estimator.position, self._state.position_world)

    @property
    def truth(self) -> Truth:
        """How it really is; worked out once a step, however many ask."""
        if self._truth is None or self._truth.t_ns != self.t_ns:
            self._truth = self._look()
        return self._truth

    def _look(self) -> Truth:
        state = self._state
        return Truth(
            self.t_ns,
            state.world_from_body,
            np.array(state.velocity_world),
            np.array(state.rates_body),
            self._body.tip_world(state),
            -state.arm_m,
            self.contacts.tip_force_n,
            self.contacts.touches,
            self.contacts.worst_impact_mps.get(TIP, 0.0),
            self._wind_world,
        )

    def snapshot(self) -> Snapshot:
        """All that a picture of now depends on; a copy, for a renderer in any thread."""
        return Snapshot(self.t_ns, self._data.qpos.copy(), self._lamps_out)

    def _moving(self) -> Moving:
        s = self._state
        return Moving(self.t_ns, s.position_world, s.q_world_from_body, s.velocity_world)

    def _control(self) -> None:
        """IMU, estimator, velocity loop, rotors; and the wind until the next time."""
        dt_s = CONTROL_STEPS * TIMESTEP_S
        self._sample_imu()
        if not self.settings.rotors_from_outside:
            estimator = self._estimator
            sensed = Sensed(
                estimator.q, estimator.velocity, estimator.acceleration, estimator.rates
            )
            self._loop, effort = velocity_loop.step(
                self._loop, self._setpoint, sensed, dt_s, self.settings.loop, self._craft
            )
            self._thrusts = self._mixer.thrusts(effort)
        self._body.lift(self._thrusts)
        self._wind_world = self.wind.step(dt_s)
        self._body.push(self.wind.drag(self._wind_world, self._state.velocity_world))

    def _sample_imu(self) -> None:
        """Take the sample of now, once, and carry the estimator on by it."""
        if self._sampled_steps == self._steps:
            return
        dt_s = CONTROL_STEPS * TIMESTEP_S
        self._imu_sample = self._imu.sample(self._sampled, self._state, dt_s)
        self._estimator.propagate(self.t_ns, self._imu_sample)
        self._sampled, self._sampled_steps = self._state, self._steps

    def _sense(self) -> None:
        """What the sensors measure at the end of a step, and what comes out of them."""
        t_ns = self.t_ns
        if t_ns >= self._vio_due_ns:
            self._vio_due_ns += self.settings.vio.period_ns
            self.vio_camera.measure(self._moving())
        while (says := self.vio_camera.due(t_ns)) is not None:
            self._vio_says = says
            if self.settings.feeds_itself:
                self._estimator.feed(says.sample)
        if t_ns >= self._lidar_due_ns:
            self._lidar_due_ns += self.settings.lidar.period_ns
            s = self._state
            self.height = self._down.measure(
                self._data, t_ns, s.position_world, s.q_world_from_body
            )
            self.ahead = self._forward.measure(
                self._data, t_ns, s.position_world, s.q_world_from_body
            )
            if self.settings.feeds_itself:
                self._estimator.feed_range(self.height)


def _tell(warning: str) -> None:
    log.warning("MuJoCo: %s", warning)


def _scaled(v: Vec3, k: float) -> Vec3:
    x, y, z = v
    return k * x, k * y, k * z
