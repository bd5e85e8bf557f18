"""What a run has counted so far, for the progress line and the summary."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class Tally:
    """Counts of a run so far."""

    verdicts: Counter[str] = field(default_factory=Counter)
    outcomes: Counter[str] = field(default_factory=Counter)
    statuses: Counter[str] = field(default_factory=Counter)
    late_results: int = 0
    """Results of frames that had been given up on."""
    onboard: int = 0
    """Poses that were seen on board."""
    control_errors: int = 0
    receive_errors: int = 0
    """Messages whose handling went wrong; the log has the first."""
