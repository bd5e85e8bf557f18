"""The link over the UDP tunnel: a sealed session to every worker (docs/protocol.md)."""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Mapping

from drone_client.errors import LinkError
from drone_client.link import OnMessage, OnWorkers
from drone_client.link.udp_endpoint import PING_EVERY_NS, Endpoint, Line
from rgbd_wire.clock import Clock
from rgbd_wire.streams import PROBE
from rgbd_wire.tunnel.datagrams import DatagramSocket
from rgbd_wire.tunnel.endpoint import parse_endpoint
from rgbd_wire.tunnel.errors import Counters, EndpointError, Refusal
from rgbd_wire.tunnel.faults import REST_S, Faults
from rgbd_wire.tunnel.handshake import Welcome
from rgbd_wire.tunnel.keys import PSK_BYTES
from rgbd_wire.tunnel.pump import Pump
from rgbd_wire.tunnel.sending import LinkState
from rgbd_wire.tunnel.shards import MAX_MESSAGE_BYTES

MAX_ENDPOINTS = 64
MAX_BATCHES = 32
"""Taken from one socket before the others and the timers have their turn."""
PROBE_BUDGET_NS = int(PROBE.max_age_ms * 1e6)


class UdpLink:
    """One socket and one session for each endpoint; every method may be called from any thread.

    Args:
        drone: this drone's name.
        endpoints: of the workers, ``udp/HOST:PORT``.
        key: the drone's pre-shared key, 32 bytes.
        clock: the drone's.

    Raises:
        LinkError: there is no endpoint, too many, or one is malformed; or the key is no key.
    """

    def __init__(self, drone: str, endpoints: tuple[str, ...], key: bytes, clock: Clock) -> None:
        if not 0 < len(endpoints) <= MAX_ENDPOINTS:
            raise LinkError(
                f"{len(endpoints)} endpoints, 1 to {MAX_ENDPOINTS} are needed; "
                "such as udp/192.0.2.7:7448"
            )
        if len(key) != PSK_BYTES:
            raise LinkError(f"a key of {len(key)} bytes, the drone's key has {PSK_BYTES}")
        self._clock = clock
        self._counters = Counters()
        self._faults = Faults(self._counters)
        try:
            places = [parse_endpoint(text) for text in dict.fromkeys(endpoints)]
        except EndpointError as error:
            raise LinkError(str(error)) from None
        self._endpoints = tuple(
            Endpoint(drone, key, host, port, self._counters, self._rouse) for host, port in places
        )
        self._lines: Mapping[str, Line] = {}
        self._pump = Pump("udp-send", clock, self._faults)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._wake_lock = threading.Lock()
        self._closed = False
        self._thread: threading.Thread | None = None

    def start(self, on_message: OnMessage, on_workers: OnWorkers) -> None:
        """Shake hands with every endpoint, and receive."""
        self._on_message = on_message
        self._on_workers = on_workers
        self._pump.start()
        self._thread = threading.Thread(target=self._run, name="udp-receive", daemon=True)
        self._thread.start()

    def workers(self) -> tuple[str, ...]:
        """Names of the workers whose session is up, sorted."""
        return tuple(sorted(self._lines))

    def state(self, worker: str) -> LinkState | None:
        """What is known of the way to a worker; None: no session is up."""
        line = self._lines.get(worker)
        return None if line is None else line.channel.state()

    def counters(self) -> Mapping[str, int]:
        """How much was refused, by reason."""
        return self._counters.snapshot()

    def send(self, worker: str, message: bytes, budget_ns: int) -> None:
        """Send a frame, at once as far as the pacer lets it; dropped if the worker is not there."""
        line = self._line(worker, message)
        if line is not None:
            due_ns = line.channel.send(message, budget_ns, self._clock.now_ns())
            self._pump.at(line.channel, due_ns)

    def send_urgent(self, worker: str, message: bytes) -> None:
        """Send a probe at once, past all frames."""
        line = self._line(worker, message)
        if line is not None:
            now_ns = self._clock.now_ns()
            due_ns = line.channel.send_urgent(message, PROBE_BUDGET_NS, now_ns)
            self._pump.at(line.channel, due_ns)

    def unheard(self, worker: str) -> None:
        """Shake hands again from a new source port; the old session stays until the new one is."""
        for endpoint in self._endpoints:
            if (line := endpoint.line) is not None and line.worker == worker:
                endpoint.redial()
        self._rouse()

    def close(self) -> None:
        """Stop both threads and close the sockets; may be called twice."""
        with self._wake_lock:
            if self._closed:
                return
            self._closed = True
            os.eventfd_write(self._wake, 1)
        if self._thread is not None:
            self._thread.join()
        self._pump.close()
        for endpoint in self._endpoints:
            endpoint.close()
        self._lines = {}
        os.close(self._wake)

    def _line(self, worker: str, message: bytes) -> Line | None:
        line = self._lines.get(worker)
        if line is None or not 0 < len(message) <= MAX_MESSAGE_BYTES:
            self._counters.count(Refusal.NOT_SENT)
            return None
        return line

    def _rouse(self) -> None:
        with self._wake_lock:
            if not self._closed:
                os.eventfd_write(self._wake, 1)

    def _run(self) -> None:
        self._watched: dict[int, tuple[Endpoint, DatagramSocket]] = {}
        self._poller = select.poll()
        while not self._closed:
            try:
                self._turn()
            except Exception as error:  # the thread's boundary: it serves all workers
                self._faults.note(error, "the receiving thread")
                time.sleep(REST_S)

    def _turn(self) -> None:
        """Do what is due, wait, and take what came."""
        clock = self._clock
        now_ns = clock.now_ns()
        due_ns = min([self._step(endpoint, now_ns) for endpoint in self._endpoints])
        self._note_workers()
        wanted = {s.fileno(): (e, s) for e in self._endpoints for s in e.sockets()}
        if wanted != self._watched:
            self._watched = wanted
            self._poller = select.poll()
            self._poller.register(self._wake, select.POLLIN)
            for descriptor in wanted:
                self._poller.register(descriptor, select.POLLIN)
        for descriptor, _ in self._poller.poll(max(0.0, (due_ns - clock.now_ns()) / 1e6)):
            if descriptor == self._wake:
                os.eventfd_read(self._wake)
            else:
                self._drain(*self._watched[descriptor])

    def _step(self, endpoint: Endpoint, now_ns: int) -> int:
        try:
            return endpoint.step(now_ns)
        except Exception as error:  # the others are served on
            self._faults.note(error, "an endpoint")
            return now_ns + PING_EVERY_NS

    def _drain(self, endpoint: Endpoint, sock: DatagramSocket) -> None:
        """Take what came on one socket."""
        for _ in range(MAX_BATCHES):
            got = endpoint.receive(sock, self._clock)
            if got is None:
                return
            if got.welcome is not None:
                self._settle(endpoint, got.welcome)
            for message in got.messages:
                with self._faults.contained("the application"):
                    self._on_message(message, got.now_ns)
            got.settle()

    def _settle(self, endpoint: Endpoint, welcome: Welcome) -> None:
        """A worker has welcomed us: its session is the way to it from now on."""
        now_ns = self._clock.now_ns()
        for other in self._endpoints:
            line = other.line
            if other is not endpoint and line and line.up and line.worker == welcome.worker:
                endpoint.dismiss(now_ns)
                return
        endpoint.settle(welcome, now_ns).channel.ping(now_ns)
        self._note_workers()

    def _note_workers(self) -> None:
        """Tell of workers that came or went."""
        lines = {
            line.worker: line
            for endpoint in self._endpoints
            if (line := endpoint.line) is not None and line.up
        }
        before, self._lines = self._lines, lines
        if before.keys() != lines.keys():
            with self._faults.contained("the application"):
                self._on_workers()
