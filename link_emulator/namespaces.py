"""Two network namespaces with a bad link between them, as a context manager. Needs root.

::

    with Namespaces(up=Impairments(rate_mbit=20, delay_ms=10)) as net:
        server = net.popen("b", ["iperf3", "-s"])
        client = net.popen("a", ["iperf3", "-c", net.address_b])
        net.control.cut()
        ...
        print(net.control.report())
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from link_emulator import netns
from link_emulator.control import Control
from link_emulator.errors import NotPermittedError
from link_emulator.impairments import Impairments
from link_emulator.relay_process import RelayProcess
from link_emulator.tun import DEVICE

NETWORK, ADDRESS_A, ADDRESS_B, PREFIX = "10.203.0.0/30", "10.203.0.1", "10.203.0.2", 30
CONGESTION_CONTROLS = Path("/proc/sys/net/ipv4/tcp_available_congestion_control")
_numbers = itertools.count()


def may_make_namespaces() -> str | None:
    """Why this process cannot make namespaces with TUN devices; None: it can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        return "there is no /dev/net/tun"
    try:
        netns.ip("-V")
    except NotPermittedError as error:
        return str(error)
    return None


class Namespaces:
    """Namespaces ``a`` (``address_a``) and ``b`` (``address_b``), each with a device of MTU 1500.

    ``control`` changes the link while it runs. At the end, also when the block is left by an
    error, all processes in the namespaces are ended and the namespaces deleted; when this process
    is killed the relay does it, and when the relay is killed as well, the next ``Namespaces`` does.

    Args:
        up: what happens from a to b.
        down: what happens from b to a; None: the same.
        seed: of chance.
        control_path: where a Unix socket takes commands of other processes; None: nowhere.

    Raises:
        NotPermittedError: on entering; says what is missing.
    """

    address_a = ADDRESS_A
    address_b = ADDRESS_B

    def __init__(
        self,
        up: Impairments | None = None,
        down: Impairments | None = None,
        seed: int = 0,
        control_path: Path | None = None,
    ) -> None:
        self._up = up or Impairments()
        self._down = down
        self._seed = seed
        self._control_path = control_path
        number = next(_numbers)
        self.names = {end: netns.owned_name(number, end) for end in ("a", "b")}
        self._relay: RelayProcess | None = None
        self._processes: list[subprocess.Popen[Any]] = []

    @property
    def control(self) -> Control:
        """The relay's control channel."""
        assert self._relay is not None, "enter first"
        return self._relay.control

    @property
    def relay_pid(self) -> int:
        """The relay's process."""
        assert self._relay is not None, "enter first"
        return self._relay.pid

    def __enter__(self) -> Namespaces:
        why_not = may_make_namespaces()
        if why_not is not None:
            raise NotPermittedError(why_not)
        netns.sweep()
        try:
            for name in self.names.values():
                netns.make(name)
            ends = {
                "namespace_a": self.names["a"],
                "address_a": f"{ADDRESS_A}/{PREFIX}",
                "namespace_b": self.names["b"],
                "address_b": f"{ADDRESS_B}/{PREFIX}",
            }
            job = {"kind": "tun", "ends": ends, "namespaces": list(self.names.values())}
            self._relay = RelayProcess(job, self._up, self._down, self._seed, self._control_path)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def popen(
        self, end: Literal["a", "b"], command: Sequence[str | os.PathLike[str]], **options: Any
    ) -> subprocess.Popen[Any]:
        """Start a process in a namespace; it ends with this process's calling thread.

        Args:
            end: which namespace.
            command: program and arguments.
            **options: as for ``subprocess.Popen``.
        """
        launcher = [sys.executable, "-m", "link_emulator.enter", self.names[end], str(os.getpid())]
        process = subprocess.Popen([*launcher, *(os.fspath(part) for part in command)], **options)
        self._processes.append(process)
        return process

    def congestion_control(self, end: Literal["a", "b"], name: str) -> None:
        """Let all TCP connections that begin in a namespace use one congestion control.

        It goes with the route: the kernel keeps what its system settings do not list from being
        the default of any namespace but its first.

        Args:
            end: which namespace.
            name: one that the kernel has, such as ``cubic`` or ``bbr``.

        Raises:
            NotPermittedError: it has none of that name; lists those that it has.
        """
        available = CONGESTION_CONTROLS.read_text().split()
        if name not in available:
            raise NotPermittedError(f"no {name!r} in this kernel; there are {', '.join(available)}")
        source = ADDRESS_A if end == "a" else ADDRESS_B
        route = f"{NETWORK} dev {DEVICE} proto kernel scope link src {source} congctl {name}"
        netns.ip("-n", self.names[end], "route", "replace", *route.split())

    def close(self) -> None:
        """End everything; may be called twice."""
        for process in self._processes:
            if process.poll() is None:
                process.kill()
        for process in self._processes:
            process.wait()
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()
        self._processes.clear()
        if self._relay is not None:
            self._relay.close()
        for name in self.names.values():
            netns.delete(name)
