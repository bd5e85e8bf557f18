"""How a frame is coded, so that it takes a third of tau_max at most to get onto the wire.

A ladder of encodings, best first. The first rung whose predicted serialisation fits is taken: down
at once, up only after it would have fitted with room to spare for a while. Bytes of a rung are what
it weighed lately; a rung that was not used yet is scaled from one that was.

Pure: time is an argument.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rgbd_wire.depth import Step

BYTES_PER_PIXEL = {1: 1.0, 2: 1.55, 4: 2.1}
"""Of lossless depth, by the step between its pixels, against full resolution: the farther apart,
the less one tells of the next. Measured by ``scripts/bench codec``; a start value only."""


@dataclass(frozen=True, slots=True)
class Rung:
    """One encoding of the ladder."""

    name: str
    jpeg_quality: int
    depth_step: Step
    """1: depth at full resolution everywhere; 2 or 4: that is the step outside the region of
    interest, which stays full."""
    color_weight: float
    """Bytes of its colour picture against quality 80: only until it has been weighed."""
    region: bool = True
    """Around the target depth is at full resolution."""

    def depth_weight(self, region_share: float) -> float:
        """Bytes of its depth against all of it, with a region of that share of the picture."""
        fine = region_share if self.region else 0.0
        step = self.depth_step
        return fine + (1.0 - fine) * BYTES_PER_PIXEL[step] / step**2


LADDER = (
    Rung("full", 80, 1, 1.0),
    Rung("full-q65", 65, 1, 0.70),
    Rung("half", 70, 2, 0.77),
    Rung("quarter", 60, 4, 0.65),
    Rung("quarter-q45", 45, 4, 0.53),
    Rung("quarter-q25", 25, 4, 0.37),
    Rung("bare-q20", 20, 4, 0.32, region=False),
)
"""Colour goes first, since a detector hardly minds quality 65; then depth that nobody looks at; the
last is for a link on which nothing else gets through."""


class Reason(StrEnum):
    """Why a rung was chosen."""

    UNKNOWN_LINK = "unknown_link"
    """No ack yet: the best."""
    FITS = "fits"
    """The best rung that fits, and the best of all."""
    SLOW_LINK = "slow_link"
    """The best rung that fits; better ones do not."""
    WAITS = "waits"
    """A better one fits, but not for long enough, or not with room to spare."""
    TOO_SLOW = "too_slow"
    """Not even the leanest fits: it goes all the same."""
    FIXED = "fixed"
    """Rate control is off."""


@dataclass(frozen=True, slots=True)
class RateSettings:
    """What the ladder is held to."""

    serialisation_max_ns: int
    """A third of tau_max."""
    enabled: bool = True
    best_quality: int = 80
    """Of JPEG on the best rung; no other goes above it."""
    headroom: float = 0.8
    """A better rung has to fit into so much of the bound ..."""
    patience_ns: int = 1_000_000_000
    """... for so long."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A rung, and what it rests on."""

    rung: Rung
    jpeg_quality: int
    reason: Reason
    predicted_bytes: int | None
    predicted_ns: int | None
    goodput_bytes_per_s: float | None
    region_share: float = 0.0
    """Of the depth picture, that the region of interest has."""

    def record(self) -> dict[str, Any]:
        """For the ledger: what was chosen and why."""
        goodput, predicted_ns = self.goodput_bytes_per_s, self.predicted_ns
        return {
            "rung": self.rung.name,
            "reason": self.reason.value,
            "jpeg_quality": self.jpeg_quality,
            "goodput_mbps": None if goodput is None else round(goodput * 8e-6, 3),
            "predicted_bytes": self.predicted_bytes,
            "predicted_ms": None if predicted_ns is None else round(predicted_ns / 1e6, 3),
        }


