"""The simulated VIO and lidars as the client's odometry source."""

from __future__ import annotations

from dataclasses import replace
from typing import Generic, TypeVar

from contact_sim.flight.live import LiveSimulation
from drone_client.odometry import OdometrySample, RangeSample

_Sample = TypeVar("_Sample", OdometrySample, RangeSample)


class _Stamp(Generic[_Sample]):
    """Stamps each sample once: whoever asks again is given the same one, as by any source."""

    def __init__(self) -> None:
        self._simulated: _Sample | None = None
        self._stamped: _Sample | None = None

    def of(self, sample: _Sample | None, offset_ns: int) -> _Sample | None:
        if sample is None:
            return None
        if sample is not self._simulated:
            self._simulated = sample
            self._stamped = replace(sample, t_ns=sample.t_ns + offset_ns)
        return self._stamped


class SimulatedOdometry:
    """An ``OdometrySource``: the newest samples, stamped with the drone's clock."""

    def __init__(self, live: LiveSimulation) -> None:
        self._live = live
        self._vio: _Stamp[OdometrySample] = _Stamp()
        self._height: _Stamp[RangeSample] = _Stamp()
        self._ahead: _Stamp[RangeSample] = _Stamp()

    def odometry(self) -> OdometrySample | None:
        """The newest of the VIO."""
        with self._live.look() as (simulation, offset_ns):
            return self._vio.of(simulation.vio, offset_ns)

    def height(self) -> RangeSample | None:
        """The newest of the lidar that looks down."""
        with self._live.look() as (simulation, offset_ns):
            return self._height.of(simulation.height, offset_ns)

    def ahead(self) -> RangeSample | None:
        """The newest of the lidar that looks forward."""
        with self._live.look() as (simulation, offset_ns):
            return self._ahead.of(simulation.ahead, offset_ns)

    def close(self) -> None:
        """There is nothing to end."""
