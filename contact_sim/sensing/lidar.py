"""A one-dimensional lidar: one ray into the world, 100 Hz, a centimetre of noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from contact_sim.errors import VehicleError
from contact_sim.noise import normals
from contact_sim.scene import SEEN_GROUP
from drone_client.bounds import check_bounds
from drone_client.cbf.vector import Vec3
from drone_client.odometry import RangeSample
from rgbd_wire.quaternion import Quaternion, rotate

PAST_M: Final = 1e-6
"""So far behind the surface of an own part the beam goes on."""

_BOUNDS: dict[str, tuple[float, float]] = {
    "period_ns": (2_000_000, 1_000_000_000),
    "min_m": (0.0, 1.0),
    "max_m": (1.0, 200.0),
    "noise_m": (0.0, 0.2),
}


@dataclass(frozen=True, slots=True)
class LidarSettings:
    """Those of a TF-mini.

    Raises:
        ValueError: a value is out of its bounds.
    """

    period_ns: int = 10_000_000
    min_m: float = 0.1
    max_m: float = 12.0
    noise_m: float = 0.01

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)


class Lidar:
    """One beam, fixed to the drone; sees everything that is drawn but the drone's own parts.

    Of what does not move against the body MuJoCo itself keeps the beam free; the arm, which some
    airframes have right before it, is passed surface by surface.
    """

    def __init__(
        self,
        settings: LidarSettings,
        rng: np.random.Generator,
        model: mujoco.MjModel,
        site: str,
        *,
        looks_down: bool,
    ) -> None:
        """Sit at a site of the drone.

        Args:
            settings: its range and noise.
            rng: draws the noise.
            model: with the drone in it.
            site: where the beam begins.
            looks_down: along the body's -z; otherwise along its x.

        Raises:
            VehicleError: the model has no such site.
        """
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
        if number < 0:
            raise VehicleError(f"the model has no site {site!r} for a lidar; add_drone makes it")
        self.settings = settings
        self._model = model
        self._normal = normals(rng)
        self._looks_down = looks_down
        x, y, z = model.site_pos[number].tolist()
        self._place_body: Vec3 = (x, y, z)
        self._beam_body: Vec3 = (0.0, 0.0, -1.0) if looks_down else (1.0, 0.0, 0.0)
        self._body = int(model.site_bodyid[number])
        roots = model.body_rootid
        self._own: list[bool] = (roots[model.geom_bodyid] == roots[self._body]).tolist()
        # into each own part and out of it, and what is behind all of them
        self._looks = 2 * sum(self._own) + 1
        self._groups = np.array([g == SEEN_GROUP for g in range(6)], dtype=np.uint8)
        self._hit = np.zeros(1, dtype=np.int32)
        self._origin = np.zeros(3)
        self._along = np.zeros(3)

    def measure(
        self, data: mujoco.MjData, t_ns: int, position_world: Vec3, q_world_from_body: Quaternion
    ) -> RangeSample:
        """The distance now; 0 where it sees nothing, as many lidars say it.

        Args:
            data: where everything else stands.
            t_ns: simulated time.
            position_world: of the drone's body [m].
            q_world_from_body: its attitude.
        """
        s = self.settings
        x, y, z = rotate(q_world_from_body, self._place_body)
        px, py, pz = position_world
        origin, along = self._origin, self._along
        origin[0], origin[1], origin[2] = px + x, py + y, pz + z
        along[0], along[1], along[2] = rotate(q_world_from_body, self._beam_body)
        way_m = self._look(data)
        noisy_m = way_m + s.noise_m * next(self._normal)
        seen = way_m >= 0.0 and s.min_m <= noisy_m <= s.max_m
        return RangeSample(
            t_ns, noisy_m if seen else 0.0, s.min_m, s.max_m, looks_down=self._looks_down
        )

    def _look(self, data: mujoco.MjData) -> float:
        """The way to the first thing that is no own part [m]; negative: there is none."""
        passed_m = 0.0
        for _ in range(self._looks):
            way_m: float = mujoco.mj_ray(
                self._model,
                data,
                self._origin,
                self._along,
                self._groups,
                1,
                self._body,
                self._hit,
            )
            if way_m < 0.0:
                break
            if not self._own[self._hit[0]]:
                return passed_m + way_m
            passed_m += way_m + PAST_M
            self._origin += (way_m + PAST_M) * self._along
        return -1.0
