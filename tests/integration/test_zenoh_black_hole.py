"""A worker that hangs or cannot be reached does not hurt the way to the others.

Without root: an address that swallows every packet is a listener whose backlog is full, and a hung
worker is a process that SIGSTOP holds.
"""

from __future__ import annotations

import contextlib
import queue
import signal
import socket
import subprocess
import sys

import pytest

from drone_client.link.zenoh import ZenohLink
from rgbd_wire.clock import MonotonicClock
from tests.deploy.manifests import ROOT
from tests.service_process import free_port
from tests.unit.drone_client.builders import eventually

BUDGET_NS = 250_000_000
WAIT_S = 20.0
FRAME_BYTES = 200_000


@contextlib.contextmanager
def echo_worker(name):
    """A process with a worker's transport that sends back the head of every message."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.integration.echo_worker", name, endpoint],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout.readline() == "ready\n"
        yield process, endpoint
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


class Drone:
    """A link, and the answers of each worker apart."""

    def __init__(self, *endpoints):
        self.answers = {"a": queue.Queue(), "b": queue.Queue()}
        self.changes = queue.Queue()
        self.link = ZenohLink("drone-1", endpoints, MonotonicClock())
        self.link.start(
            lambda data, _t4_ns: self.answers[data[:1].decode()].put(data[1:5]),
            lambda: self.changes.put(self.link.workers()),
        )

    def sees(self, *workers):
        return eventually(lambda: self.link.workers() == workers, timeout_s=WAIT_S)

    def send(self, worker, number):
        head = worker.encode() + number.to_bytes(4, "little")
        self.link.send(worker, head + bytes(FRAME_BYTES), BUDGET_NS)

    def answer(self, worker):
        return int.from_bytes(self.answers[worker].get(timeout=WAIT_S), "little")


@contextlib.contextmanager
def black_hole():
    """An endpoint on which no connection is ever answered."""
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.socket())
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(4):  # the backlog is full after two; the rest waits for ever
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(listener.getsockname())
        yield f"tcp/127.0.0.1:{listener.getsockname()[1]}"


@contextlib.contextmanager
def mute():
    """An endpoint on which every connection stands, and nobody says a word."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(100)
        yield f"tcp/127.0.0.1:{listener.getsockname()[1]}"


@pytest.mark.parametrize("nobody", [black_hole, mute])
@pytest.mark.parametrize("is_first", [True, False])
def test_an_endpoint_that_never_answers_keeps_the_drone_from_no_worker(nobody, is_first):
    """Wherever it stands in the list, the worker is found and serves."""
    with nobody() as hole, echo_worker("b") as (_, endpoint):
        drone = Drone(*((hole, endpoint) if is_first else (endpoint, hole)))
        assert drone.sees("b")
        for number in range(10):
            drone.send("b", number)
            assert drone.answer("b") == number
        drone.link.close()


@pytest.mark.parametrize("blow", [signal.SIGSTOP, signal.SIGKILL])
def test_a_worker_that_hangs_or_dies_takes_no_frame_of_another_with_it(blow):
    """Frames to it go on; each frame to the other is answered; its token goes, and it alone."""
    with echo_worker("a") as (process, first), echo_worker("b") as (_, second):
        drone = Drone(first, second)
        assert drone.sees("a", "b")
        for worker in ("a", "b"):
            drone.send(worker, 0)
            assert drone.answer(worker) == 0
        process.send_signal(blow)
        number = 0
        while drone.link.workers() == ("a", "b") and number < 2000:
            number += 1
            drone.send("a", number)  # more than any queue or buffer takes
            drone.send("b", number)
            assert drone.answer("b") == number
        assert drone.sees("b")
        drone.send("b", 7)
        assert drone.answer("b") == 7
        drone.link.close()


def test_a_worker_that_comes_to_itself_again_is_served_again():
    """Its session was given up meanwhile; it gets a new one, and its token comes back."""
    with echo_worker("a") as (process, endpoint):
        drone = Drone(endpoint)
        assert drone.sees("a")
        process.send_signal(signal.SIGSTOP)
        assert drone.sees()
        process.send_signal(signal.SIGCONT)
        assert drone.sees("a")
        drone.send("a", 1)
        assert drone.answer("a") == 1
        drone.link.close()
