"""What one direction of a link does to packets, as a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from math import isfinite
from typing import Any

from link_emulator.errors import ImpairmentError

MAX_MS = 3_600_000.0
MAX_RATE_MBIT = 100_000.0
MIN_RATE_MBIT = 0.001


@dataclass(frozen=True, slots=True)
class Impairments:
    """One direction. The defaults are a perfect link.

    Raises:
        ImpairmentError: a value is out of bounds, or two do not go together.
    """

    rate_mbit: float | None = None
    """Serial rate [Mbit/s] of whole IP packets; None: no limit."""
    queue_ms: float = 100.0
    """Drop-tail queue in front of the rate, as the time it takes to drain."""
    queue_bytes: int | None = None
    """The same in bytes; goes before ``queue_ms``."""
    delay_ms: float = 0.0
    """Of every packet, after the queue."""
    jitter_ms: float = 0.0
    """On top of the delay, uniform from 0 to this."""
    reorder: bool = False
    """Let jitter put packets out of order; otherwise one waits for the one before it."""
    loss: float = 0.0
    """Mean share of packets that are lost, after the queue: they have used the rate up."""
    burst: float | None = None
    """Mean number of packets lost in a row (Gilbert-Elliott); None: each by itself."""
    cut: bool = False
    """A partition: nothing that enters or would leave now gets through."""
    cuts_ms: tuple[tuple[float, float], ...] = ()
    """Planned partitions, from and to, counted from the start of the link."""

    def __post_init__(self) -> None:
        if self.rate_mbit is not None:
            _within("rate_mbit", self.rate_mbit, MIN_RATE_MBIT, MAX_RATE_MBIT)
        for name in ("queue_ms", "delay_ms", "jitter_ms"):
            _within(name, getattr(self, name), 0, MAX_MS)
        if self.queue_bytes is not None:
            _within("queue_bytes", self.queue_bytes, 0, 1 << 40)
        _within("loss", self.loss, 0, 1)
        if self.burst is not None:
            _within("burst", self.burst, 1, 1e6)
            if not 0 < self.loss < 1:
                raise ImpairmentError(
                    f"burst is {self.burst:g} and loss {self.loss:g}: a burst needs a loss between "
                    "0 and 1"
                )
            longest = self.burst * (1 - self.loss)
            if self.loss > longest:
                raise ImpairmentError(
                    f"loss {self.loss:g} in bursts of {self.burst:g} cannot be: between two bursts "
                    f"is at least one packet, so loss is at most {self.burst / (1 + self.burst):g}"
                )
        for cut in self.cuts_ms:
            if not (len(cut) == 2 and 0 <= cut[0] <= cut[1] <= MAX_MS):
                raise ImpairmentError(f"cuts_ms has {cut}: from and to [ms], 0 <= from <= to")

    def changed(self, changes: Mapping[str, Any]) -> Impairments:
        """A copy with other values, as they come out of JSON.

        Raises:
            ImpairmentError: a name or a value is wrong.
        """
        names = {f.name: str(f.type) for f in fields(self)}
        for name, value in changes.items():
            if name not in names:
                raise ImpairmentError(f"no impairment {name!r}; there are {', '.join(names)}")
            _check_type(name, names[name], value)
        given = dict(changes)
        if "cuts_ms" in given:
            given["cuts_ms"] = tuple(tuple(cut) for cut in given["cuts_ms"])
        if given.get("loss") == 0 and "burst" not in given:
            given["burst"] = None  # "no loss" shall be one change, not two
        return replace(self, **given)

    def as_json(self) -> dict[str, Any]:
        """All values, for JSON."""
        return asdict(self)


def _within(name: str, value: float, low: float, high: float) -> None:
    if not (isfinite(value) and low <= value <= high):
        raise ImpairmentError(f"{name} is {value:g}; it lies between {low:g} and {high:g}")


def _check_type(name: str, kind: str, value: Any) -> None:
    if name == "cuts_ms":
        pairs = isinstance(value, list | tuple) and all(
            isinstance(cut, list | tuple) and all(_is_number(v) for v in cut) for cut in value
        )
        is_right = pairs
    elif kind == "bool":
        is_right = isinstance(value, bool)
    else:
        is_right = (_is_number(value) and (isinstance(value, int) or "float" in kind)) or (
            value is None and "None" in kind
        )
    if not is_right:
        raise ImpairmentError(f"{name} is {value!r}; it is a {kind}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
