"""Proxies for where there is no root: a client connects to the proxy instead of the server.

::

    with UdpProxy(("127.0.0.1", 7448), up=Impairments(loss=0.01)) as proxy:
        sock.connect(("127.0.0.1", proxy.port))
        proxy.control.cut()
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

from link_emulator.control import Control
from link_emulator.impairments import Impairments
from link_emulator.relay_process import RelayProcess
from link_emulator.tcp_proxy import check_for_tcp


class _Proxy:
    """A proxy in a process of its own.

    Args:
        server: host and port to which it passes on.
        up: what happens from clients to the server, which they all share.
        down: what happens back; None: the same.
        listen: host and port; port 0 is any free one.
        seed: of chance.
        control_path: where a Unix socket takes commands of other processes; None: nowhere.
    """

    kind: ClassVar[str]

    def __init__(
        self,
        server: tuple[str, int],
        up: Impairments | None = None,
        down: Impairments | None = None,
        listen: tuple[str, int] = ("127.0.0.1", 0),
        seed: int = 0,
        control_path: Path | None = None,
    ) -> None:
        up = up or Impairments()
        if self.kind == "tcp":
            for impairments in (up, down or up):
                check_for_tcp(impairments)
        job = {"kind": self.kind, "listen": list(listen), "server": list(server)}
        self._relay = RelayProcess(job, up, down, seed, control_path)

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._relay.port

    @property
    def control(self) -> Control:
        """Changes the link while it runs."""
        return self._relay.control

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the proxy."""
        self._relay.close()


class UdpProxy(_Proxy):
    """Any impairment, for UDP alone."""

    kind = "udp"


class TcpProxy(_Proxy):
    """Delay, jitter, rate and partition for TCP; no loss, which a proxy cannot make.

    Raises:
        ImpairmentError: something else was asked for.
    """

    kind = "tcp"
