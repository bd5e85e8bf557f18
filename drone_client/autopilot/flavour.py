"""What differs from one kind of autopilot to the next: modes, and which messages are asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Flavour:
    """One kind of autopilot."""

    name: str
    autopilot: int
    """MAV_AUTOPILOT in its heartbeat."""
    taking_mode: str
    """Name of the mode that takes commands."""
    take: tuple[int, int]
    """Main and sub mode of DO_SET_MODE for it."""
    hold: tuple[int, int]
    """Of the mode that holds the position by itself."""
    mode_name: Callable[[int], str]
    """Name, as pilots know it, of a heartbeat's ``custom_mode``."""
    rates_hz: Mapping[int, float]
    """Message ids that are asked for, and how often."""
    parameter_file: str
    """The packaged one."""
    bytewise_parameters: bool
    """Integer parameters come as their bytes in a float's place, not as a float."""
