"""Wind: a mean, gusts like Dryden's, and the drag by which it is felt.

Dryden's model as in MIL-F-8785C at low altitude: along the wind a first-order, across it
second-order filters of white noise; here each is driven by exact discrete noise, so that the
spread is what the settings say at any step. The scale lengths are those of a space between walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from contact_sim.errors import VehicleError
from contact_sim.noise import normals
from drone_client.bounds import check_bounds
from drone_client.cbf.vector import ZERO, Vec3

_BOUNDS: dict[str, tuple[float, float]] = {
    "gust_share": (0.0, 1.0),
    "length_m": (0.5, 500.0),
    "drag_linear_nspm": (0.0, 5.0),
    "drag_square_ns2pm2": (0.0, 1.0),
}
MAX_WIND_MPS = 20.0
ROUNDING = 1e-9
"""A gust of the largest speed in any direction has that speed, or a last digit more."""


@dataclass(frozen=True, slots=True)
class WindSettings:
    """How it blows, and how much the drone feels of it.

    Raises:
        ValueError: a value is out of its bounds.
    """

    mean_world: Vec3 | None = None
    """[m/s], where it blows to; None: as in the scene."""
    gust_share: float = 0.15
    """Spread of each component, as a share of the mean speed; across the ground half of it."""
    length_m: float = 8.0
    """Size of the eddies."""
    drag_linear_nspm: float = 0.3
    """Of propellers in a flow from aside, and"""
    drag_square_ns2pm2: float = 0.06
    """of the body: together 3.0 N at 5 m/s, which takes a tilt of 5.3 degrees."""

    def __post_init__(self) -> None:
        check_bounds(self, _BOUNDS)
        mean = self.mean_world or ZERO
        if not math.hypot(*mean) <= MAX_WIND_MPS:
            raise ValueError(f"WindSettings.mean_world = {mean} is over {MAX_WIND_MPS:g} m/s")


class Wind:
    """The wind at the drone; stepped by the simulation."""

    def __init__(
        self, settings: WindSettings, rng: np.random.Generator, scene_world: Vec3 = ZERO
    ) -> None:
        """Let it blow.

        Args:
            settings: how.
            rng: where its gusts come from.
            scene_world: mean of the scene's wind [m/s], for settings without one.
        """
        self._settings = settings
        self._normal = normals(rng)
        self.mean_world = scene_world if settings.mean_world is None else settings.mean_world
        x, y, z = self.mean_world
        self._speed_mps = math.hypot(x, y, z)
        level = math.hypot(x, y)
        self._along = (x / level, y / level) if level > 1e-9 else (1.0, 0.0)
        self._spread_mps = settings.gust_share * self._speed_mps
        # Components along, to the left and up; of the latter two also the filter's first stage.
        self._u = self._v = self._w = self._v1 = self._w1 = 0.0
        self._puff: tuple[Vec3, float, float] | None = None
        self._t_s = 0.0

    def gust(self, velocity_world: Vec3, seconds: float) -> None:
        """Add one gust from now on, which comes and goes like ``1 - cos``.

        Args:
            velocity_world: at its strongest [m/s].
            seconds: how long it takes.

        Raises:
            VehicleError: it is stronger than what the model is good for, or takes no time.
        """
        if (
            not math.hypot(*velocity_world) <= MAX_WIND_MPS * (1.0 + ROUNDING)
            or not 0.0 < seconds < math.inf
        ):
            raise VehicleError(
                f"a gust has at most {MAX_WIND_MPS:g} m/s and takes some time, not "
                f"{velocity_world} m/s for {seconds} s"
            )
        self._puff = (velocity_world, self._t_s, seconds)

    def step(self, dt_s: float) -> Vec3:
        """Wind [m/s] in the world, a step later."""
        self._t_s += dt_s
        x, y, z = self.mean_world
        if self._spread_mps > 0.0:
            u, v, w = self._eddies(dt_s)
            c, s = self._along
            x, y, z = x + c * u - s * v, y + s * u + c * v, z + w
        if self._puff is not None:
            (px, py, pz), since_s, seconds = self._puff
            phase = (self._t_s - since_s) / seconds
            if phase >= 1.0:
                self._puff = None
            else:
                k = 0.5 - 0.5 * math.cos(2.0 * math.pi * phase)
                x, y, z = x + k * px, y + k * py, z + k * pz
        return x, y, z

    def drag(self, wind_world: Vec3, velocity_world: Vec3) -> Vec3:
        """Force of the air on the drone [N], in the world."""
        x = wind_world[0] - velocity_world[0]
        y = wind_world[1] - velocity_world[1]
        z = wind_world[2] - velocity_world[2]
        settings = self._settings
        k = settings.drag_linear_nspm + settings.drag_square_ns2pm2 * math.sqrt(
            x * x + y * y + z * z
        )
        return k * x, k * y, k * z

    def _eddies(self, dt_s: float) -> Vec3:
        normal = self._normal
        fade = math.exp(-dt_s * self._speed_mps / self._settings.length_m)
        kick = self._spread_mps * math.sqrt(1.0 - fade * fade)
        self._u = fade * self._u + kick * next(normal)
        self._v1 = fade * self._v1 + kick * next(normal)
        self._w1 = fade * self._w1 + kick * next(normal)
        # (1 + sqrt(3) T s) / (1 + T s)^2 of Dryden's cross components: what the second stage
        # passes, and sqrt(3) of what it holds back; 1/sqrt(2) keeps the spread
        self._v = fade * self._v + (1.0 - fade) * self._v1
        self._w = fade * self._w + (1.0 - fade) * self._w1
        lead = math.sqrt(3.0)
        across = (lead * self._v1 + (1.0 - lead) * self._v) / _CROSS_SPREAD
        up = 0.5 * (lead * self._w1 + (1.0 - lead) * self._w) / _CROSS_SPREAD
        return self._u, across, up


_CROSS_SPREAD = math.sqrt(2.0)
"""Spread of ``sqrt(3) a + (1 - sqrt(3)) b`` for a first-order noise ``a`` of spread one and its
smoothed ``b``: var a = 1, var b = cov(a, b) = 1/2, so 3 + (1 - sqrt 3)^2 / 2 + sqrt 3 (1 - sqrt 3).
"""
