"""Where frames and the drone's own pose come from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """One exposure as a source gives it, on the source's own time line."""

    t_source_ns: int
    """Middle of the exposure on the source's time line: the drone's monotonic clock for a live
    source, otherwise one whose zero means nothing."""
    color_rgb: NDArray[np.uint8]  # (H, W, 3)
    depth_units: NDArray[np.uint16] | None  # (h, w)
    name: str
    """What people call it: a file name, a camera's serial and number."""


class RgbdSource(Protocol):
    """Gives captures in order, and the camera's pose where it is known."""

    camera: RgbdCamera

    def __len__(self) -> int:
        """How many captures there are."""
        ...

    def captures(self) -> Iterator[Capture]:
        """The captures, oldest first."""
        ...

    def world_from_camera(self, t_source_ns: int) -> Pose | None:
        """Pose of the colour camera at a time on the source's time line; None: not known."""
        ...


class Recording(RgbdSource, Protocol):
    """A source on disk, of which parts can be looked at."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What could not be read while it was last played, and why; a line each."""
        ...

    def some_captures(self, at_most: int) -> Iterator[Capture]:
        """So many of the captures, spread evenly; the others are not even decoded."""
        ...


class LiveSource(Protocol):
    """A camera that runs now; its time line is the drone's monotonic clock."""

    @property
    def camera(self) -> RgbdCamera:
        """The rig, as the camera tells it; known once started."""
        ...

    def start(self) -> None:
        """Open the camera and let it run.

        Raises:
            SourceError: there is no such camera, or it cannot do what was asked for.
        """
        ...

    def captures(self, timeout_s: float) -> Iterator[Capture | None]:
        """The newest capture that was not given yet, as it comes; those before it are dropped.

        None whenever none came within the time-out, so that a caller can look at other things.
        Ends after ``stop``.

        Raises:
            SourceError: the camera went away and did not come back.
        """
        ...

    def counts(self) -> dict[str, int]:
        """What became of the camera's pictures, by reason; may be asked at any time."""
        ...

    def stop(self) -> None:
        """Stop and close the camera; also when it never ran."""
        ...


def stride(count: int, at_most: int) -> int:
    """From one capture to the next where ``at_most`` of ``count`` are taken, spread evenly."""
    return max(1, -(-count // at_most))
