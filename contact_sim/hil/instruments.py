"""What PX4's sensors would say on the simulated drone, in its frame (FRD) and units.

The IMU's sample is the simulation's; compass and barometer are made here, with noise of their own:
PX4 takes a sensor that says the same over and over for a broken one.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from contact_sim.chance import stream
from contact_sim.hil.place import Air, Place, air_at, altitude_of
from contact_sim.noise import normals
from contact_sim.sensing.imu import ImuSample
from drone_client.cbf.vector import Vec3
from rgbd_wire.quaternion import Quaternion, rotate_back

SLOW_NS: Final = 20_000_000
"""From one sample of compass and barometer to the next."""
FIELD_NOISE_GAUSS: Final = 0.0005
PRESSURE_NOISE_HPA: Final = 0.01
"""8 cm of height."""


class Reading(NamedTuple):
    """All that is measured at a moment."""

    t_ns: int
    """Simulated time, the end of the IMU's sample."""
    force_frd: Vec3
    """Specific force [m/s2], mean over the sample: at rest and level (0, 0, -9.81)."""
    rates_frd: Vec3
    """[rad/s], the same."""
    field_frd: Vec3 | None
    """[gauss]; None: not measured now."""
    air: Air | None
    """None: not measured now."""


class Instruments:
    """Makes readings of the true motion."""

    def __init__(self, place: Place, seed: int) -> None:
        self._place = place
        self._field_world = place.field_world
        self._field_noise = normals(stream(seed, "hil_compass"))
        self._air_noise = normals(stream(seed, "hil_barometer"))
        self._due_ns = 0

    def read(self, t_ns: int, imu: ImuSample, q: Quaternion, height_m: float) -> Reading:
        """The reading of now.

        Args:
            t_ns: simulated time.
            imu: the IMU's newest sample.
            q: ``world_from_body``.
            height_m: of the body in the world.
        """
        dt_s = imu.dt_s
        sx, sy, sz = imu.speed_body
        ax, ay, az = imu.angle_body
        field = air = None
        if t_ns >= self._due_ns:
            self._due_ns = t_ns + SLOW_NS
            field, air = self._field(q), self._air(height_m)
        return Reading(
            t_ns,
            frd_from_flu((sx / dt_s, sy / dt_s, sz / dt_s)),
            frd_from_flu((ax / dt_s, ay / dt_s, az / dt_s)),
            field,
            air,
        )

    def _field(self, q: Quaternion) -> Vec3:
        x, y, z = frd_from_flu(rotate_back(q, self._field_world))
        noise, k = self._field_noise, FIELD_NOISE_GAUSS
        return x + k * next(noise), y + k * next(noise), z + k * next(noise)

    def _air(self, height_m: float) -> Air:
        true = air_at(self._place.altitude_m + height_m)
        pressure = true.pressure_hpa + PRESSURE_NOISE_HPA * next(self._air_noise)
        return Air(pressure, altitude_of(pressure), true.temperature_c)


def frd_from_flu(v: Vec3) -> Vec3:
    """A vector of the body with its y to the right and its z down."""
    x, y, z = v
    return x, -y, -z
