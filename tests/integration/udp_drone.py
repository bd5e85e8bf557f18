"""A drone's end of the UDP tunnel, as bare as it can be."""

from __future__ import annotations

import threading
from contextlib import contextmanager

from drone_client.link.udp import UdpLink
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.messages import Ack, Result, Status, decode_ack, decode_result, decode_status
from rgbd_wire.probe import Probe, decode_probe

TIMEOUT_S = 30.0
DECODERS = {
    Kind.ACK: decode_ack,
    Kind.RESULT: decode_result,
    Kind.STATUS: decode_status,
    Kind.PROBE: decode_probe,
}


class TunnelDrone:
    """Sends whatever bytes it is given, and keeps what comes back."""

    def __init__(self, link, worker):
        self.link = link
        self.received = []
        self._worker = worker
        self._changed = threading.Condition()
        link.start(self._on_message, self._on_workers)
        self.wait_for(lambda d: worker in d.link.workers())

    def send(self, data, budget_ns=TIMEOUT_S * 1e9):
        """Send one frame."""
        self.link.send(self._worker, data, int(budget_ns))

    def probe(self, data):
        """Send one probe."""
        self.link.send_urgent(self._worker, data)

    def wait_for(self, condition):
        """Wait until ``condition(self)`` holds."""
        met = self.waits_for(condition, TIMEOUT_S)
        assert met, f"workers {self.link.workers()}, received {self.received}"

    def waits_for(self, condition, timeout_s):
        """Whether ``condition(self)`` holds before the time is over."""
        with self._changed:
            return self._changed.wait_for(lambda: condition(self), timeout_s)

    def of(self, kind):
        """All messages of a type, in order."""
        return [m for m in self.received if isinstance(m, kind)]

    @property
    def acks(self):
        """Sequences acknowledged, in order."""
        return [m.sequence for m in self.of(Ack)]

    @property
    def results(self):
        """All results, in order."""
        return self.of(Result)

    @property
    def statuses(self):
        """All statuses, in order."""
        return self.of(Status)

    @property
    def echoes(self):
        """All echoes, in order."""
        return self.of(Probe)

    def _on_message(self, data, _t4_ns):
        kind, body = unseal(data, *DECODERS)
        with self._changed:
            self.received.append(DECODERS[kind](body))
            self._changed.notify_all()

    def _on_workers(self):
        with self._changed:
            self._changed.notify_all()


@contextmanager
def tunnelling(endpoint, key, name="d1", worker="w1"):
    """A drone with a session to the worker at an endpoint."""
    link = UdpLink(name, (endpoint,), key, MonotonicClock())
    try:
        yield TunnelDrone(link, worker)
    finally:
        link.close()
