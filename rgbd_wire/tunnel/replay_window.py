"""Which numbers were seen already: a sliding window of bits."""

from __future__ import annotations


class ReplayWindow:
    """Takes each number once; numbers that fell out of the window are taken as seen.

    One integer holds the bits: bit i stands for the number ``newest - i``.
    """

    def __init__(self, size: int = 1024) -> None:
        self._size = size
        self._mask = (1 << size) - 1
        self._bits = 0
        self.newest = -1
        """Highest number marked, -1: none."""
        self.count = 0
        """How many numbers were marked."""

    def is_new(self, number: int) -> bool:
        """Not marked yet, and not older than the window reaches."""
        back = self.newest - number
        if back < 0:
            return True
        return back < self._size and not self._bits >> back & 1

    def mark_next(self, count: int) -> None:
        """Remember the ``count`` numbers after the newest one: many for the price of one."""
        if count:
            self._bits = (self._bits << count | (1 << count) - 1) & self._mask
            self.newest += count
            self.count += count

    def mark(self, number: int) -> None:
        """Remember a new number."""
        back = self.newest - number
        if back == -1:  # in order, as nearly always
            self._bits = (self._bits << 1 | 1) & self._mask
            self.newest = number
        elif back < 0:
            self._bits = (self._bits << min(-back, self._size) | 1) & self._mask
            self.newest = number
        else:
            self._bits |= 1 << back
        self.count += 1
