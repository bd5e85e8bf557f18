"""Where the drone was: a ring of stamped poses, asked at the time a frame was taken.

A result speaks of the moment of exposure. Composed with the drone's pose *now* it would be wrong
by speed times age: on a 350 ms link that was 0.167 m/s of contact speed instead of 0.032.

Where the odometry jumped, a new epoch begins: its poses are told in another world than those
before, and nothing is interpolated or carried on from one to the other.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from typing import NamedTuple

from rgbd_wire.geometry import Pose

MAX_EXTRAPOLATION_NS = 20_000_000
"""The newest pose stands for at most this long after it (and the oldest before it)."""
MAX_GAP_NS = 200_000_000
"""Two poses further apart than this are not interpolated: odometry was lost between them."""


class Located(NamedTuple):
    """A pose, and the world in which it is told."""

    pose: Pose
    epoch: int


class PoseBuffer:
    """A bounded ring of ``world_from_body`` over the drone's monotonic clock. Not thread-safe."""

    def __init__(self, capacity: int = 1024) -> None:
        self.epoch = 0
        """Worlds that the odometry has left behind: each jump begins another."""
        self._times_ns: deque[int] = deque(maxlen=capacity)
        self._known: deque[Located] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._times_ns)

    def add(self, t_ns: int, world_from_body: Pose) -> bool:
        """Append a pose of this epoch; False, and nothing kept, unless newer than all before."""
        if self._times_ns and t_ns <= self._times_ns[-1]:
            return False
        self._times_ns.append(t_ns)
        self._known.append(Located(world_from_body, self.epoch))
        return True

    def begin_epoch(self, t_ns: int) -> None:
        """The odometry jumped: poses that are added from now on are told in another world.

        Args:
            t_ns: of the first of them. Older epochs' poses at or after it are forgotten: the
                odometry's clock went back.
        """
        self.epoch += 1
        while self._times_ns and self._times_ns[-1] >= t_ns:
            self._times_ns.pop()
            self._known.pop()

    def find(self, t_ns: int) -> Located | None:
        """Pose at a time and its epoch: linear and SLERP between neighbours of one epoch.

        None if the drone cannot know. Between the last pose of an epoch and the first of the next
        the older one stands, for as long as any last one does.
        """
        if not self._times_ns:
            return None
        after = bisect_right(self._times_ns, t_ns)
        if after == 0:
            first = self._known[0]
            # Before the first pose after a jump the world was another.
            near = first.epoch == 0 and self._times_ns[0] - t_ns <= MAX_EXTRAPOLATION_NS
            return first if near else None
        t0_ns, before = self._times_ns[after - 1], self._known[after - 1]
        if t_ns == t0_ns:
            return before
        if after == len(self._times_ns) or self._known[after].epoch != before.epoch:
            return before if t_ns - t0_ns <= MAX_EXTRAPOLATION_NS else None
        t1_ns, then = self._times_ns[after], self._known[after]
        if t1_ns - t0_ns > MAX_GAP_NS:
            return None
        share = (t_ns - t0_ns) / (t1_ns - t0_ns)
        return Located(before.pose.interpolate(then.pose, share), before.epoch)

    def at(self, t_ns: int) -> Pose | None:
        """Pose at a time in the present world; None if it was another, or the drone cannot know."""
        located = self.find(t_ns)
        return None if located is None or located.epoch != self.epoch else located.pose
