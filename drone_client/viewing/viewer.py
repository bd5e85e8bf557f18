"""What shows a flight's moments: a file that a viewer opens, or a server that one connects to."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any, Final, Protocol

from drone_client.errors import OutputError
from drone_client.viewing.moments import Moment, Settled, Ticked

TICK_NUMBERS: Final = ("h_m", "h_robust_m", "delta_m", "target_age_ms", "yaw_rate_radps")
TICK_VECTORS: Final = ("tip_target_m", "command_mps")
ANSWER_NUMBERS: Final = ("network_delay_ms", "age_ms", "service_ms", "d1_ms", "d2_ms", "bytes")


class Viewer(Protocol):
    """Takes moments in the order of time."""

    def show(self, moment: Moment) -> None:
        """Take one."""
        ...

    def close(self) -> None:
        """Finish the file, or the server.

        Raises:
            OutputError: the file could not be written whole.
        """
        ...


class FileViewer(Viewer, Protocol):
    """One that is a file, which has its name only when it is whole."""

    def discard(self) -> None:
        """Give the file up; nothing is left of it."""
        ...


def need(package: str, option: str) -> None:
    """Make sure that a viewer's library is there, without loading it.

    Raises:
        OutputError: it is not.
    """
    if find_spec(package) is None:
        raise OutputError(f"{option} needs package {package}: install aerial-contact[view]")


def tick_numbers(tick: Ticked) -> dict[str, float]:
    """The numbers of a control tick by name; a vector's have its axis at their end."""
    line, numbers = tick.line, {}
    for name in TICK_NUMBERS:
        if isinstance(value := line.get(name), int | float):
            numbers[name] = float(value)
    for name in TICK_VECTORS:
        if isinstance(values := line.get(name), list) and len(values) == 3:
            stem, unit = name.rsplit("_", 1)
            numbers |= {f"{stem}_{a}_{unit}": float(v) for a, v in zip("xyz", values, strict=True)}
    return numbers


def answer_numbers(settled: Settled) -> dict[str, float]:
    """The numbers of a frame's answer by name."""
    line: dict[str, Any] = settled.line
    return {k: float(line[k]) for k in ANSWER_NUMBERS if isinstance(line.get(k), int | float)}