class RateController:
    """Keeps what each rung weighs, and when a better one began to fit."""

    def __init__(self, settings: RateSettings, ladder: tuple[Rung, ...] = LADDER) -> None:
        self._settings = settings
        self._ladder = ladder
        self._color_bytes: dict[int, float] = {}
        """Weighed, smoothed, by the rung's place, for a weight of 1: that of quality 80."""
        self._depth_bytes: dict[int, float] = {}
        """Likewise, of all the depth at full resolution."""
        self._at = 0
        self._fits_since_ns: int | None = None
        self._region_share = 0.0

    def choose(
        self, now_ns: int, goodput_bytes_per_s: float | None, region_share: float = 0.0
    ) -> Choice:
        """The rung for the next frame.

        Args:
            now_ns: drone's clock.
            goodput_bytes_per_s: of messages, whatever the transport adds to them; None: unknown.
            region_share: share of the depth picture that the region of interest would have.
        """
        self._region_share = region_share
        if not self._settings.enabled:
            return self._choice(0, Reason.FIXED, goodput_bytes_per_s)
        if goodput_bytes_per_s is None or not self._color_bytes:
            return self._choice(self._at, Reason.UNKNOWN_LINK, goodput_bytes_per_s)
        bound_ns = self._settings.serialisation_max_ns
        times_ns = [
            1e9 * b / goodput_bytes_per_s for b in map(self._bytes, range(len(self._ladder)))
        ]
        fitting = [i for i, t in enumerate(times_ns) if t <= bound_ns]
        if not fitting:
            return self._go(len(self._ladder) - 1, Reason.TOO_SLOW, goodput_bytes_per_s)
        best = fitting[0]
        if best >= self._at:
            reason = Reason.SLOW_LINK if best else Reason.FITS
            return self._go(best, reason, goodput_bytes_per_s)
        roomy = [i for i in fitting if times_ns[i] <= self._settings.headroom * bound_ns]
        if not roomy or roomy[0] >= self._at:
            # It fits, but barely: the rung in use stays, and the wait begins anew
            self._fits_since_ns = None
            return self._choice(self._at, Reason.WAITS, goodput_bytes_per_s)
        if self._fits_since_ns is None:
            self._fits_since_ns = now_ns
        if now_ns - self._fits_since_ns < self._settings.patience_ns:
            return self._choice(self._at, Reason.WAITS, goodput_bytes_per_s)
        reason = Reason.SLOW_LINK if roomy[0] else Reason.FITS
        return self._go(roomy[0], reason, goodput_bytes_per_s)

    def weighed(self, choice: Choice, color_bytes: int, depth_bytes: int) -> None:
        """What a frame of a choice came to."""
        at = self._ladder.index(choice.rung)
        depth_weight = choice.rung.depth_weight(choice.region_share)
        for known, new in (
            (self._color_bytes, color_bytes / choice.rung.color_weight),
            (self._depth_bytes, depth_bytes / depth_weight),
        ):
            known[at] = new if at not in known else known[at] + 0.3 * (new - known[at])

    def _go(self, at: int, reason: Reason, goodput: float | None) -> Choice:
        self._at, self._fits_since_ns = at, None
        return self._choice(at, reason, goodput)

    def _choice(self, at: int, reason: Reason, goodput: float | None) -> Choice:
        rung = self._ladder[at]
        known = bool(self._color_bytes)
        size = round(self._bytes(at)) if known else None
        time_ns = None if size is None or not goodput else round(1e9 * size / goodput)
        best = self._settings.best_quality
        quality = best if at == 0 else min(rung.jpeg_quality, best)
        return Choice(rung, quality, reason, size, time_ns, goodput, self._region_share)

    def _bytes(self, at: int) -> float:
        """Predicted bytes of a frame on a rung: never less than on a leaner one."""
        return max(self._raw_bytes(i) for i in range(at, len(self._ladder)))

    def _raw_bytes(self, at: int) -> float:
        rung = self._ladder[at]
        color = rung.color_weight * self._of(self._color_bytes, at)
        return color + rung.depth_weight(self._region_share) * self._of(self._depth_bytes, at)

    def _of(self, known: dict[int, float], at: int) -> float:
        """As weighed on this rung, else on the nearest one."""
        return known[at] if at in known else known[min(known, key=lambda i: abs(i - at))]
