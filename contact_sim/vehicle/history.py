"""What was believed until now, for samples that come late."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from drone_client.cbf.vector import Vec3
from rgbd_wire.quaternion import Quaternion

KEPT = 100
"""Believed states: 0.4 s at 250 Hz."""


class Believed(NamedTuple):
    """The state at a time, and the sum of all corrections until then.

    What would be believed of that time now is this state and what was corrected since: it never
    has to be touched again.
    """

    t_ns: int
    position: Vec3
    q: Quaternion
    moved: Vec3
    """[m]"""
    turned: Vec3
    """Rotation vector [rad]; the corrections are so small that they add up."""


class History:
    """The newest states, in the order of time."""

    def __init__(self) -> None:
        self._past: deque[Believed] = deque(maxlen=KEPT)

    def remember(self, believed: Believed) -> None:
        """Keep the newest."""
        self._past.append(believed)

    def begin(self, believed: Believed) -> None:
        """Keep this one alone."""
        self._past.clear()
        self._past.append(believed)

    def at(self, t_ns: int) -> Believed | None:
        """What was believed at a time, the newest for one that is yet to come; None: too long ago.

        There must be something to remember.
        """
        past = self._past
        later = past[-1]
        if t_ns >= later.t_ns:
            return later
        for i in range(len(past) - 2, -1, -1):
            earlier = past[i]
            if earlier.t_ns <= t_ns:
                return _between(earlier, later, t_ns)
            later = earlier
        return None


def _between(a: Believed, b: Believed, t_ns: int) -> Believed:
    """The nearer state's attitude and corrections, and the place in between."""
    s = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
    near = a if s < 0.5 else b
    # Corrections are no motion: both places are taken with those of the nearer one.
    ax, ay, az = (p - m + n for p, m, n in zip(a.position, a.moved, near.moved, strict=True))
    bx, by, bz = (p - m + n for p, m, n in zip(b.position, b.moved, near.moved, strict=True))
    place = ax + s * (bx - ax), ay + s * (by - ay), az + s * (bz - az)
    return Believed(t_ns, place, near.q, near.moved, near.turned)
