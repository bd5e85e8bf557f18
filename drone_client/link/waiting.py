"""Waiting for a first worker, and why there is none."""

from __future__ import annotations

import time

from drone_client.errors import LinkError
from drone_client.link import Link
from drone_client.link.diagnosis import diagnose
from drone_client.settings import ClientSettings
from rgbd_wire.tls_files import tls_files

MAX_KNOCKS = 4
"""Endpoints that are looked at when nobody answers; each may take some seconds."""


def wait_for_worker(link: Link, settings: ClientSettings) -> tuple[str, ...]:
    """Names of the workers, as soon as there is one.

    Raises:
        LinkError: none came in time.
    """
    give_up = time.monotonic() + settings.wait_for_worker_s
    while not (workers := link.workers()):
        if time.monotonic() >= give_up:
            raise LinkError(
                f"no worker answers at {settings.connect} within {settings.wait_for_worker_s:g} s; "
                + _reasons(settings)
            )
        time.sleep(0.02)
    return workers


def _reasons(settings: ClientSettings) -> str:
    if settings.uses_tunnel:
        return "is edge-service running there with EDGE_UDP_LISTEN, and does it have our key?"
    tls = None if settings.tls is None else tls_files(settings.tls)
    return "; ".join(diagnose(endpoint, tls) for endpoint in settings.endpoints[:MAX_KNOCKS])
