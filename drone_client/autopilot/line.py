"""The line to the autopilot: UDP or serial. Writing never blocks, and drops whole messages.

``udp/HOST:PORT`` listens there and answers whoever our autopilot turns out to be: PX4's simulator
and most companion links send by themselves. ``udpout/HOST:PORT`` speaks first. ``serial/DEV:BAUD``
is a UART or USB.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import threading
from dataclasses import dataclass
from typing import Protocol

import serial

from drone_client.errors import AutopilotError
from rgbd_wire.hosts import resolve

READ_MAX = 4096
QUEUE_MAX_S = 0.03
"""What waits in a serial line's buffer is late; more than this much time of it is not queued."""
QUEUE_MIN_BYTES = 600
Source = tuple[str, int] | None
"""Who sent it; None: the other end of a wire."""


@dataclass(frozen=True, slots=True)
class Received:
    """Bytes, and from whom."""

    data: bytes
    source: Source


class Line(Protocol):
    """Both directions. Nothing but ``read`` waits, and nothing raises."""

    is_datagram: bool
    """Each ``read`` gives whole messages."""
    dropped: int
    """Messages that could not be sent."""

    def read(self, timeout_s: float) -> Received | None:
        """What came; None: nothing within the time."""
        ...

    def write(self, message: bytes) -> bool:
        """Send a whole message, or drop it; False: dropped."""
        ...

    def answer_to(self, source: Source) -> None:
        """From now on send there."""
        ...

    def close(self) -> None:
        """Close it."""
        ...


class UdpLine:
    """A UDP socket.

    Raises:
        AutopilotError: the address is not one of this machine, is taken, or cannot be resolved.
    """

    is_datagram = True

    def __init__(self, host: str, port: int, *, speak_first: bool) -> None:
        """Open the socket.

        Args:
            host: of this machine to listen on, or the autopilot's.
            port: there.
            speak_first: send to that address instead of listening on it.
        """
        self.dropped = 0
        name = f"{'udpout' if speak_first else 'udp'}/{host}:{port}"
        try:
            family, _, _, _, address = resolve(host, port)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
        except OSError as error:
            raise AutopilotError(f"{name}: {host} cannot be resolved ({error})") from None
        self._peer: tuple[str, int] | None = None
        try:
            self._socket.setblocking(False)
            if speak_first:
                self._peer = (str(address[0]), int(address[1]))
            else:
                self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise AutopilotError(f"{name}: {_why_not(error, host, port)}") from None

    def read(self, timeout_s: float) -> Received | None:
        """A datagram; None: none within the time, or the socket is closed."""
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return None
            data, source = self._socket.recvfrom(READ_MAX)
        except (OSError, ValueError):
            # An ICMP "port unreachable" of what was sent, or closed in another thread
            return None
        return Received(data, (str(source[0]), int(source[1])))

    def write(self, message: bytes) -> bool:
        """Send a datagram; False: nobody is known yet, or the system's buffer is full."""
        if self._peer is None:
            return False
        try:
            self._socket.sendto(message, self._peer)
        except OSError:
            self.dropped += 1
            return False
        return True

    def answer_to(self, source: Source) -> None:
        """From now on send there."""
        self._peer = source

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class SerialLine:
    """A serial device, without flow control.

    Raises:
        AutopilotError: the device is missing, taken or not allowed.
    """

    is_datagram = False

    def __init__(self, device: str, baud: int) -> None:
        """Open it exclusively: two programs on one line garble each other."""
        self.dropped = 0
        try:
            self._serial = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise AutopilotError(
                f"serial/{device}:{baud}: cannot be opened ({error}); is it plugged in, is the "
                "user in the group dialout, and does no other program hold it?"
            ) from None
        self._fd = self._serial.fileno()
        os.set_blocking(self._fd, False)
        self._queue_max = max(QUEUE_MIN_BYTES, round(baud / 10 * QUEUE_MAX_S))
        self._left = b""
        self._lock = threading.Lock()
        self._closed = threading.Event()

    def read(self, timeout_s: float) -> Received | None:
        """Bytes; None: none within the time, or the device is gone."""
        data = b""
        try:
            if not select.select([self._fd], [], [], timeout_s)[0]:
                return None
            data = os.read(self._fd, READ_MAX)
        except (OSError, ValueError):
            pass
        if data:
            return Received(data, None)
        self._closed.wait(timeout_s)  # a device that is gone is "ready" all the time
        return None

    def write(self, message: bytes) -> bool:
        """Queue a message whole, or drop it; False: dropped."""
        with self._lock:
            try:
                self._flush()
                if self._left or self._serial.out_waiting + len(message) > self._queue_max:
                    self.dropped += 1
                    return False
                self._left = message
                self._flush()
            except (OSError, ValueError, TypeError):
                # Unplugged, or closed in another thread: pyserial says so in these three ways
                self.dropped += 1
                self._left = b""
                return False
        return True

    def answer_to(self, source: Source) -> None:
        """A wire has one other end."""

    def close(self) -> None:
        """Close the device."""
        self._closed.set()
        with self._lock:
            self._serial.close()

    def _flush(self) -> None:
        if self._left:
            try:
                self._left = self._left[os.write(self._fd, self._left) :]
            except BlockingIOError:
                return


def _why_not(error: OSError, host: str, port: int) -> str:
    if error.errno == errno.EADDRNOTAVAIL:
        return (
            f"{host} is not an address of this machine; to call an autopilot that listens there: "
            f"udpout/{host}:{port}"
        )
    if error.errno == errno.EADDRINUSE:
        return "the port is taken: end the other program (QGroundControl? MAVSDK?), or take another"
    return str(error)
