"""All settings of the service: read once from ``EDGE_*``, checked, frozen, passed on by value."""

from __future__ import annotations

import difflib
import os
import re
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, SettingsConfigDict

from edge_service.errors import SettingsError

PREFIX = "EDGE_"
NAME_PATTERN = r"^[a-z0-9][a-z0-9_-]{0,31}$"
"""As ``rgbd_wire.messages.Name``; in pydantic's Rust regex ``$`` is the very end of the text."""
_KUBERNETES_LINK = re.compile(
    r"\w*(SERVICE_HOST=\S+|SERVICE_PORT(_\w+)?=\d+|PORT=\w+://\S+"
    r"|PORT_\d+_(TCP|UDP|SCTP)(=\w+://\S+|_(ADDR|PORT|PROTO)=\S+))"
)
"""What Kubernetes tells every pod of the Services beside it; one called "edge" has our prefix."""


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
        description="Zenoh endpoints to listen on, separated by commas.",
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
    weights: Path | None = Field(
        None, description="The detector's weights, a safetensors file. Default: those packaged."
    )
    threads: int | None = Field(
        None,
        ge=1,
        le=256,
        description="Threads of the detector. Default: what the CPU quota allows.",
    )
    precision: Literal["auto", "fp32", "bf16"] = Field(
        "auto", description="The detector's arithmetic; auto: the faster one on this CPU."
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

    @field_validator("http")
    @classmethod
    def _host_and_port(cls, value: str) -> str:
        host, _, port = value.rpartition(":")
        if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
            raise ValueError("must be HOST:PORT such as 0.0.0.0:8080")
        return value

    @model_validator(mode="after")
    def _one_way(self) -> EdgeSettings:
        if not self.zenoh_connect and not _split(self.zenoh_listen):
            raise ValueError("neither EDGE_ZENOH_LISTEN nor EDGE_ZENOH_CONNECT: no way in")
        return self

    @property
    def listen_endpoints(self) -> tuple[str, ...]:
        """Endpoints to listen on; none when a router elsewhere is joined."""
        return () if self.zenoh_connect else _split(self.zenoh_listen)

    @property
    def connect_endpoints(self) -> tuple[str, ...]:
        """Endpoints of routers to join."""
        return _split(self.zenoh_connect)

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
    where = f"--{name.removeprefix('zenoh_')}" if name in flags else PREFIX + name.upper()
    return f"{where}: {message[:200]}, not {error['input']!r:.100}"


def _split(endpoints: str) -> tuple[str, ...]:
    return tuple(e for part in endpoints.split(",") if (e := part.strip()))
