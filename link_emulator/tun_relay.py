"""The relay between two TUN devices."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass

from link_emulator.lane import Lane
from link_emulator.loop import TURN, Loop
from link_emulator.path import Path
from link_emulator.tun import READ_BYTES, open_tun, writer


@dataclass(frozen=True, slots=True)
class TunEnds:
    """Where the two devices are."""

    namespace_a: str
    address_a: str
    """With its prefix length."""
    namespace_b: str
    address_b: str


def make_tun_relay(ends: TunEnds, up: Path, down: Path) -> tuple[Loop, Lane[bytes], Lane[bytes]]:
    """Make both devices; the loop and the lanes from a to b and back.

    Raises:
        NotPermittedError: says what the kernel refused.
    """
    fd_a = open_tun(ends.namespace_a, ends.address_a)
    fd_b = open_tun(ends.namespace_b, ends.address_b)
    up_lane = Lane(up, writer(fd_b), time.monotonic_ns)
    down_lane = Lane(down, writer(fd_a), time.monotonic_ns)
    loop = Loop((up_lane, down_lane))
    loop.add(fd_a, _reader(fd_a, up_lane))
    loop.add(fd_b, _reader(fd_b, down_lane))
    return loop, up_lane, down_lane


def _reader(fd: int, lane: Lane[bytes]) -> Callable[[], None]:
    read, offer, now_ns = os.read, lane.offer, time.monotonic_ns

    def on_readable() -> None:
        for _ in range(TURN):
            try:
                packet = read(fd, READ_BYTES)
            except OSError:  # nothing more, or the device is going down
                return
            offer(packet, len(packet), now_ns())

    return on_readable
