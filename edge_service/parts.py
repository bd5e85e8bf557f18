"""How the parts are made of the settings: the one place that names the real detector and link."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge_service.detector.engines import open_engine
from edge_service.detector.self_check import require, self_check
from edge_service.errors import SelfCheckError
from edge_service.guarded import GuardedDetector
from edge_service.pipeline import Pipeline
from edge_service.settings import EdgeSettings
from edge_service.transport import Transport
from edge_service.transport.several import SeveralTransports
from edge_service.transport.udp import UdpTransport
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.clock import Clock
from rgbd_wire.tls_files import tls_files
from rgbd_wire.tunnel.errors import KeyFileError
from rgbd_wire.tunnel.keys import KeyFile
from target_pose.localise import localise
from target_pose.nesting import group
from target_pose.target import load_target

_LOOPBACK = re.compile(r"[a-z]+/(127\.[\d.]+|localhost|\[::1\]):\d+$")


log = logging.getLogger(__name__)


def make_pipeline(settings: EdgeSettings, clock: Clock, *, check: bool = False) -> Pipeline:
    """Load the target and the detector, and warm it up; takes a second or two.

    Args:
        settings: which target, engine and weights.
        clock: times the stages.
        check: let the detector find drawn targets first, as ``settings.self_check`` says.

    Raises:
        TargetFileError: the target cannot be read.
        WeightsError: the weights cannot be used.
        SelfCheckError: the detector does not find the target.
    """
    target = load_target(settings.target)
    detector = open_engine(
        settings.engine,
        settings.weights,
        threads=settings.threads,
        precision=settings.precision,
        device=settings.device,
        classes=settings.classes,
        cache=settings.model_cache,
    )
    told: dict[str, Any] = {}
    if check and settings.self_check != "off":
        result = self_check(detector, target)
        told = {
            "self_check": f"found {result.found} of {result.drawn} drawn targets",
            "detect_p50_ms": result.p50_ms,
        }
        log.info("self-check", extra=told)
        try:
            weights = settings.weights or "the packaged weights"
            require(result, f"{weights} on {settings.engine}", target)
        except SelfCheckError as error:
            if settings.self_check == "refuse":
                raise
            log.warning(str(error))
    return Pipeline(
        GuardedDetector(detector, told),
        target,
        group,
        localise,
        clock,
        max_candidates=settings.max_candidates,
        world_is_level=settings.world_is_level,
    )


@dataclass(frozen=True, slots=True)
class Links:
    """The ways to the drones, not yet open, and what people are told of them."""

    transport: Transport
    """All of them."""
    tunnel: UdpTransport | None
    zenoh_line: str | None
    """Where Zenoh is, for the start."""
    keys: Path | None
    """Where the tunnel's keys are."""
    warnings: tuple[str, ...]

    def lines(self) -> tuple[str, ...]:
        """For the start, one of each; once they are open, with the ports that they got."""
        lines = [self.zenoh_line] if self.zenoh_line else []
        if self.tunnel is not None:
            lines.append(f"udp    {self.tunnel.place}, keys in {self.keys}")
        return tuple(lines)


def make_links(settings: EdgeSettings, clock: Clock) -> Links:
    """Zenoh, the UDP tunnel, or both, as the settings have it.

    Raises:
        TlsFilesError: a certificate or key cannot be used.
        KeyFileError: the keys of the tunnel cannot be used.
    """
    transports: list[Transport] = []
    zenoh_line = None
    warnings: list[str] = []
    if settings.has_zenoh:
        zenoh = _make_zenoh(settings)
        transports.append(zenoh)
        joined = ", ".join(settings.connect_endpoints)
        at = f"joins {joined}" if joined else ", ".join(settings.listen_endpoints)
        zenoh_line = f"zenoh  {at}"
        warnings.extend(zenoh.warnings)
    tunnel = None
    if settings.udp_listen:
        assert settings.tunnel_keys is not None, "checked with the settings"
        try:
            keys = KeyFile(settings.tunnel_keys)
        except KeyFileError as error:
            raise KeyFileError(
                f"--keys (EDGE_TUNNEL_KEYS): {error}; scripts/certificates FOLDER --drones ... "
                f"--workers {settings.name} --tunnel-keys makes FOLDER/{settings.name}/tunnel.keys"
            ) from None
        tunnel = UdpTransport(settings.name, f"udp/{settings.udp_listen}", keys, clock)
        transports.append(tunnel)
        if settings.has_zenoh and settings.zenoh_tls is None and not _is_local(settings):
            warnings.append(
                "the tunnel asks for keys, but whoever reaches plain Zenoh can use any drone's "
                "name: give Zenoh certificates (--tls), or none at all (--listen '')"
            )
        if not keys:
            warnings.append(
                f"{settings.tunnel_keys} holds no key: no drone can come in over UDP until it does"
            )
    whole = transports[0] if len(transports) == 1 else SeveralTransports(transports)
    return Links(whole, tunnel, zenoh_line, settings.tunnel_keys, tuple(warnings))


def _is_local(settings: EdgeSettings) -> bool:
    """Zenoh listens on this machine's own addresses alone."""
    endpoints = settings.listen_endpoints
    return bool(endpoints) and all(_LOOPBACK.match(endpoint) for endpoint in endpoints)


def _make_zenoh(settings: EdgeSettings) -> ZenohTransport:
    address = ZenohAddress(
        listen=settings.listen_endpoints,
        connect=settings.connect_endpoints,
        lease_ms=settings.zenoh_lease_ms,
        tls=None if settings.zenoh_tls is None else tls_files(settings.zenoh_tls),
        drones=settings.drone_names,
    )
    return ZenohTransport(settings.name, address)
