"""How the parts are made of the settings: the one place that names the real detector and link."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from edge_service.detector.engines import open_engine
from edge_service.detector.self_check import require, self_check
from edge_service.errors import SelfCheckError, SettingsError, WeightsError
from edge_service.guarded import GuardedDetector
from edge_service.intake import PROBES_HZ
from edge_service.pipeline import Localise, Pipeline
from edge_service.settings import EdgeSettings
from edge_service.transport import Transport
from edge_service.transport.several import SeveralTransports
from edge_service.transport.udp import UdpTransport
from edge_service.transport.zenoh import ZenohAddress, ZenohTransport
from rgbd_wire.clock import Clock
from rgbd_wire.tls_files import tls_files
from rgbd_wire.tunnel.errors import KeyFileError
from rgbd_wire.tunnel.keys import KeyFile
from rgbd_wire.tunnel.sessions import MAX_PER_DRONE, MAX_SESSIONS, MESSAGES_HZ
from target_pose.localise import localise
from target_pose.nesting import group
from target_pose.pnp import localise_pnp
from target_pose.target import Level, Target, load_target

METHODS: Mapping[str, Localise] = MappingProxyType({"fused": localise, "pnp": localise_pnp})
"""What localises a candidate, by the setting's name."""

TUNNEL_ROOM = 1.25
"""Messages that the tunnel hands over for each that is taken, so that it is the intake that turns a
drone away, in words, and not the tunnel in silence."""

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
        SettingsError: the method needs what the target has not.
        WeightsError: the weights cannot be used, or not for this target.
        SelfCheckError: the detector does not find the target.
    """
    target = load_target(settings.target)
    if settings.method == "fused" and not target.discs:
        raise SettingsError(
            f"target {target.name} has [[points]] and no [[discs]], and --method (EDGE_METHOD) "
            "fused fits discs: choose --method pnp"
        )
    detector = open_engine(
        settings.engine,
        settings.weights,
        threads=settings.threads,
        precision=settings.precision,
        device=settings.device,
        classes=settings.classes,
        cache=settings.model_cache,
        points=len(target.points),
    )
    _check_levels(detector.describe(), target, settings.weights)
    told: dict[str, Any] = {}
    if check and settings.self_check != "off" and not target.discs:
        told = {"self_check": f"none: {target.name} has no discs that could be drawn"}
        log.info("self-check", extra=told)
    elif check and settings.self_check != "off":
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
        METHODS[settings.method],
        clock,
        method=settings.method,
        max_candidates=settings.max_candidates,
        world_is_level=settings.world_is_level,
    )


def _check_levels(told: Mapping[str, Any], target: Target, weights: Path | None) -> None:
    """Refuse a detector that gives nothing by which a target without discs could be found.

    Raises:
        WeightsError: says what it lacks, and what to do.
    """
    if target.discs:
        return
    what = f"weights {weights}" if weights else "the packaged weights"
    if not told.get("points"):
        raise WeightsError(
            f"{what} give no key points, by which alone {target.name} is found: name a YOLOv8 or "
            "v11 pose export with --weights (EDGE_WEIGHTS) and --engine onnxruntime or openvino"
        )
    if Level.GOOD not in told["levels"]:
        raise WeightsError(
            f"{what} know {', '.join(told['levels'])}; the box of a target of points is "
            f"{Level.GOOD}: say which class it is with --classes (EDGE_CLASSES)"
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
        tunnel = UdpTransport(
            settings.name,
            f"udp/{settings.udp_listen}",
            keys,
            clock,
            max_sessions=max(MAX_SESSIONS, MAX_PER_DRONE * settings.max_drones),
            messages_hz=max(MESSAGES_HZ, TUNNEL_ROOM * (settings.max_rate_hz + PROBES_HZ)),
        )
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
