"""The relay's process: ``python -m link_emulator.relay_main FD``, started by ``RelayProcess``.

It does not outlive its starter: when the control channel closes it deletes the namespaces, if it
was given any, and ends.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import time
from pathlib import Path as FilePath
from typing import Any

from link_emulator import netns
from link_emulator.control import MAX_MESSAGE_BYTES
from link_emulator.errors import ControlError, EmulatorError
from link_emulator.impairments import Impairments
from link_emulator.lane import Lane
from link_emulator.loop import Loop, hurry
from link_emulator.path import Path
from link_emulator.served import Change, Served, change_path
from link_emulator.tcp_proxy import TcpRelay
from link_emulator.tun_relay import TunEnds, make_tun_relay
from link_emulator.udp_proxy import UdpRelay


def main() -> None:
    """Relay until the starter hangs up."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is the starter's to understand
    owner = socket.socket(fileno=int(sys.argv[1]))
    job = json.loads(owner.recv(MAX_MESSAGE_BYTES))
    try:
        _relay(owner, job)
    finally:
        for name in job.get("namespaces", ()):
            netns.delete(name)


def _relay(owner: socket.socket, job: dict[str, Any]) -> None:
    try:
        up, down = (Impairments().changed(job[name]) for name in ("up", "down"))
        change: Change = change_path
        port = 0
        loop: Loop
        up_lane: Lane[Any]
        down_lane: Lane[Any]
        if job["kind"] == "tcp":
            tcp = TcpRelay(tuple(job["listen"]), tuple(job["server"]), up, down, job["seed"])
            loop, up_lane, down_lane = tcp.loop, tcp.up, tcp.down
            port, change = tcp.port, tcp.change
        else:
            start_ns = time.monotonic_ns()
            paths = Path(up, job["seed"], start_ns), Path(down, job["seed"] + 1, start_ns)
            if job["kind"] == "udp":
                udp = UdpRelay(tuple(job["listen"]), tuple(job["server"]), *paths)
                loop, up_lane, down_lane, port = udp.loop, udp.up, udp.down, udp.port
            else:
                loop, up_lane, down_lane = make_tun_relay(TunEnds(**job["ends"]), *paths)
        served = Served(owner, loop, up_lane, down_lane, hurry(), change)
        if job["control"] is not None:
            _listen(served, job["control"])
    except EmulatorError as error:
        owner.send(json.dumps({"error": str(error)}).encode())
        return
    except OSError as error:
        owner.send(json.dumps({"error": f"{_place(job)}: {error.strerror or error}"}).encode())
        return
    owner.send(json.dumps({"ok": True, "port": port}).encode())
    try:
        loop.run()
    finally:
        if job["control"] is not None:
            os.unlink(job["control"])


def _listen(served: Served, path: str) -> None:
    try:
        served.listen(FilePath(path))
    except OSError as error:
        raise ControlError(
            f"--control {path}: {error.strerror or error}; give a path that is free"
        ) from None


def _place(job: dict[str, Any]) -> str:
    """What a job was about to open."""
    if "listen" not in job:
        return "the link between the namespaces"
    host, port = job["listen"]
    return f"cannot listen on {host}:{port} (--listen)"


if __name__ == "__main__":
    main()
