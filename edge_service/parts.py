"""How the parts are made of the settings: the one place that names the real detector and link."""

from __future__ import annotations

from edge_service.detector.engine import TorchDetector
from edge_service.guarded import GuardedDetector
from edge_service.pipeline import Pipeline
from edge_service.settings import EdgeSettings
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.clock import Clock
from target_pose.localise import localise
from target_pose.nesting import group
from target_pose.target import load_target


def make_pipeline(settings: EdgeSettings, clock: Clock) -> Pipeline:
    """Load the target and the detector, and warm it up; takes a second or two.

    Raises:
        TargetFileError: the target cannot be read.
        WeightsError: the weights cannot be used.
    """
    target = load_target(settings.target)
    detector = TorchDetector(
        settings.weights, threads=settings.threads, precision=settings.precision
    )
    return Pipeline(
        GuardedDetector(detector),
        target,
        group,
        localise,
        clock,
        max_candidates=settings.max_candidates,
        world_is_level=settings.world_is_level,
    )


def make_transport(settings: EdgeSettings) -> ZenohTransport:
    """The link to the drones, not yet open."""
    address = ZenohAddress(
        listen=settings.listen_endpoints,
        connect=settings.connect_endpoints,
        lease_ms=settings.zenoh_lease_ms,
    )
    return ZenohTransport(settings.name, address)
