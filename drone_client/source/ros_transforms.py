"""Poses in ROS messages, and the tree of frames that /tf and /tf_static span."""

from __future__ import annotations

from collections import deque
from functools import reduce
from itertools import pairwise
from operator import matmul
from typing import Any, Final

import numpy as np

from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose

MAX_FRAMES: Final = 4096
"""More frames than any robot has; further ones are not taken."""


def pose_of(translation: Any, rotation: Any) -> Pose:
    """From a geometry_msgs Point or Vector3 and a Quaternion.

    Raises:
        GeometryError: not finite, or not of unit length.
    """
    t = np.array([translation.x, translation.y, translation.z], dtype=np.float64)
    return Pose(t, np.array([rotation.w, rotation.x, rotation.y, rotation.z], dtype=np.float64))


def stamp_ns(header: Any) -> int:
    """Time of a std_msgs/Header [ns]."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def frame_name(name: str) -> str:
    """ROS 1 wrote some with a leading slash."""
    return name.lstrip("/")


class TransformTree:
    """Fixed transforms between frames, each added as ``parent_from_child``."""

    def __init__(self) -> None:
        self._edges: dict[str, dict[str, Pose]] = {}

    @property
    def frames(self) -> list[str]:
        """All that are known, sorted."""
        return sorted(self._edges)

    def add(self, parent: str, child: str, parent_from_child: Pose) -> None:
        """A transform; a later one of the same two frames replaces it."""
        parent, child = frame_name(parent), frame_name(child)
        known = parent in self._edges and child in self._edges
        if parent != child and (known or len(self._edges) < MAX_FRAMES - 1):
            self._edges.setdefault(parent, {})[child] = parent_from_child
            self._edges.setdefault(child, {})[parent] = parent_from_child.inverse()

    def add_message(self, message: Any) -> int:
        """All transforms of a TFMessage; how many of them were no transforms."""
        bad = 0
        for t in message.transforms:
            try:
                pose = pose_of(t.transform.translation, t.transform.rotation)
            except GeometryError:
                bad += 1
            else:
                self.add(t.header.frame_id, t.child_frame_id, pose)
        return bad

    def path(self, a: str, b: str) -> list[str] | None:
        """Frames on the way from ``a`` to ``b``; None: they are not connected."""
        a, b = frame_name(a), frame_name(b)
        came_from: dict[str, str] = {a: a}
        waiting = deque([a])
        while waiting and b not in came_from:
            here = waiting.popleft()
            for there in self._edges.get(here, ()):
                if there not in came_from:
                    came_from[there] = here
                    waiting.append(there)
        if b not in came_from:
            return None
        path = [b]
        while path[-1] != a:
            path.append(came_from[path[-1]])
        return path[::-1]

    def find(self, a: str, b: str) -> Pose | None:
        """``a_from_b``; None: they are not connected."""
        path = self.path(a, b)
        if path is None:
            return None
        return reduce(matmul, (self.between(*link) for link in pairwise(path)), Pose.identity())

    def between(self, a: str, b: str) -> Pose:
        """``a_from_b`` of two neighbours."""
        return self._edges[a][b]
