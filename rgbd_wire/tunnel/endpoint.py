"""Texts that name UDP endpoints: ``udp/HOST:PORT``."""

from __future__ import annotations

import re

from rgbd_wire.tunnel.errors import EndpointError

_ENDPOINT = re.compile(r"udp/(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):([0-9]{1,5})")


def parse_endpoint(text: str) -> tuple[str, int]:
    """Host, without the brackets of IPv6, and port (0: any free one) of an endpoint.

    Raises:
        EndpointError: says what an endpoint looks like.
    """
    match = _ENDPOINT.fullmatch(text)
    if match is None or int(match[2]) > 65535:
        hint = "such as udp/192.0.2.7:7448"
        if _ENDPOINT.fullmatch(f"udp/{text}"):
            hint = f"did you mean udp/{text}?"
        raise EndpointError(f"endpoint {text!r} is not udp/HOST:PORT; {hint}")
    return match[1].strip("[]"), int(match[2])
