"""A source that gives what it was handed: for tests, examples and one's own code."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drone_client.pose_buffer import PoseBuffer
from drone_client.source import Capture
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Pose


class MemorySource:
    """Captures and a trajectory held in memory."""

    def __init__(
        self,
        camera: RgbdCamera,
        captures: Sequence[Capture],
        trajectory: Sequence[tuple[int, Pose]] = (),
    ) -> None:
        self.camera = camera
        self._captures = tuple(captures)
        self._trajectory = PoseBuffer(capacity=max(1, len(trajectory)))
        for t_source_ns, world_from_camera in trajectory:
            self._trajectory.add(t_source_ns, world_from_camera)

    def __len__(self) -> int:
        return len(self._captures)

    def captures(self) -> Iterator[Capture]:
        """The captures, oldest first."""
        return iter(self._captures)

    def world_from_camera(self, t_source_ns: int) -> Pose | None:
        """Interpolated pose of the colour camera; None outside the trajectory."""
        return self._trajectory.at(t_source_ns)
