"""Visual-inertial odometry as of a tracking camera: 200 Hz, smooth, and slowly wrong.

Its world is the true one at the start and drifts from it: by a share of the way flown (a scale that
is constant, and a random walk), by a heading that walks, and a little with time alone. Faults: it
may jump, and it may fall silent. As a source for ROS does, it counts no resets: a jump is for
others to notice.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from contact_sim.errors import VehicleError
from contact_sim.noise import normals
from drone_client.bounds import check_bounds
from drone_client.cbf.vector import Vec3
from drone_client.odometry import OdometrySample
from rgbd_wire.geometry import Pose
from rgbd_wire.quaternion import (
    Quaternion,
    about_up,
    from_vector,
    product,
    rotate,
)

MAX_JUMP_M = 100.0

_BOUNDS: dict[str, tuple[float, float]] = {
    "period_ns": (2_000_000, 200_000_000),
    "latency_ns": (0, 200_000_000),
    "scale": (0.0, 0.1),
    "walk_per_root_m": (0.0, 0.1),
    "walk_per_root_s": (0.0, 0.05),
    "yaw_walk": (0.0, 0.05),
    "yaw_drift_radps": (0.0, 0.05),
    "position_noise_m": (0.0, 0.05),
    "velocity_noise_mps": (0.0, 0.5),
    "attitude_noise_rad": (0.0, 0.05),
}


@dataclass(frozen=True, slots=True)
class VioSettings:
    """Rates and errors; those of a T265 in a place with enough to see.

    Raises:
        ValueError: a value is out of its bounds.
    """

    period_ns: int = 5_000_000
    latency_ns: int = 6_000_000
    """From the moment of a pose until it comes out."""
    scale: float = 0.005
    """Spread of the error of the way's length."""
    walk_per_root_m: float = 0.006
    """Random walk per axis [m / sqrt(m)]: 0.6 % over the first metre, less after."""
    walk_per_root_s: float = 0.0003
    """The same with time [m / sqrt(s)], when it stands."""
    yaw_walk: float = 0.0005
    """Random walk of the heading [rad / sqrt(s)]."""
    yaw_drift_radps: float = 0.0002
    """Spread of the constant drift of the heading: 0.7 degrees a minute."""
    position_noise_m: float = 0.0005
    velocity_noise_mps: float = 0.01
    attitude_noise_rad: float = 0.001

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)


class Moving(NamedTuple):
    """A motion at a moment: the true one, or what the VIO says of it."""

    t_ns: int
    position_world: Vec3
    q_world_from_body: Quaternion
    velocity_world: Vec3

    @property
    def sample(self) -> OdometrySample:
        """As odometry, for whoever takes it: not everybody takes 200 a second."""
        return OdometrySample(
            self.t_ns,
            Pose(np.array(self.position_world), np.array(self.q_world_from_body)),
            np.array(self.velocity_world),
        )


class Vio:
    """Makes samples of the true motion; stepped by the simulation."""

    def __init__(self, settings: VioSettings, rng: np.random.Generator, start: Moving) -> None:
        self.settings = settings
        scale, drift = rng.standard_normal(2).tolist()
        self._scale = 1.0 + settings.scale * scale
        self._yaw_drift_radps = settings.yaw_drift_radps * drift
        self._normal = normals(rng)
        self._silent = False
        self._before = start
        self._position = start.position_world
        self._yaw_rad = 0.0
        self._coming: deque[tuple[int, Moving]] = deque()

    @property
    def yaw_error_rad(self) -> float:
        """By how much its world has turned from the true one."""
        return self._yaw_rad

    def jump(self, by_world: Sequence[float]) -> None:
        """From now on every place is off by this too [m], as after a wrong loop closure.

        Raises:
            VehicleError: they are not three numbers, or absurd ones.
        """
        by = [float(c) for c in by_world]
        if len(by) != 3 or not all(abs(c) <= MAX_JUMP_M for c in by):
            raise VehicleError(
                f"a jump of the VIO is three numbers of at most {MAX_JUMP_M:g} m, not {by_world}"
            )
        x, y, z = self._position
        self._position = (x + by[0], y + by[1], z + by[2])

    def out(self, silent: bool) -> None:
        """Whether it says nothing any more; its world goes on drifting meanwhile."""
        self._silent = silent

    def measure(self, now: Moving) -> None:
        """Take one pose, that will come out after the latency."""
        self._drift(now)
        if self._silent:
            return
        s, normal = self.settings, self._normal
        turn = about_up(self._yaw_rad)
        x, y, z = self._position
        vx, vy, vz = rotate(turn, now.velocity_world)
        k, kp, kv, ka = self._scale, s.position_noise_m, s.velocity_noise_mps, s.attitude_noise_rad
        wobble = from_vector((ka * next(normal), ka * next(normal), ka * next(normal)))
        q = product(wobble, product(turn, now.q_world_from_body))
        said = Moving(
            now.t_ns,
            (x + kp * next(normal), y + kp * next(normal), z + kp * next(normal)),
            q,
            (k * vx + kv * next(normal), k * vy + kv * next(normal), k * vz + kv * next(normal)),
        )
        self._coming.append((now.t_ns + s.latency_ns, said))

    def due(self, now_ns: int) -> Moving | None:
        """The next motion that comes out, once its latency is over; None: there is none."""
        if self._coming and self._coming[0][0] <= now_ns:
            return self._coming.popleft()[1]
        return None

    def _drift(self, now: Moving) -> None:
        before, normal, s = self._before, self._normal, self.settings
        dt_s = (now.t_ns - before.t_ns) * 1e-9
        bx, by, bz = before.position_world
        nx, ny, nz = now.position_world
        x, y, z = rotate(about_up(self._yaw_rad), (nx - bx, ny - by, nz - bz))
        way_m = math.sqrt(x * x + y * y + z * z)
        walk = math.sqrt(s.walk_per_root_m**2 * way_m + s.walk_per_root_s**2 * dt_s)
        k, (px, py, pz) = self._scale, self._position
        self._position = (
            px + k * x + walk * next(normal),
            py + k * y + walk * next(normal),
            pz + k * z + walk * next(normal),
        )
        self._yaw_rad += self._yaw_drift_radps * dt_s + s.yaw_walk * math.sqrt(dt_s) * next(normal)
        self._before = now
