"""The robot's own VIO and lidars, as they come in: the newest of each, for whoever looks.

A source is looked at once a control tick; what comes in between is overwritten. The stamp of a
sample is when it was measured, so that nothing is lost but a sample.
"""

from __future__ import annotations

from typing import Protocol

from drone_client.odometry import OdometrySample, RangeSample


class OdometrySource(Protocol):
    """Gives the newest samples. Thread-safe; answers at once, from memory, and never raises."""

    def odometry(self) -> OdometrySample | None:
        """The newest of the VIO; None: none yet."""
        ...

    def height(self) -> RangeSample | None:
        """The newest of the lidar that looks down; None: none yet."""
        ...

    def ahead(self) -> RangeSample | None:
        """The newest of the lidar that looks forward; None: none yet."""
        ...

    def close(self) -> None:
        """End its threads and its session."""
        ...


class MemoryOdometry:
    """A source that gives what was put into it, for tests and one's own code.

    One slot each; a name that is bound anew is seen whole by any thread.
    """

    def __init__(self) -> None:
        self.newest_odometry: OdometrySample | None = None
        self.newest_height: RangeSample | None = None
        self.newest_ahead: RangeSample | None = None

    def odometry(self) -> OdometrySample | None:
        """The newest that was put."""
        return self.newest_odometry

    def height(self) -> RangeSample | None:
        """The newest that was put."""
        return self.newest_height

    def ahead(self) -> RangeSample | None:
        """The newest that was put."""
        return self.newest_ahead

    def close(self) -> None:
        """There is nothing to end."""
