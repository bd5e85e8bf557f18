"""All settings of the service: read once from ``EDGE_*``, checked, frozen, passed on by value."""

from __future__ import annotations

import difflib
import os
import re
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, SettingsConfigDict

from edge_service.batching import BatchLimits
from edge_service.errors import SettingsError

PREFIX = "EDGE_"
NAME_PATTERN = r"^[a-z0-9][a-z0-9_-]{0,31}$"
"""As ``rgbd_wire.messages.Name``; in pydantic's Rust regex ``$`` is the very end of the text."""
_KUBERNETES_LINK = re.compile(
    r"\w*(SERVICE_HOST=\S+|SERVICE_PORT(_\w+)?=\d+|PORT=\w+://\S+"
    r"|PORT_\d+_(TCP|UDP|SCTP)(=\w+://\S+|_(ADDR|PORT|PROTO)=\S+))"
)
"""What Kubernetes tells every pod of the Services beside it; one called "edge" has our prefix."""


FLAGS = {
    "zenoh_listen": "--listen",
    "zenoh_connect": "--connect",
    "zenoh_tls": "--tls",
    "zenoh_drones": "--drones",
    "udp_listen": "--udp",
    "tunnel_keys": "--keys",
    "model_cache": "--model-cache",
    "self_check": "--self-check",
}
"""Flags of the command that are not called as their settings are."""


def default_name() -> str:
    """The machine's name, as far as it may be a worker's name; a pod's is unique by its end."""
    name = re.sub(r"[^a-z0-9_-]+", "-", socket.gethostname().lower())
    return name[-32:].strip("-_") or "worker"


