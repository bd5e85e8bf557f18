"""What the running service consists of so far, and whether it is alive and ready."""

from __future__ import annotations

from dataclasses import dataclass

from edge_service.mailbox import Mailbox
from edge_service.metrics import Metrics
from edge_service.pipeline import Pipeline
from edge_service.settings import EdgeSettings
from edge_service.transport import Transport
from edge_service.worker import Worker


@dataclass(slots=True)
class ServiceState:
    """The parts, in the order in which they come up; read by the HTTP side, written by the service.

    Each is set once and whole, so that no lock is needed.
    """

    settings: EdgeSettings
    metrics: Metrics
    mailbox: Mailbox
    pipeline: Pipeline | None = None
    """None until the model is loaded and warm."""
    worker: Worker | None = None
    transport: Transport | None = None
    draining: bool = False

    @property
    def alive(self) -> bool:
        """The worker's loop has come round lately, or is still to start; the link's threads run."""
        worker, transport = self.worker, self.transport
        if transport is not None and not transport.is_alive:
            return False
        return worker is None or worker.silent_ns <= self.settings.heartbeat_s * 1e9

    def readiness(self) -> dict[str, bool]:
        """What it takes to be ready, and what of it there is."""
        transport = self.transport
        return {
            "model_warm": self.pipeline is not None,
            "link_open": transport is not None and transport.is_open,
            "not_draining": not self.draining,
        }

    def metrics_text(self) -> bytes:
        """All metrics, with the gauges as they are now."""
        self.metrics.drones.set(self.mailbox.drones)
        self.metrics.waiting.set(self.mailbox.waiting)
        if self.worker is not None:
            self.metrics.expected.set(self.worker.expected_ns * 1e-9)
        self.metrics.ready.set(all(self.readiness().values()))
        return self.metrics.text()
