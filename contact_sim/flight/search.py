"""The mission of simulated flights: the worlds begin with the target out of view, maybe."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from drone_client.flight_settings import FlightSettings

SCAN_HALF_RAD: Final = 1.2
"""A drone is off by up to 60 degrees at the start, and sees 40 to each side."""


def searching(parts: FlightSettings) -> FlightSettings:
    """The settings with a search that turns; a pilot would have aimed the drone."""
    mission = replace(parts.control.mission, scan_half_rad=SCAN_HALF_RAD)
    return replace(parts, control=replace(parts.control, mission=mission))
