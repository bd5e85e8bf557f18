"""A transport without a network: what tests hand messages to and read answers from."""

from __future__ import annotations

import threading

from edge_service.transport import OnMessage
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.messages import Ack, Result, Status, decode_ack, decode_result, decode_status
from rgbd_wire.probe import Probe, decode_probe


class MemoryTransport:
    """Keeps what was sent, in order, as it would arrive at the drones."""

    def __init__(self) -> None:
        self.is_open = False
        self.is_alive = True
        self.announced = False
        self.sent: list[tuple[str, Ack | Result | Probe]] = []
        """Drone and message."""
        self.published: list[tuple[bool, Status]] = []
        """Whether the worker was announced at the time, and the status."""
        self._on_message: OnMessage | None = None
        self._changed = threading.Condition()

    def open(self) -> None:
        """Open it."""
        self.is_open = True

    def start(self, on_message: OnMessage) -> None:
        """Hand over what ``deliver`` is given."""
        self._on_message = on_message

    def deliver(self, drone: str | None, data: bytes | memoryview, t2_ns: int) -> None:
        """Hand over one message of a drone, as if it had come in at ``t2_ns``."""
        assert self.is_open, "deliver before close"
        assert self._on_message is not None, "deliver after start"
        self._on_message(drone, data, t2_ns)

    def announce(self) -> None:
        """Note it."""
        self.announced = True

    def withdraw(self) -> None:
        """Note it."""
        self.announced = False

    def send(self, drone: str, payload: bytes) -> bool:
        """Decode the message as a drone would, and keep it."""
        if not self.is_open:
            return False
        message = _decoded(payload)
        with self._changed:
            self.sent.append((drone, message))
            self._changed.notify_all()
        return True

    def publish(self, status: bytes) -> None:
        """Decode the status as a drone would, and keep it."""
        if not self.is_open:
            return
        _, body = unseal(status, Kind.STATUS)
        with self._changed:
            self.published.append((self.announced, decode_status(body)))
            self._changed.notify_all()

    def close(self) -> None:
        """Close it."""
        self.is_open = False

    def acks(self) -> list[Ack]:
        """All acks so far."""
        return [m for _, m in self.sent if isinstance(m, Ack)]

    def results(self) -> list[Result]:
        """All results so far."""
        return [m for _, m in self.sent if isinstance(m, Result)]

    def echoes(self) -> list[Probe]:
        """All echoes of probes so far."""
        return [m for _, m in self.sent if isinstance(m, Probe)]

    def wait_for_results(self, n: int, timeout_s: float = 20.0) -> list[Result]:
        """All results so far, once there are ``n``.

        Raises:
            TimeoutError: there were fewer within ``timeout_s``.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: len(self.results()) >= n, timeout_s):
                raise TimeoutError(f"{len(self.results())} results in {timeout_s} s, not {n}")
            return self.results()

    def wait_for_statuses(self, n: int, timeout_s: float = 20.0) -> list[Status]:
        """All statuses so far, once there are ``n``.

        Raises:
            TimeoutError: there were fewer within ``timeout_s``.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: len(self.published) >= n, timeout_s):
                raise TimeoutError(f"{len(self.published)} statuses in {timeout_s} s, not {n}")
            return [status for _, status in self.published]


def _decoded(payload: bytes) -> Ack | Result | Probe:
    kind, body = unseal(payload, Kind.ACK, Kind.RESULT, Kind.PROBE)
    if kind is Kind.ACK:
        return decode_ack(body)
    return decode_result(body) if kind is Kind.RESULT else decode_probe(body)
