"""What the service counts and times, in a Prometheus registry of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Info,
    disable_created_metrics,
    generate_latest,
)

from edge_service.pipeline import Output
from edge_service.tunnel_metrics import TunnelCollector
from rgbd_wire.errors import Reject
from rgbd_wire.messages import Outcome

SECONDS = (0.001, 0.002, 0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.25, 0.5, 1.0)
"""Buckets around what a frame takes on a CPU and what a drone can wait."""
BATCH_FRAMES = (1, 2, 3, 4, 6, 8, 12, 16)
DROP_PLACES = ("intake", "worker")
BUILD_FACTS = ("engine", "precision", "threads")
"""Of what a detector says of itself, the labels of ``edge_build_info``."""
OWN_REJECTS = ("repeated", "wrong_drone", "no_drone", "too_fast", "fault")
"""Why messages are refused beside the reasons of ``Reject``."""


class Metrics:
    """All series of one worker; each is safe to touch from any thread."""

    def __init__(self) -> None:
        # One more series for each, which Prometheus has no use for
        disable_created_metrics()  # type: ignore[no-untyped-call] # untyped in the library
        self.registry = CollectorRegistry()
        self.frames = Counter(
            "edge_frames", "Frames answered, by outcome.", ["outcome"], registry=self.registry
        )
        self.rejected = Counter(
            "edge_rejected", "Messages refused, by reason.", ["reason"], registry=self.registry
        )
        self.probes = Counter("edge_probes", "Probes echoed.", registry=self.registry)
        self.unsent = Counter(
            "edge_unsent", "Answers that found the link closed.", registry=self.registry
        )
        self.stage = Histogram(
            "edge_stage_seconds",
            "Time of one stage of one frame.",
            ["stage"],
            buckets=SECONDS,
            registry=self.registry,
        )
        self.service = Histogram(
            "edge_service_seconds",
            "From a frame's last byte (t2) to its result (t3).",
            buckets=SECONDS,
            registry=self.registry,
        )
        self.dropped = Counter(
            "edge_dropped",
            "Frames dropped since their answer would have been late, by where: hopeless already "
            "at the intake, or once they came to the worker.",
            ["where"],
            registry=self.registry,
        )
        self.batch = Histogram(
            "edge_batch_frames",
            "Frames that the detector took at once.",
            buckets=BATCH_FRAMES,
            registry=self.registry,
        )
        self.expected = Gauge(
            "edge_expected_service_seconds",
            "What a frame is expected to take now, without waiting; 0: none was served of late.",
            registry=self.registry,
        )
        self.requests = Counter(
            "edge_http_localize",
            "Pictures handed in over HTTP, by status code.",
            ["status"],
            registry=self.registry,
        )
        self.drones = Gauge("edge_drones", "Drones that have a slot.", registry=self.registry)
        self.waiting = Gauge("edge_waiting", "Frames that wait.", registry=self.registry)
        self.ready = Gauge("edge_ready", "1: ready, as /readyz says.", registry=self.registry)
        self._build = Info("edge_build", "Version, worker and model.", registry=self.registry)
        # A series that appears with its first event has no rate for that event
        for outcome in Outcome:
            self.frames.labels(outcome.value)
        for reason in (*(r.value for r in Reject), *OWN_REJECTS):
            self.rejected.labels(reason)
        for where in DROP_PLACES:
            self.dropped.labels(where)

    def follow_tunnel(self, counters: Callable[[], Mapping[str, int]]) -> None:
        """Show what the tunnel refuses, by reason; read whenever the metrics are."""
        self.registry.register(TunnelCollector(counters))

    def describe(self, worker: str, model_hash: str, detector: Mapping[str, Any]) -> None:
        """Say who this is, and how its detector says that it runs."""
        version = metadata.version("aerial-contact")
        self._build.info(
            {
                "version": version,
                "worker": worker,
                "model": model_hash,
                **{k: str(detector[k]) for k in BUILD_FACTS if k in detector},
            }
        )

    def answered(self, output: Output, service_ns: int) -> None:
        """Count a frame's result."""
        self.frames.labels(output.outcome.value).inc()
        for stage, spent_ns in output.stages_ns.items():
            self.stage.labels(stage).observe(spent_ns * 1e-9)
        if "decode" in output.stages_ns:  # it was worked on, and not turned away before
            self.service.observe(service_ns * 1e-9)

    def text(self) -> bytes:
        """All series in Prometheus' text format."""
        return generate_latest(self.registry)
