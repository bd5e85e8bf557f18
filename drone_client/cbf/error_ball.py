"""How far the true tip may be from the estimated one (docs/cbf.md, section 3)."""

from __future__ import annotations

from drone_client.cbf.settings import FilterSettings

OLDEST_NS = 10**12
"""Growth stops being counted here: the drone has long retreated, by a rule without delta."""


def error_ball_m(
    age_ns: int,
    range_m: float,
    sigma_m: float,
    settings: FilterSettings,
    unconfirmed_ns: int = 0,
) -> float:
    """Radius [m] of the ball around the estimated tip that holds the true one.

    Anything up to ``age_max_ns`` counts as ``age_max_ns``: while results keep coming the ball then
    has a constant size, and neither jumps with each result nor asks for a retreat between two.

    Args:
        age_ns: Age of the measurement [ns].
        range_m: Distance from the camera to the target when it was measured [m].
        sigma_m: Standard deviation of the measured position [m], along its worst direction.
        settings: The filter's.
        unconfirmed_ns: How long nobody but the drone itself has seen the target [ns]; 0: the
            measurement is the edge's. Up to ``age_max_ns`` it counts for nothing, as above.
    """
    # The order of the arguments makes max() and min() drop a NaN.
    age_s = min(OLDEST_NS, max(settings.age_max_ns, age_ns)) / 1e9
    alone_s = min(OLDEST_NS, max(0, unconfirmed_ns - settings.age_max_ns)) / 1e9
    return (
        settings.delta_base_m
        + settings.delta_range_gain * range_m
        + settings.sigma_gain * sigma_m
        + settings.drift_mps * age_s
        + settings.unconfirmed_mps * alone_s
    )
