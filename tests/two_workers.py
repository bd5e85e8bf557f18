"""Two real workers, a real drone between them, and what its ledger says: for tests and benches."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rgbd_wire.tunnel.keys import generate_key
from tests.recordings import long_recording
from tests.service_process import ServiceProcess, free_udp_port

DRONE = "drone"
INTERRUPTED = 130
GIVE_UP_S = 120.0


class Pair:
    """Two workers, ready, on Zenoh or on the UDP tunnel."""

    def __init__(self, folder: Path, transport: str) -> None:
        self.transport = transport
        self.keys = folder / "drones.keys"
        self.keys.write_text(f"{DRONE} {generate_key()}\n")
        self.keys.chmod(0o600)
        self.services: dict[str, ServiceProcess] = {}
        self.endpoints: dict[str, str] = {}
        for name in ("worker-a", "worker-b"):
            env = {}
            if transport == "udp":
                address = f"127.0.0.1:{free_udp_port()}"
                env = {"EDGE_UDP_LISTEN": address, "EDGE_TUNNEL_KEYS": str(self.keys)}
            self.services[name] = service = ServiceProcess(folder, name, env)
            self.endpoints[name] = f"udp/{address}" if transport == "udp" else service.endpoint

    def __enter__(self) -> Pair:
        # Both start at once, and neither outlives an error of the other
        with ExitStack() as stack:
            for service in self.services.values():
                stack.callback(service.close)
                service.start()
            for service in self.services.values():
                service.wait_ready()
            self._close = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._close.close()

    @property
    def connect(self) -> str:
        """What the drone is told."""
        return ",".join(self.endpoints.values())


@dataclass(frozen=True, slots=True)
class Run:
    """The files of a run that is over."""

    frames: list[dict[str, Any]]
    ticks: list[dict[str, Any]]
    events: list[dict[str, Any]]
    summary: dict[str, Any]
    exit_code: int

    def accepted(self) -> list[dict[str, Any]]:
        """Frames whose result was accepted, by the time at which it came."""
        accepted = [f for f in self.frames if f.get("verdict") == "accepted"]
        return sorted(accepted, key=lambda f: f["t4_ns"])

    def changes(self) -> list[dict[str, Any]]:
        """Events of going from one worker to another, in order."""
        return [e for e in self.events if e["event"] == "worker" and e["before"] is not None]

    def worker_at(self, t_ns: int) -> str | None:
        """Whom the drone sent to at a time of its clock."""
        chosen = [e for e in self.events if e["event"] == "worker" and e["t_ns"] <= t_ns]
        return chosen[-1]["now"] if chosen else None


class Flying:
    """``drone-client replay`` as a process, over a recording that lasts."""

    def __init__(self, folder: Path, pair: Pair, options: Sequence[str] = ()) -> None:
        self.out = folder / "run"
        client = Path(sys.executable).with_name("drone-client")
        command = [client, "replay", long_recording(folder / "recording"), "--out", self.out]
        command += ["--connect", pair.connect, "--key-file", pair.keys, "--no-plot", *options]
        self.process = subprocess.Popen(
            [str(c) for c in command], env=os.environ | {"DRONE_REPLY_TIMEOUT_MS": "4000"}
        )

    def wait_for_accepted(self, count: int, worker: str | None = None) -> str:
        """Wait for so many more accepted results, of one worker or of any.

        Returns:
            The worker of the newest one; the drone may leave it by itself at any time.
        """
        give_up = time.monotonic() + GIVE_UP_S
        had = len(self._accepted_from())
        while time.monotonic() < give_up:
            workers = self._accepted_from()
            if sum(worker in (None, w) for w in workers[had:]) >= count:
                return workers[-1]
            assert self.process.poll() is None, "the drone has landed early"
            time.sleep(0.01)
        raise AssertionError(f"{len(self._accepted_from())} accepted within {GIVE_UP_S:g} s")

    def land(self) -> Run:
        """Ctrl-C; what the run left."""
        self.process.send_signal(signal.SIGINT)
        exit_code = self.process.wait(GIVE_UP_S)
        files = (self._lines(f"{name}.jsonl") for name in ("ledger", "ticks", "events"))
        summary = json.loads((self.out / "summary.json").read_text())
        return Run(*files, summary, exit_code)

    def close(self) -> None:
        """Whatever became of the test."""
        self.process.kill()
        self.process.wait()

    def _accepted_from(self) -> list[str]:
        lines = self._lines("ledger.jsonl") if (self.out / "ledger.jsonl").exists() else []
        return [line["worker"] for line in lines if line.get("verdict") == "accepted"]

    def _lines(self, name: str) -> list[dict[str, Any]]:
        whole = (self.out / name).read_text().rpartition("\n")[0]
        return [json.loads(line) for line in whole.splitlines()]
