"""A TUN device in a namespace: whole IP packets by ``read`` and ``write``.

No offload is asked for, so that what the kernel hands over is what would be on the air: packets of
at most the MTU, segments of TCP and of UDP_SEGMENT cut already.
"""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Callable

from link_emulator import netns
from link_emulator.errors import NotPermittedError

DEVICE = "link0"
MTU = 1500
QUEUE_PACKETS = 10_000
"""Between the kernel and the relay: nothing shall be lost there, the relay's own queue decides."""
TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
READ_BYTES = 65536


def open_tun(namespace: str, address: str) -> int:
    """Make the device in a namespace and give its descriptor.

    Args:
        namespace: its name.
        address: with its prefix length, such as ``10.0.0.1/24``.

    Raises:
        NotPermittedError: says what the kernel refused.
    """
    try:
        with netns.inside(namespace):
            fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            request = struct.pack("16sH22x", DEVICE.encode(), IFF_TUN | IFF_NO_PI)
            fcntl.ioctl(fd, TUNSETIFF, request)
    except OSError as error:
        raise NotPermittedError(f"no TUN device: {error.strerror}") from None
    for arguments in (
        # Neighbour and multicast packets of IPv6 would be counted among the traffic
        ("link", "set", DEVICE, "addrgenmode", "none"),
        ("link", "set", DEVICE, "mtu", str(MTU), "txqueuelen", str(QUEUE_PACKETS)),
        ("addr", "add", address, "dev", DEVICE),
        ("link", "set", DEVICE, "up"),
    ):
        netns.ip("-n", namespace, *arguments)
    return fd


def writer(fd: int) -> Callable[[bytes], bool]:
    """A function that hands a packet to the kernel; False: it did not take it."""

    def write(packet: bytes) -> bool:
        try:
            return os.write(fd, packet) == len(packet)
        except OSError:  # the device is going down
            return False

    return write
