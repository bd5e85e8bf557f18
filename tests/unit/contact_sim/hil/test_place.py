"""The Earth around the simulated world, against tables and the sphere."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.hil.place import EARTH_RADIUS_M, Place, air_at, altitude_of

PLACE = Place()
metres = st.floats(-50.0, 50.0)


@pytest.mark.parametrize(
    ("altitude_m", "pressure_hpa", "temperature_c"),
    [(0.0, 1013.25, 15.0), (1000.0, 898.76, 8.5), (2000.0, 795.01, 2.0), (5000.0, 540.20, -17.5)],
)
def test_the_air_is_the_standard_atmosphere(altitude_m, pressure_hpa, temperature_c):
    """Rows of its table (ISO 2533)."""
    air = air_at(altitude_m)
    assert air.pressure_hpa == pytest.approx(pressure_hpa, rel=1e-3)
    assert air.temperature_c == pytest.approx(temperature_c)


@given(st.floats(-500.0, 9000.0))
def test_a_pressure_tells_its_height(altitude_m):
    """And back."""
    assert altitude_of(air_at(altitude_m).pressure_hpa) == pytest.approx(altitude_m, abs=1e-6)


def test_the_field_points_north_and_into_the_ground():
    """East, north and up of it give back its declination, inclination and strength."""
    east, north, up = PLACE.field_world
    assert math.hypot(east, north, up) == pytest.approx(PLACE.strength_gauss)
    assert math.degrees(math.atan2(east, north)) == pytest.approx(PLACE.declination_deg)
    dip = math.degrees(math.atan2(-up, math.hypot(east, north)))
    assert dip == pytest.approx(PLACE.inclination_deg)
    assert up < 0.0 < north


@given(metres, metres, metres)
def test_degrees_are_where_the_metres_are(east, north, up):
    """By the haversine formula on PX4's sphere, to a tenth of a millimetre."""
    at = PLACE.geodetic((east, north, up))
    assert at.altitude_m == pytest.approx(PLACE.altitude_m + up)
    a, b = math.radians(PLACE.latitude_deg), math.radians(at.latitude_deg)
    lon = math.radians(at.longitude_deg - PLACE.longitude_deg)
    half = math.sin((b - a) / 2) ** 2 + math.cos(a) * math.cos(b) * math.sin(lon / 2) ** 2
    way = 2 * EARTH_RADIUS_M * math.asin(math.sqrt(half))
    # of 70 m the meridians' convergence takes less than a millimetre
    assert way == pytest.approx(math.hypot(east, north), abs=1e-3)
    assert math.copysign(1.0, b - a) == math.copysign(1.0, north) or abs(north) < 1e-6
    assert math.copysign(1.0, lon) == math.copysign(1.0, east) or abs(east) < 1e-6
