"""The client's settings: read once from ``DRONE_*``, frozen, bounded, passed down by value."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from drone_client.errors import ClientError
from drone_client.gate import GateSettings
from drone_client.ros.names import MAX_DOMAIN, Flavour
from rgbd_wire.color import DEFAULT_JPEG_QUALITY
from rgbd_wire.streams import FRAME, RESULT
from target_pose.target import DEFAULT_TARGET

ENV_PREFIX = "DRONE_"
NS_PER_MS = 1_000_000
TUNNEL_PREFIX = "udp/"


class ClientSettings(BaseSettings):
    """Everything that can be set about a run of the client."""

    model_config = SettingsConfigDict(
        env_prefix=ENV_PREFIX, env_ignore_empty=True, frozen=True, extra="forbid"
    )

    name: str = Field(
        "drone",
        pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$",
        description="this drone's name: a-z, 0-9, _ and -, at most 32",
    )
    connect: str = Field(
        "tcp/127.0.0.1:7447",
        max_length=4000,
        description="workers' endpoints, separated by commas: tcp/HOST:PORT or tls/HOST:PORT for "
        "Zenoh, or udp/HOST:PORT for the UDP tunnel; all of one of the two",
    )
    key_file: Path | None = Field(
        None, description="this drone's key for the UDP tunnel: a file with the line `NAME HEX`"
    )
    tls: Path | None = Field(
        None, description="folder with ca.pem, cert.pem and key.pem for tls/ endpoints"
    )
    tau_max_ms: float = Field(
        FRAME.max_age_ms, ge=0.001, le=10_000, description="largest network delay d1+d2 [ms]"
    )
    age_max_ms: float = Field(
        RESULT.max_age_ms,
        ge=0.001,
        le=10_000,
        description="largest age of a result on arrival [ms]",
    )
    window: int = Field(2, ge=1, le=16, description="frames in the network at most")
    ack_timeout_ms: float = Field(
        500.0,
        ge=0.001,
        le=10_000,
        description="a frame's slot is freed by force after this [ms]",
    )
    reply_timeout_ms: float = Field(
        2000.0, ge=0.001, le=60_000, description="a frame counts as unanswered after this [ms]"
    )
    jpeg_quality: int = Field(
        DEFAULT_JPEG_QUALITY, ge=1, le=100, description="best JPEG quality of colour"
    )
    rate_control: bool = Field(
        True,
        description="choose quality and depth region by the link's goodput, so that a frame takes "
        "a third of tau_max at most; off: all frames at the best",
    )
    hedge: bool = Field(
        False,
        description="send a second copy of a frame whose answer is late to another worker",
    )
    ros_topic: str | None = Field(
        None, max_length=200, description="publish accepted poses to ROS 2 under this topic"
    )
    ros_connect: str = Field(
        "tcp/127.0.0.1:7447",
        max_length=1000,
        description="Zenoh bridge or router of ROS 2, separated by commas",
    )
    ros_flavour: Flavour = Field(
        Flavour.BRIDGE, description="bridge: zenoh-bridge-ros2dds; rmw_zenoh: nodes that speak it"
    )
    ros_domain: int = Field(
        0, ge=0, le=MAX_DOMAIN, description="ROS_DOMAIN_ID of those nodes; a bridge has its own"
    )
    onboard_fallback: bool = Field(
        False,
        description="while no fresh result is left, look for the target on board, where the last "
        "accepted pose and the drone's own motion put it; needs no network",
    )
    onboard_target: str = Field(
        DEFAULT_TARGET,
        min_length=1,
        max_length=1000,
        description="what hangs there, for --onboard-fallback: the name of a packaged target, or "
        "the path of a target's TOML file; the same as the service's EDGE_TARGET",
    )
    onboard_max_s: float = Field(
        5.0,
        ge=0.5,
        le=30,
        description="so long after the last accepted pose the drone goes on by its own eyes [s]; "
        "then it holds, stops and retreats as without them",
    )
    onboard_growth_mm_s: float = Field(
        10.0,
        ge=1,
        le=100,
        description="by how much the safety filter's error ball grows while nobody confirms what "
        "is seen on board [mm/s]: a long outage turns into a retreat by itself",
    )
    control_hz: float = Field(
        50.0,
        ge=25,  # below, one late turn and the dead man stops the vehicle between two commands
        le=500,
        description="rate of the control loop [Hz]",
    )
    wait_for_worker_s: float = Field(
        10.0, ge=0, le=600, description="how long to wait for a first worker [s]"
    )

    @model_validator(mode="after")
    def _age_covers_the_network(self) -> Self:
        if self.tau_max_ms > self.age_max_ms:
            raise ValueError(
                f"--tau-max-ms = {self.tau_max_ms:g} exceeds --age-max-ms = {self.age_max_ms:g}: "
                "a result is at least as old as its time on the network; raise --age-max-ms too"
            )
        return self

    @field_validator("connect")
    @classmethod
    def _endpoints_of_one_kind(cls, value: str) -> str:
        kinds = {e.startswith(TUNNEL_PREFIX) for e in split_endpoints(value)}
        if not kinds:
            raise ValueError("no endpoint; such as tcp/192.0.2.7:7447 or udp/192.0.2.7:7448")
        if len(kinds) > 1:
            raise ValueError("udp/ endpoints and others do not mix: a drone has one kind of link")
        return value

    @property
    def gate(self) -> GateSettings:
        """The two bounds of the delay gate."""
        return GateSettings(round(self.tau_max_ms * NS_PER_MS), round(self.age_max_ms * NS_PER_MS))

    @property
    def endpoints(self) -> tuple[str, ...]:
        """The workers' endpoints, apart."""
        return split_endpoints(self.connect)

    @property
    def uses_tunnel(self) -> bool:
        """The endpoints are the UDP tunnel's."""
        return self.endpoints[0].startswith(TUNNEL_PREFIX)


def split_endpoints(connect: str) -> tuple[str, ...]:
    """Endpoints of a list with commas."""
    return tuple(e.strip() for e in connect.split(",") if e.strip())


def load_settings(**flags: Any) -> ClientSettings:
    """Settings of the environment, with the command line's flags above them (None: not given).

    Raises:
        ClientError: names the variable or flag at fault and what it may be.
    """
    known = [f"{ENV_PREFIX}{name.upper()}" for name in ClientSettings.model_fields]
    for name in os.environ:
        if name.startswith(ENV_PREFIX) and name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"
            raise ClientError(f"unknown setting {name}{hint}")
    given = {key: value for key, value in flags.items() if value is not None}
    try:
        return ClientSettings(**given)
    except ValidationError as error:
        first = error.errors()[0]
        if not first["loc"]:
            raise ClientError(str(first["ctx"]["error"])) from None
        field = str(first["loc"][0])
        source = f"--{field.replace('_', '-')}" if field in given else known_name(field)
        meaning = ClientSettings.model_fields[field].description
        raise ClientError(
            f"{source} = {first['input']!r}: "
            f"{first['msg'].removeprefix('Value error, ').lower()} ({meaning})"
        ) from None


def default_settings() -> ClientSettings:
    """Settings that no environment touches: what is flown in lockstep is the same everywhere."""
    return ClientSettings.model_construct()


def about(field: str) -> str:
    """Help of the flag that stands for a field: what it is, and its default."""
    info = ClientSettings.model_fields[field]
    default = "" if info.default is None else f" (default: {info.default})"
    return f"{info.description}{default}"


def known_name(field: str) -> str:
    """Environment variable of a field."""
    return f"{ENV_PREFIX}{field.upper()}"
