"""Links as people know them, by name: what a drone meets between itself and the edge."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final, NamedTuple

from link_emulator.errors import ImpairmentError
from link_emulator.impairments import Impairments


class Profile(NamedTuple):
    """Both directions of a link."""

    up: Impairments
    """From the drone."""
    down: Impairments


PROFILES: Final = MappingProxyType(
    {
        "lan": Profile(
            Impairments(rate_mbit=900.0, delay_ms=0.3, jitter_ms=0.2),
            Impairments(rate_mbit=900.0, delay_ms=0.3, jitter_ms=0.2),
        ),
        # A lightly used 802.11ac cell: the air is shared, retries show as jitter, little is lost
        "wifi": Profile(
            Impairments(rate_mbit=40.0, delay_ms=2.0, jitter_ms=6.0, loss=0.002, burst=3.0),
            Impairments(rate_mbit=40.0, delay_ms=2.0, jitter_ms=6.0, loss=0.002, burst=3.0),
        ),
        # A public cell: uplink slots cost time, the core network adds some
        "5g": Profile(
            Impairments(rate_mbit=25.0, delay_ms=14.0, jitter_ms=8.0, loss=0.001, burst=2.0),
            Impairments(rate_mbit=80.0, delay_ms=8.0, jitter_ms=4.0, loss=0.001, burst=2.0),
        ),
        # The edge of the cell: slow, late, losing in bursts
        "bad": Profile(
            Impairments(rate_mbit=6.0, delay_ms=25.0, jitter_ms=25.0, loss=0.03, burst=5.0),
            Impairments(rate_mbit=6.0, delay_ms=25.0, jitter_ms=25.0, loss=0.03, burst=5.0),
        ),
    }
)
"""Orders of magnitude, not measurements of a place: measure your own, and give it by hand."""


def profile(name: str) -> Profile:
    """A profile by its name.

    Raises:
        ImpairmentError: there is none of that name.
    """
    if name not in PROFILES:
        raise ImpairmentError(f"no link {name!r}; there are: {', '.join(PROFILES)}")
    return PROFILES[name]
