"""From single pictures of a live camera to captures on the drone's clock; no camera in sight."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drone_client.source import Capture
from drone_client.source.clock_map import ClockMap
from drone_client.source.pairing import Pair, Pairer, Unpaired


@dataclass(frozen=True, slots=True)
class Assembling:
    """How pictures of one camera are put together."""

    tolerance_ns: int
    """Colour and depth further apart are not of one exposure."""
    spacing_ns: int
    """Least time between two pictures of one stream."""
    wait_ns: int
    """A colour whose depth does not come goes alone after this."""

    @classmethod
    def of_rate(cls, rate_hz: float, tolerance_ns: int | None = None) -> Assembling:
        """For two streams of one rate.

        A tolerance under half a period makes pairs unambiguous, so that none has to wait for its
        rivals; by default 45 % of it, for two sensors that are not triggered together.
        """
        period_ns = 1e9 / rate_hz
        tolerance = round(0.45 * period_ns) if tolerance_ns is None else tolerance_ns
        return cls(tolerance, round(0.95 * period_ns), round(1.5 * period_ns))


@dataclass(frozen=True, slots=True, eq=False)
class _Arrived:
    """One picture with what is needed when its partner is there."""

    picture: NDArray[Any]
    t_arrival_ns: int


class Assembler:
    """Maps stamps to the drone's clock and pairs by them; not thread-safe, bounded.

    Pairs are found on the device's own clock, where both sensors' stamps are exact, and the pair's
    colour is mapped to the drone's. Captures' times go forward.
    """

    def __init__(self, how: Assembling, name: str) -> None:
        self.clock = ClockMap()
        self._how = how
        self._name = name
        self._number = 0
        self._pairer = self._new_pairer()
        self._last_ns: int | None = None
        self._backwards = 0
        self._paired_before = 0
        self._unpaired_before: dict[str, int] = {}

    def color(
        self, stamp_ticks: int, since_middle_ns: int, t_arrival_ns: int, rgb: NDArray[np.uint8]
    ) -> list[Capture]:
        """A colour picture has come; the captures that are settled by that.

        Args:
            stamp_ticks: device's clock [us], wrapping or not.
            since_middle_ns: from the middle of the exposure to the stamp.
            t_arrival_ns: drone's clock.
            rgb: (H, W, 3).
        """
        t_ns = self._see(stamp_ticks, since_middle_ns, t_arrival_ns)
        arrived = _Arrived(rgb, t_arrival_ns)
        pairs = [] if t_ns is None else self._pairer.add_color(t_ns, arrived)
        return self._captures(pairs + self._overdue(t_arrival_ns))

    def depth(
        self, stamp_ticks: int, since_middle_ns: int, t_arrival_ns: int, units: NDArray[np.uint16]
    ) -> list[Capture]:
        """A depth picture (h, w) has come; as ``color``."""
        t_ns = self._see(stamp_ticks, since_middle_ns, t_arrival_ns)
        arrived = _Arrived(units, t_arrival_ns)
        pairs = [] if t_ns is None else self._pairer.add_depth(t_ns, arrived)
        return self._captures(pairs + self._overdue(t_arrival_ns))

    def restart(self) -> list[Capture]:
        """The camera was opened anew: what waits goes out, and its clock may have any zero."""
        out = self._captures(self._pairer.flush())
        self.clock.reset()
        self._begin_anew()
        return out

    def counts(self) -> dict[str, int]:
        """What became of the pictures, by reason."""
        counts = dict(self._unpaired_before)
        for reason, number in _unpaired(self._pairer):
            counts[reason] = counts.get(reason, 0) + number
        return {
            "paired": self._paired_before + self._pairer.paired,
            **counts,
            "backwards": self._backwards,
            "odd_stamps": self.clock.odd,
            "clock_jumps": self.clock.jumps,
        }

    def _see(self, stamp_ticks: int, since_middle_ns: int, t_arrival_ns: int) -> int | None:
        """Middle of the exposure on the device's clock; None: not known."""
        stamp = self.clock.see(stamp_ticks, t_arrival_ns)
        if stamp.jumped:
            # What still waits is over a second old by now, on a clock that is gone
            self._begin_anew()
        return None if stamp.odd else stamp.t_device_ns - since_middle_ns

    def _overdue(self, t_arrival_ns: int) -> list[Pair[_Arrived, _Arrived]]:
        """What has waited long enough, after a partner that has just come was given its chance."""
        before_ns = self.clock.device_from_drone_ns(t_arrival_ns - self._how.wait_ns)
        return [] if before_ns is None else self._pairer.release(before_ns)

    def _captures(self, pairs: Iterable[Pair[_Arrived, _Arrived]]) -> list[Capture]:
        out = []
        for pair in pairs:
            t_ns = self.clock.drone_from_device_ns(pair.t_color_ns, pair.color.t_arrival_ns)
            if self._last_ns is not None and t_ns <= self._last_ns:
                # The first pictures came late, and the clock's offset is better known by now
                self._backwards += 1
                continue
            self._last_ns = t_ns
            depth = None if pair.depth is None else pair.depth.picture
            out.append(Capture(t_ns, pair.color.picture, depth, f"{self._name}-{self._number}"))
            self._number += 1
        return out

    def _new_pairer(self) -> Pairer[_Arrived, _Arrived]:
        return Pairer(self._how.tolerance_ns, self._how.spacing_ns)

    def _begin_anew(self) -> None:
        self._paired_before += self._pairer.paired
        for reason, number in _unpaired(self._pairer):
            self._unpaired_before[reason] = self._unpaired_before.get(reason, 0) + number
        self._pairer = self._new_pairer()


def _unpaired(pairer: Pairer[Any, Any]) -> list[tuple[str, int]]:
    """Reasons with their stream, and how often."""
    both = (("color", pairer.unpaired_color), ("depth", pairer.unpaired_depth))
    return [
        (f"{stream}_{reason.name.lower()}", counter[reason])
        for stream, counter in both
        for reason in Unpaired
        if counter[reason]
    ]
