"""What a relay says of its work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from link_emulator.histogram import Histogram

MARK_MS = 0.3
"""A relay whose p99 is worse has not been the link that it was asked to be."""


@dataclass(frozen=True, slots=True)
class DirectionReport:
    """One direction since the start or the last reset."""

    passed: int
    """Packets that came out."""
    passed_bytes: int
    dropped: dict[str, int]
    """By reason: queue_full, lost, cut; and not_sent, which the far side did not take."""
    waiting: int
    """Packets that are in the relay now."""


@dataclass(frozen=True, slots=True)
class Report:
    """Both directions, and how exact the relay was."""

    up: DirectionReport
    down: DirectionReport
    released: int
    """Packets that the errors are of."""
    release_error_p50_ms: float
    """When packets left, minus when they should have; never negative."""
    release_error_p99_ms: float
    release_error_max_ms: float
    scheduling: str
    """What the kernel granted the relay: fifo, nice or plain."""
    cpu_s: float
    """Processor time of the relay since its start."""

    @property
    def marked(self) -> bool:
        """The run was less exact than 0.3 ms at p99: do not trust its times."""
        return self.release_error_p99_ms > MARK_MS

    def as_json(self) -> dict[str, Any]:
        """For people's scripts."""
        return asdict(self) | {"marked": self.marked}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Report:
        """The other way round."""
        given = {k: v for k, v in data.items() if k != "marked"}
        for direction in ("up", "down"):
            given[direction] = DirectionReport(**given[direction])
        return cls(**given)

    def __str__(self) -> str:
        mark = f"  MARKED: p99 over {MARK_MS} ms, do not trust the times" if self.marked else ""
        lines = [
            f"release error  p50 {self.release_error_p50_ms:.3f}  "
            f"p99 {self.release_error_p99_ms:.3f}  max {self.release_error_max_ms:.3f} ms "
            f"of {self.released} packets, scheduling {self.scheduling}, "
            f"{self.cpu_s:.2f} s of CPU{mark}"
        ]
        for name, d in (("up", self.up), ("down", self.down)):
            dropped = ", ".join(f"{n} {reason}" for reason, n in d.dropped.items() if n)
            lines.append(
                f"{name:5} passed {d.passed} ({d.passed_bytes} bytes)  dropped {dropped or 'none'}"
                f"  waiting {d.waiting}"
            )
        return "\n".join(lines)


def make_report(
    up: DirectionReport, down: DirectionReport, errors: Histogram, scheduling: str, cpu_s: float
) -> Report:
    """A report from what was counted."""
    return Report(
        up,
        down,
        errors.total,
        errors.quantile_ns(0.5) / 1e6,
        errors.quantile_ns(0.99) / 1e6,
        errors.max_ns / 1e6,
        scheduling,
        cpu_s,
    )
