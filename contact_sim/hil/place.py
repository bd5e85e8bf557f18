"""Where on Earth the simulated world stands: its field, its air, and the way to degrees.

It is the place where PX4's own simulations begin (Zurich), so that the table of the Earth's field
inside PX4 says the same as the magnetometer here. The world's origin is at that place; z = 0 is its
height above the sea.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from drone_client.cbf.vector import Vec3

EARTH_RADIUS_M: Final = 6_371_000.0
"""Of the sphere that PX4 projects with."""


class Geodetic(NamedTuple):
    """A place on Earth."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """Above the sea."""


class Air(NamedTuple):
    """What a barometer knows."""

    pressure_hpa: float
    altitude_m: float
    """That the pressure stands for in the standard atmosphere."""
    temperature_c: float


@dataclass(frozen=True, slots=True)
class Place:
    """The origin of the world."""

    latitude_deg: float = 47.397742
    longitude_deg: float = 8.545594
    altitude_m: float = 488.0
    declination_deg: float = 3.3
    """Of the field, east of north, as the World Magnetic Model has it."""
    inclination_deg: float = 63.1
    """How far it points into the ground."""
    strength_gauss: float = 0.482

    @property
    def field_world(self) -> Vec3:
        """The Earth's field [gauss], ENU."""
        declination, inclination = map(math.radians, (self.declination_deg, self.inclination_deg))
        level = self.strength_gauss * math.cos(inclination)
        return (
            level * math.sin(declination),
            level * math.cos(declination),
            -self.strength_gauss * math.sin(inclination),
        )

    def geodetic(self, position_world: Vec3) -> Geodetic:
        """Of a place in the world [m]; the Earth is flat over the few metres of a world."""
        east, north, up = position_world
        round_m = EARTH_RADIUS_M * math.cos(math.radians(self.latitude_deg))
        return Geodetic(
            self.latitude_deg + math.degrees(north / EARTH_RADIUS_M),
            self.longitude_deg + math.degrees(east / round_m),
            self.altitude_m + up,
        )


SEA_PRESSURE_HPA: Final = 1013.25
SEA_TEMPERATURE_K: Final = 288.15
LAPSE_KPM: Final = 0.0065
EXPONENT: Final = 5.255876
"""g M / (R L) of the standard atmosphere."""


def air_at(altitude_m: float) -> Air:
    """The standard atmosphere below 11 km."""
    kelvin = SEA_TEMPERATURE_K - LAPSE_KPM * altitude_m
    return Air(
        SEA_PRESSURE_HPA * math.pow(kelvin / SEA_TEMPERATURE_K, EXPONENT),
        altitude_m,
        kelvin - 273.15,
    )


def altitude_of(pressure_hpa: float) -> float:
    """Height [m] in the standard atmosphere that has a pressure."""
    share = math.pow(pressure_hpa / SEA_PRESSURE_HPA, 1.0 / EXPONENT)
    return SEA_TEMPERATURE_K / LAPSE_KPM * (1.0 - share)
