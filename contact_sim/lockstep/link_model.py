"""What a link does to frames and results in lockstep: the profile's numbers as times.

For real packets there is ``link_emulator``; here a frame is one thing that takes its time. Both
draw from the same profiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from link_emulator.impairments import Impairments
from link_emulator.profiles import Profile

PACKET_BYTES = 1200
REPAIR_SHARE = 0.15
"""So many of a message's packets may be lost: the tunnel's codec makes up for them."""


@dataclass(frozen=True, slots=True)
class Passage:
    """What becomes of a message."""

    arrives_ns: int | None
    """None: it is lost."""


class Way:
    """One direction: messages leave it in order, and wait for one another."""

    def __init__(self, impairments: Impairments, rng: np.random.Generator) -> None:
        self.cut = False
        """Nothing gets through."""
        self.later_ns = 0
        """What a message takes longer than the impairments say."""
        self._impairments = impairments
        self._rng = rng
        self._free_ns = 0
        self._last_ns = 0

    def send(self, size_bytes: int, now_ns: int) -> Passage:
        """Pass a message that is handed over now; never earlier than the one before."""
        i = self._impairments
        jitter_ns = round(self._rng.uniform(0.0, 1.0) * i.jitter_ms * 1e6)
        lost = self._loses(size_bytes)
        if self.cut or i.cut:
            return Passage(None)
        takes_ns = 0 if i.rate_mbit is None else round(8e3 * size_bytes / i.rate_mbit)
        begins_ns = max(now_ns, self._free_ns)
        if begins_ns - now_ns > i.queue_ms * 1e6:
            return Passage(None)
        self._free_ns = begins_ns + takes_ns
        if lost:
            return Passage(None)
        # What was sent first arrives first: jitter holds back, it does not overtake.
        delay_ns = round(i.delay_ms * 1e6) + jitter_ns + self.later_ns
        arrives_ns = max(self._free_ns + delay_ns, self._last_ns)
        self._last_ns = arrives_ns
        return Passage(arrives_ns)

    def _loses(self, size_bytes: int) -> bool:
        """Whether more packets are lost than the codec makes up for; bursts lose many or none."""
        i = self._impairments
        packets = max(1, math.ceil(size_bytes / PACKET_BYTES))
        burst = i.burst or 1.0
        bursts = self._rng.poisson(i.loss / burst * packets)
        lost = sum(float(self._rng.geometric(1.0 / burst)) for _ in range(bursts))
        return lost > REPAIR_SHARE * packets


class LinkModel:
    """Both directions."""

    def __init__(self, profile: Profile, rng: np.random.Generator) -> None:
        up, down = rng.spawn(2)
        self.up = Way(profile.up, up)
        self.down = Way(profile.down, down)

    def cut(self, *, cut: bool) -> None:
        """Cut both ways, or heal them."""
        self.up.cut = self.down.cut = cut

    def slow(self, later_s: float) -> None:
        """Let both ways take so much longer; 0: as the profile says."""
        self.up.later_ns = self.down.later_ns = round(1e9 * later_s)
