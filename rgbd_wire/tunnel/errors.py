"""The errors of the tunnel, and why datagrams are refused.

::

    WireError
    ├── TunnelError       a datagram that is refused; carries a ``Refusal`` reason
    ├── KeyFileError      a key file that cannot be used; says file, line and what is wrong
    └── EndpointError     a text that is not ``udp/HOST:PORT``
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from rgbd_wire.errors import WireError


class Refusal(StrEnum):
    """Why the tunnel did not take something; each is counted under this name."""

    MALFORMED = "malformed"
    WRONG_VERSION = "wrong_version"
    UNKNOWN_SESSION = "unknown_session"
    NOT_AUTHENTIC = "not_authentic"
    REPLAYED = "replayed"
    BAD_COOKIE = "bad_cookie"
    UNKNOWN_DRONE = "unknown_drone"
    BAD_MAC = "bad_mac"
    NO_CIPHER = "no_cipher"
    NOT_ANNOUNCED = "not_announced"
    SESSION_LIMIT = "session_limit"
    HANDSHAKE_RATE = "handshake_rate"
    DRONE_RATE = "drone_rate"
    BAD_SHARD = "bad_shard"
    EVICTED = "evicted"
    STALE = "stale"
    UNDECODABLE = "undecodable"
    LATE = "late"
    UNWANTED = "unwanted"
    NOT_SENT = "not_sent"
    FAULT = "fault"
    """An exception of this side's own; the thread went on."""


class TunnelError(WireError):
    """A datagram that is refused; nothing was kept of it."""

    def __init__(self, reason: Refusal, detail: str) -> None:
        super().__init__(f"{reason.value}: {detail}")
        self.reason = reason


class KeyFileError(WireError):
    """A key file that cannot be used."""


class EndpointError(WireError):
    """A text that names no UDP endpoint."""


class Counters:
    """How often each ``Refusal`` happened; its size is that of the enum."""

    def __init__(self) -> None:
        self._counts = dict.fromkeys(Refusal, 0)

    def count(self, reason: Refusal, times: int = 1) -> None:
        """Count a refusal."""
        self._counts[reason] += times

    def snapshot(self) -> Mapping[str, int]:
        """Counts by name, zeros included."""
        return {reason.value: n for reason, n in self._counts.items()}
