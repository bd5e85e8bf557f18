"""Where the drone was: a ring of stamped poses, asked at the time a frame was taken.

A result speaks of the moment of exposure. Composed with the drone's pose *now* it would be wrong
by speed times age: on a 350 ms link that was 0.167 m/s of contact speed instead of 0.032.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from rgbd_wire.geometry import Pose

MAX_EXTRAPOLATION_NS = 20_000_000
"""The newest pose stands for at most this long after it (and the oldest before it)."""
MAX_GAP_NS = 200_000_000
"""Two poses further apart than this are not interpolated: odometry was lost between them."""


class PoseBuffer:
    """A bounded ring of ``world_from_body`` over the drone's monotonic clock. Not thread-safe."""

    def __init__(self, capacity: int = 1024) -> None:
        self._times_ns: deque[int] = deque(maxlen=capacity)
        self._poses: deque[Pose] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._times_ns)

    def add(self, t_ns: int, world_from_body: Pose) -> bool:
        """Append a pose; False, and nothing kept, unless it is newer than all before."""
        if self._times_ns and t_ns <= self._times_ns[-1]:
            return False
        self._times_ns.append(t_ns)
        self._poses.append(world_from_body)
        return True

    def at(self, t_ns: int) -> Pose | None:
        """Pose at a time: linear and SLERP between neighbours; None if the drone cannot know."""
        if not self._times_ns:
            return None
        after = bisect_right(self._times_ns, t_ns)
        if after == 0:
            near = self._times_ns[0] - t_ns <= MAX_EXTRAPOLATION_NS
            return self._poses[0] if near else None
        t0_ns, pose0 = self._times_ns[after - 1], self._poses[after - 1]
        if t_ns == t0_ns:
            return pose0
        if after == len(self._times_ns):
            return pose0 if t_ns - t0_ns <= MAX_EXTRAPOLATION_NS else None
        t1_ns, pose1 = self._times_ns[after], self._poses[after]
        if t1_ns - t0_ns > MAX_GAP_NS:
            return None
        return pose0.interpolate(pose1, (t_ns - t0_ns) / (t1_ns - t0_ns))
