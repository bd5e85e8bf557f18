"""The PX4-like peer as a process, and an autopilot of ours that speaks with it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.mavlink import MavlinkAutopilot
from rgbd_wire.clock import MonotonicClock

GIVE_UP_S = 30.0
"""A machine may be many times slower than ours."""
PEER = Path(__file__).with_name("px4_peer.py")


class PeerProcess:
    """``px4_peer.py``, driven over its standard input."""

    def __init__(self, *options: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(PEER), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        assert self._read() == "ready"

    def tell(self, command: str) -> str:
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        return self._read()

    def report(self) -> dict:
        return json.loads(self.tell("report"))

    def kill(self) -> None:
        self._process.kill()
        self.close()

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def _read(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


def until(condition: Callable[[], object], what: str) -> None:
    """Wait until something holds."""
    end = time.monotonic() + GIVE_UP_S
    while not condition():
        assert time.monotonic() < end, f"never: {what}"
        time.sleep(0.01)


class Commander:
    """A control loop's stand-in: leaves commands while ``fly`` runs."""

    def __init__(self, autopilot: MavlinkAutopilot) -> None:
        self._autopilot = autopilot
        self._clock = MonotonicClock()

    def once(self, velocity: tuple[float, float, float], yaw_rate: float = 0.0) -> int:
        """Leave a command; returns its time [ns]."""
        t_ns = self._clock.now_ns()
        self._autopilot.command(VelocityCommand(np.array(velocity), yaw_rate, t_ns))
        return t_ns

    def fly(
        self,
        velocity: tuple[float, float, float],
        while_not: Callable[[], object],
        yaw_rate: float = 0.0,
    ) -> None:
        end = time.monotonic() + GIVE_UP_S
        while not while_not():
            assert time.monotonic() < end, "never came to an end"
            self.once(velocity, yaw_rate)
            time.sleep(0.01)


def engaged(autopilot: MavlinkAutopilot) -> bool:
    state = autopilot.state()
    return state is not None and state.obeying


def mode(autopilot: MavlinkAutopilot) -> str:
    state = autopilot.state()
    return "" if state is None else state.mode
