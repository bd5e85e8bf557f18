"""The simulated VIO and lidars as the client's odometry source."""

from __future__ import annotations

from dataclasses import replace

from contact_sim.flight.live import LiveSimulation
from drone_client.odometry import OdometrySample, RangeSample


class SimulatedOdometry:
    """An ``OdometrySource``: the newest samples, stamped with the drone's clock."""

    def __init__(self, live: LiveSimulation) -> None:
        self._live = live

    def odometry(self) -> OdometrySample | None:
        """The newest of the VIO."""
        with self._live.look() as (simulation, offset_ns):
            sample = simulation.vio
            return None if sample is None else replace(sample, t_ns=sample.t_ns + offset_ns)

    def height(self) -> RangeSample | None:
        """The newest of the lidar that looks down."""
        with self._live.look() as (simulation, offset_ns):
            return _stamped(simulation.height, offset_ns)

    def ahead(self) -> RangeSample | None:
        """The newest of the lidar that looks forward."""
        with self._live.look() as (simulation, offset_ns):
            return _stamped(simulation.ahead, offset_ns)

    def close(self) -> None:
        """There is nothing to end."""


def _stamped(sample: RangeSample | None, offset_ns: int) -> RangeSample | None:
    return None if sample is None else replace(sample, t_ns=sample.t_ns + offset_ns)
