"""Reads ``nav_msgs/Odometry`` and ``sensor_msgs/Range`` out of CDR, as ``cdr`` writes poses.

::

    Odometry   header, child_frame_id, pose (7 f64), 36 f64, twist (6 f64), 36 f64
    Range      header, u8 radiation_type, f32 field_of_view, min_range, max_range, range
               and, since Iron, f32 variance, which is not read

Plain CDR of either byte order. What is cut short or no message raises ``ValueError`` and nothing
else; numbers are handed on as they are, for whoever uses them to check.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

import numpy as np

from rgbd_wire.geometry import Array

MAX_TEXT_BYTES: Final = 256
MAX_MESSAGE_BYTES: Final = 4096
"""An odometry with the longest names has less than 1400."""
_NS_PER_S = 1_000_000_000
_ENCAPSULATION = 4
_BYTE_ORDER = {b"\x00\x00": ">", b"\x00\x01": "<"}


class RosOdometry(NamedTuple):
    """A ``nav_msgs/Odometry``."""

    unix_ns: int
    frame_id: str
    child_frame_id: str
    position: Array  # (3,) [m], in frame_id
    q_wxyz: Array  # (4,)
    pose_covariance: Array  # (6, 6), along the axes of frame_id
    velocity_child: Array  # (3,) [m/s], in child_frame_id
    turn_child: Array  # (3,) [rad/s]


class RosRange(NamedTuple):
    """A ``sensor_msgs/Range``."""

    unix_ns: int
    frame_id: str
    min_m: float
    max_m: float
    range_m: float
    """-inf: nearer than the least, inf: nothing within the most (REP 117)."""


def read_odometry(message: bytes) -> RosOdometry:
    """The numbers of a ``nav_msgs/Odometry``.

    Raises:
        ValueError: it is none.
    """
    reader = _Reader(message)
    unix_ns, frame_id = reader.header()
    child_frame_id = reader.text()
    pose = reader.numbers("d", 7)
    covariance = reader.numbers("d", 36)
    twist = reader.numbers("d", 6)
    reader.numbers("d", 36)
    return RosOdometry(
        unix_ns,
        frame_id,
        child_frame_id,
        np.array(pose[:3]),
        np.array((pose[6], *pose[3:6])),  # ROS writes x, y, z, w
        np.array(covariance).reshape(6, 6),
        np.array(twist[:3]),
        np.array(twist[3:]),
    )


def read_range(message: bytes) -> RosRange:
    """The numbers of a ``sensor_msgs/Range``.

    Raises:
        ValueError: it is none.
    """
    reader = _Reader(message)
    unix_ns, frame_id = reader.header()
    reader.numbers("B", 1)
    _, min_m, max_m, range_m = reader.numbers("f", 4)
    return RosRange(unix_ns, frame_id, min_m, max_m, range_m)


class _Reader:
    """Walks through a message; alignment counts from behind the encapsulation."""

    def __init__(self, message: bytes) -> None:
        order = _BYTE_ORDER.get(message[:2])
        if order is None or not _ENCAPSULATION <= len(message) <= MAX_MESSAGE_BYTES:
            raise ValueError(f"{len(message)} bytes that are no plain CDR")
        self._order = order
        self._body = message[_ENCAPSULATION:]
        self._at = 0

    def numbers(self, kind: str, count: int) -> tuple[float, ...]:
        size = struct.calcsize("<" + kind)
        start = self._at + -self._at % size
        end = start + count * size
        if end > len(self._body):
            raise ValueError(f"a message of {len(self._body)} bytes ends before its {end}th")
        self._at = end
        return struct.unpack_from(f"{self._order}{count}{kind}", self._body, start)

    def text(self) -> str:
        (length,) = self.numbers("I", 1)
        end = self._at + int(length)
        if not 1 <= length <= MAX_TEXT_BYTES or end > len(self._body):
            raise ValueError(f"a name of {length} bytes")
        raw = self._body[self._at : end - 1]
        self._at = end
        return raw.decode("utf-8", errors="replace")

    def header(self) -> tuple[int, str]:
        (seconds,) = self.numbers("i", 1)
        (nanoseconds,) = self.numbers("I", 1)
        return int(seconds) * _NS_PER_S + int(nanoseconds), self.text()
