"""How old the knowledge of the target is, and what that allows (docs/cbf.md, section 8)."""

from __future__ import annotations

from enum import StrEnum

from drone_client.cbf.settings import FilterSettings


class Freshness(StrEnum):
    """Phases that a drone goes through as a link goes silent."""

    FRESH = "fresh"
    """Close in."""
    HOLD = "hold"
    """Come no closer; keep aligned with what was last known, while the error ball grows."""
    BRAKE = "brake"
    """Stop; back off as far as the growing error ball asks."""
    RETREAT = "retreat"
    """Back off to the stand-off distance and wait there."""


def freshness(age_ns: int, settings: FilterSettings) -> Freshness:
    """Phase for knowledge of the target of this age [ns], on the drone's clock.

    An age that cannot be (negative, or NaN) is a broken clock: BRAKE.
    """
    if 0 <= age_ns <= settings.age_max_ns:
        return Freshness.FRESH
    if settings.age_max_ns < age_ns <= settings.hold_ns:
        return Freshness.HOLD
    if age_ns > settings.retreat_ns:
        return Freshness.RETREAT
    return Freshness.BRAKE
