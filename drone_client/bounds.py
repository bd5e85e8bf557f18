"""Numbers of a settings value within their bounds; NaN is in none."""

from __future__ import annotations

from collections.abc import Mapping

Bounds = Mapping[str, tuple[float, float]]


def check_bounds(settings: object, bounds: Bounds, what: str = "") -> None:
    """Check fields against the least and the most that they may be.

    Args:
        settings: has the fields.
        bounds: by name.
        what: stands before a field's name in the error; empty: the settings' class and a dot.

    Raises:
        ValueError: names the first field at fault, its value and what it may be.
    """
    prefix = what or f"{type(settings).__name__}."
    for name, (low, high) in bounds.items():
        value = getattr(settings, name)
        if not low <= value <= high:
            raise ValueError(f"{prefix}{name} = {value} is not in [{low:g}, {high:g}]")
