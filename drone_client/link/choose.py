"""The link that a drone's settings ask for: Zenoh or the UDP tunnel, by the endpoints' kind."""

from __future__ import annotations

from typing import Any

from drone_client.errors import LinkError
from drone_client.link import Link
from drone_client.link.udp import UdpLink
from drone_client.link.zenoh import ZenohLink
from drone_client.settings import ClientSettings
from rgbd_wire.clock import Clock
from rgbd_wire.tls_files import tls_files
from rgbd_wire.tunnel.errors import KeyFileError
from rgbd_wire.tunnel.keys import load_key
from rgbd_wire.tunnel.sending import LinkState


def open_link(settings: ClientSettings, clock: Clock, drone: str | None = None) -> Link:
    """Open the link; workers come up in the background.

    Args:
        settings: endpoints, and the key or certificates that go with them.
        clock: the drone's.
        drone: its name; None: the settings' own.

    Raises:
        LinkError: an endpoint cannot be one, or the key that the tunnel needs was not given.
        WireError: a key or certificate file cannot be used.
    """
    name = drone or settings.name
    if settings.uses_tunnel:
        if settings.key_file is None:
            raise LinkError(
                "udp/ endpoints need this drone's key: give --key-file; "
                "scripts/certificates makes one, and the workers' file with it"
            )
        try:
            key = load_key(settings.key_file, name)
        except KeyFileError as error:
            raise KeyFileError(
                f"--key-file (DRONE_KEY_FILE): {error}; scripts/certificates FOLDER --drones "
                f"{name} --workers ... --tunnel-keys makes FOLDER/{name}/tunnel.key"
            ) from None
        return UdpLink(name, settings.endpoints, key, clock)

    tls = None if settings.tls is None else tls_files(settings.tls)
    return ZenohLink(name, settings.endpoints, clock, tls)


def link_summary(link: Link) -> dict[str, Any]:
    """What a link says of itself at the end of a run, as plain JSON values."""
    match link:
        case ZenohLink():
            return {
                "kind": "zenoh",
                "warnings": list(link.warnings),
                "send_errors": link.send_errors,
            }
        case UdpLink():
            states = {worker: _state(link.state(worker)) for worker in link.workers()}
            return {"kind": "udp", "refused": dict(link.counters()), "workers": states}
        case _:
            return {"kind": type(link).__name__}


def _state(state: LinkState | None) -> dict[str, float] | None:
    if state is None:
        return None
    return {
        "goodput_mbps": round(state.goodput_bps / 1e6, 3),
        "loss": round(state.loss, 4),
        "parity": round(state.parity, 4),
        "round_trip_ms": round(state.srtt_ns / 1e6, 3),
    }