class EdgeSettings(BaseSettings):
    """What the service may be told; every field is the variable ``EDGE_<NAME>``."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_ignore_empty=True, frozen=True, extra="forbid"
    )

    name: str = Field(
        default_factory=default_name,
        pattern=NAME_PATTERN,
        description="This worker's name, one per worker: a-z, 0-9, _ and -. Default: the host's.",
    )
    zenoh_listen: str = Field(
        "tcp/0.0.0.0:7447",
        max_length=1000,
        description="Zenoh endpoints to listen on, separated by commas. Set and empty beside "
        "EDGE_UDP_LISTEN: no Zenoh.",
    )
    zenoh_connect: str = Field(
        "",
        max_length=1000,
        description="Zenoh routers to join instead of listening, separated by commas.",
    )
    zenoh_lease_ms: int = Field(
        1000,
        ge=100,
        le=60_000,
        description="A link without a sign of life for so long [ms] is given up.",
    )
    zenoh_tls: Path | None = Field(
        None,
        description="Folder of ca.pem, cert.pem and key.pem: Zenoh over mutual TLS. Default: none.",
    )
    zenoh_drones: str = Field(
        "",
        max_length=40_000,
        description="Drones whose certificates may come in over TLS, separated by commas.",
    )
    udp_listen: str = Field(
        "",
        max_length=255,
        description="HOST:PORT on which the UDP tunnel listens, beside Zenoh. Default: no tunnel.",
    )
    tunnel_keys: Path | None = Field(
        None, description="The drones' keys for the tunnel: lines of a name and 64 hex digits."
    )
    http: str = Field(
        "0.0.0.0:8080", max_length=255, description="HOST:PORT of the HTTP side; port 0: any free."
    )
    http_waiting: int = Field(
        4, ge=1, le=64, description="Pictures handed in over HTTP that may wait; more get a 503."
    )
    http_upload_mb: int = Field(
        24, ge=1, le=128, description="Largest upload over HTTP [MB]; more gets a 413."
    )
    target: str = Field(
        "bullseye-400",
        min_length=1,
        max_length=1000,
        description="Name of a packaged target, or the path of a target's TOML file.",
    )
    method: Literal["fused", "pnp"] = Field(
        "fused",
        description="How a target is localised: fused, from its circles and the depth's plane; "
        "pnp, from points: the [[points]] of a target's file, or the corners of a board.",
    )
    engine: Literal["torch", "onnxruntime", "openvino"] = Field(
        "torch", description="What runs the detector; the other two are extras of the package."
    )
    weights: Path | None = Field(
        None,
        description="The detector's weights, a safetensors file, or for onnxruntime and openvino "
        "an ONNX file, a YOLOv8 or v11 export (also pose) included. Default: those packaged.",
    )
    classes: str | None = Field(
        None,
        max_length=10_000,
        description="Classes of a foreign ONNX file in its order, separated by commas: T_good, "
        "T_better, T_best, and - for any other. Default: as the file names them.",
    )
    model_cache: Path | None = Field(
        None,
        description="Folder where weights converted for onnxruntime and openvino are kept. "
        "Default: ~/.cache/aerial-contact.",
    )
    threads: int | None = Field(
        None,
        ge=1,
        le=256,
        description="Threads of the detector. Default: what the CPU quota allows.",
    )
    precision: Literal["auto", "fp32", "bf16", "fp16"] = Field(
        "auto",
        description="The detector's arithmetic; auto: the faster one on this CPU, fp16 on a GPU.",
    )
    device: Literal["auto", "cpu", "cuda"] = Field(
        "auto", description="Where torch runs the detector; auto: on a GPU when there is one."
    )
    self_check: Literal["refuse", "warn", "off"] = Field(
        "refuse",
        description="What a worker does whose detector does not find a drawn target at the start.",
    )
    max_candidates: int = Field(
        3, ge=1, le=16, description="Targets of one picture that are tried, best first."
    )
    world_is_level: bool = Field(
        True,
        description="The drones' world is ENU, so that its z tells which edge of the board is up; "
        "false for recordings with a world of their own.",
    )
    max_drones: int = Field(
        64,
        ge=1,
        le=1024,
        description="Drones served at a time; frames of more are refused. One frame of each may "
        "wait: 0.1 MB as a rule, 8 MB at most.",
    )
    drone_idle_s: float = Field(
        30.0, ge=1, le=3600, description="A drone silent for so long [s] may lose its place."
    )
    max_rate_hz: float = Field(
        60.0,
        ge=1,
        le=1000,
        description="Frames a second [Hz] of one drone that are taken; more are turned away. Over "
        "twice as many it counts as flooding, and one a second is taken.",
    )
    batch_max: int = Field(
        1,
        ge=1,
        le=16,
        description="Frames of different drones that the detector takes at once. More than 1 pays "
        "on a GPU; on a CPU it only makes each of them wait for the others.",
    )
    batch_wait_ms: float = Field(
        0.0,
        ge=0,
        le=100,
        description="How long [ms] a frame waits for others to go with, if its budget allows it.",
    )
    drain_s: float = Field(
        5.0, ge=0, le=60, description="Longest time [s] that a stop takes to answer what is there."
    )
    heartbeat_s: float = Field(
        10.0, ge=1, le=600, description="/livez fails when the worker is stuck for so long [s]."
    )
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = Field(
        "WARNING", description="What is logged, as JSON lines on stderr."
    )

    @field_validator("zenoh_listen", "zenoh_connect")
    @classmethod
    def _endpoints(cls, value: str) -> str:
        for endpoint in _split(value):
            if not re.fullmatch(r"[a-z_-]+/\S+", endpoint):
                raise ValueError("must be endpoints such as tcp/0.0.0.0:7447")
        return value

    @field_validator("http", "udp_listen")
    @classmethod
    def _host_and_port(cls, value: str, info: ValidationInfo) -> str:
        if info.field_name == "udp_listen" and not value:
            return value
        host, _, port = value.rpartition(":")
        if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
            raise ValueError("must be HOST:PORT such as 0.0.0.0:8080")
        return value

    @model_validator(mode="after")
    def _one_way(self) -> EdgeSettings:
        if not self.has_zenoh and not self.udp_listen:
            raise ValueError(
                "neither EDGE_ZENOH_LISTEN nor EDGE_ZENOH_CONNECT nor EDGE_UDP_LISTEN: no way in"
            )
        if self.udp_listen and self.tunnel_keys is None:
            raise ValueError(
                "EDGE_UDP_LISTEN needs the drones' keys: name their file with EDGE_TUNNEL_KEYS"
            )
        return self

    @model_validator(mode="after")
    def _nothing_in_vain(self) -> EdgeSettings:
        """Who names keys or certificates believes them in use: without their link nobody starts."""
        if self.tunnel_keys is not None and not self.udp_listen:
            raise ValueError(
                "--keys (EDGE_TUNNEL_KEYS) is given and there is no tunnel: "
                "add --udp 0.0.0.0:7448 (EDGE_UDP_LISTEN), or leave the keys out"
            )
        if self.zenoh_drones and self.zenoh_tls is None:
            raise ValueError(
                "--drones (EDGE_ZENOH_DRONES) says who may come in over TLS, and there is none: "
                "add --tls FOLDER (EDGE_ZENOH_TLS), or leave the drones out"
            )
        if self.zenoh_tls is not None and not self.has_zenoh:
            raise ValueError(
                "--tls (EDGE_ZENOH_TLS) is given and there is no Zenoh: add --listen "
                "tls/0.0.0.0:7447 (EDGE_ZENOH_LISTEN), or leave the certificates out"
            )
        return self

    @property
    def has_zenoh(self) -> bool:
        """There is a Zenoh endpoint to listen on or a router to join."""
        return bool(_split(self.zenoh_connect) or _split(self.zenoh_listen))

    @property
    def listen_endpoints(self) -> tuple[str, ...]:
        """Endpoints to listen on; none when a router elsewhere is joined."""
        return () if self.zenoh_connect else _split(self.zenoh_listen)

    @property
    def connect_endpoints(self) -> tuple[str, ...]:
        """Endpoints of routers to join."""
        return _split(self.zenoh_connect)

    @property
    def drone_names(self) -> tuple[str, ...]:
        """Drones that may come in over TLS."""
        return _split(self.zenoh_drones)

    @property
    def batch_limits(self) -> BatchLimits:
        """Of the batches that go through the detector."""
        return BatchLimits(self.batch_max, round(self.batch_wait_ms * 1e6))

    @property
    def http_address(self) -> tuple[str, int]:
        """Host and port of the HTTP side."""
        host, _, port = self.http.rpartition(":")
        return host.strip("[]"), int(port)


def load_settings(**flags: Any) -> EdgeSettings:
    """Settings of the environment, with flags before variables; a flag that is None was not given.

    Raises:
        SettingsError: a variable is unknown, or a value is malformed or out of bounds.
    """
    _refuse_unknown(os.environ)
    given = {name: value for name, value in flags.items() if value is not None}
    # Elsewhere an empty variable is one that was not set, as compose files pass them on. Here it
    # is the one way to say "none", and only where the tunnel is a way in.
    udp = given.get("udp_listen") or os.environ.get(f"{PREFIX}UDP_LISTEN")
    if udp and os.environ.get(f"{PREFIX}ZENOH_LISTEN") == "":
        given.setdefault("zenoh_listen", "")
    try:
        return EdgeSettings(**given)
    except ValidationError as error:
        raise SettingsError("; ".join(_sentence(e, given) for e in error.errors())) from None


def _refuse_unknown(environ: Mapping[str, str]) -> None:
    known = [name.upper() for name in EdgeSettings.model_fields]
    for variable, value in environ.items():
        name = variable.removeprefix(PREFIX)
        if name == variable or name in known or _KUBERNETES_LINK.fullmatch(f"{name}={value}"):
            continue
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {PREFIX}{near[0]}?" if near else "edge-service settings lists all"
        raise SettingsError(f"{variable} is no setting; {hint}")


def _sentence(error: ErrorDetails, flags: Mapping[str, Any]) -> str:
    message = error["msg"].removeprefix("Value error, ")
    if not error["loc"]:
        return message
    name = str(error["loc"][0])
    where = FLAGS.get(name, f"--{name}") if name in flags else PREFIX + name.upper()
    return f"{where}: {message[:200]}, not {error['input']!r:.100}"


def _split(endpoints: str) -> tuple[str, ...]:
    return tuple(e for part in endpoints.split(",") if (e := part.strip()))
