"""How many repair symbols go along with a message: from what the receiver lost of late."""

from __future__ import annotations

import math
from collections import deque

MAX_PARITY = 255
"""Of the first round: what fits the byte in the shard's head."""
REMEMBERED = 64
"""Messages: two seconds of frames."""
LOW, START, CROWDED, HIGH = 0.05, 0.10, 0.10, 0.25
"""Parity over data: without loss, before anything is known, most on a full link, most of all."""


class ParityControl:
    """Aims at the second worst message of the last 64, so that nearly every next one gets through.

    Bursts count by themselves: one burst is one message with many symbols lost.
    """

    def __init__(self) -> None:
        self._lost = deque[float](maxlen=REMEMBERED)
        self._worst = 0.0
        self.loss = 0.0
        """Share of symbols that is lost, smoothed over about 16 messages."""
        self.lossy = False
        """Something was lost in these 64."""
        self.rate = START
        """Parity over data of the last message asked for."""

    def on_report(self, received: int, lost: int) -> None:
        """What a receiver counted of one message."""
        share = lost / max(1, received + lost)
        self._lost.append(share)
        # Here and not for each message: what is sent next should leave at once
        ordered = sorted(self._lost)
        self._worst = ordered[-min(2, len(ordered))]
        self.lossy = ordered[-1] > 0
        self.loss += (share - self.loss) / 16

    def symbols(self, data_symbols: int, *, crowded: bool) -> int:
        """Repair symbols for a message.

        Args:
            data_symbols: how many it has itself.
            crowded: the link is nearly full: parity takes what frames need, and a loss is more
                likely a full queue, which parity makes worse.
        """
        if len(self._lost) < 8 and not self.lossy:
            rate = START
        elif not self.lossy:
            rate = 0.0 if crowded else LOW
        else:
            wanted = self._worst / max(1.0 - self._worst, 0.5) + 2.0 / data_symbols
            rate = min(max(wanted, LOW), CROWDED if crowded else HIGH)
        count = math.ceil(data_symbols * rate - 1e-9)
        self.rate = count / data_symbols
        return min(count, MAX_PARITY)
