"""The link that a drone's settings ask for: Zenoh or the UDP tunnel, by the endpoints' kind."""

from __future__ import annotations

from drone_client.errors import LinkError
from drone_client.link import Link
from drone_client.settings import ClientSettings
from rgbd_wire.clock import Clock
from rgbd_wire.tls_files import tls_files


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
        from drone_client.link.udp import UdpLink
        from rgbd_wire.tunnel.keys import load_key

        if settings.key_file is None:
            raise LinkError(
                "udp/ endpoints need this drone's key: give --key-file; "
                "scripts/certificates makes one, and the workers' file with it"
            )
        return UdpLink(name, settings.endpoints, load_key(settings.key_file, name), clock)

    from drone_client.link.zenoh import ZenohLink

    tls = None if settings.tls is None else tls_files(settings.tls)
    return ZenohLink(name, settings.endpoints, clock, tls)
