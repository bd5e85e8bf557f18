"""A drone's end of the link, as bare as it can be."""

from __future__ import annotations

import json
import threading
from contextlib import contextmanager

import zenoh

from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.messages import Ack, Result, decode_ack, decode_result
from rgbd_wire.probe import Probe, decode_probe, seal_probe
from rgbd_wire.streams import FRAME, PROBE, RESULT, worker_key

TIMEOUT_S = 30.0


def open_session(mode, connect=(), listen=(), more=None):
    """A Zenoh session that knows nobody but those named; ``more`` is further configuration."""
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "connect/endpoints": list(connect),
        "connect/retry": {"period_init_ms": 50, "period_max_ms": 200},
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "open/return_conditions/connect_scouted": False,
        "transport/shared_memory/enabled": False,
        **(more or {}),
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Drone:
    """Sends whatever bytes it is given, and keeps what comes back."""

    def __init__(self, session, name, worker):
        self.received = []
        self.echoes = []
        self._session = session
        self._probe_key = PROBE.key(name, worker)
        self.urgency = set()
        """Priority, express and congestion control of what came."""
        self.workers = {}
        self._changed = threading.Condition()
        session.declare_subscriber(RESULT.key(name, "*"), self._on_answer)
        session.liveliness().declare_subscriber(worker_key("*"), self._on_token, history=True)
        self._frames = session.declare_publisher(
            FRAME.key(name, worker), congestion_control=zenoh.CongestionControl.BLOCK
        )
        matched = threading.Event()
        self._frames.declare_matching_listener(lambda status: status.matching and matched.set())
        if not self._frames.matching_status.matching:
            assert matched.wait(TIMEOUT_S), "no worker subscribed"

    def send(self, data):
        """Publish one message."""
        self._frames.put(data)

    def probe(self, sequence):
        """Send a probe."""
        self._session.put(
            self._probe_key,
            seal_probe(Probe(1, sequence, t1_ns=1)),
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

    def wait_for(self, condition):
        """Wait until ``condition(self)`` holds."""
        with self._changed:
            met = self._changed.wait_for(lambda: condition(self), TIMEOUT_S)
        told = [(r.sequence, r.outcome.value) for r in self.results]
        assert met, f"acks {self.acks}, results {told}, workers {self.workers}"

    @property
    def acks(self):
        """Sequences acknowledged, in order."""
        return [m.sequence for m in self.received if isinstance(m, Ack)]

    @property
    def results(self):
        """All results, in order."""
        return [m for m in self.received if isinstance(m, Result)]

    def _on_answer(self, sample):
        kind, body = unseal(sample.payload.to_bytes(), Kind.ACK, Kind.RESULT, Kind.PROBE)
        if kind is Kind.PROBE:
            with self._changed:
                self.echoes.append(decode_probe(body))
                self._changed.notify_all()
            return
        message = decode_ack(body) if kind is Kind.ACK else decode_result(body)
        urgency = str(sample.priority), sample.express, str(sample.congestion_control)
        with self._changed:
            self.urgency.add(urgency)
            self.received.append(message)
            self._changed.notify_all()

    def _on_token(self, sample):
        with self._changed:
            self.workers[str(sample.key_expr)] = sample.kind == zenoh.SampleKind.PUT
            self._changed.notify_all()


@contextmanager
def flying(endpoint, name="d1", worker="w1"):
    """A drone connected to an endpoint."""
    with open_session("peer", connect=[endpoint]) as session:
        yield Drone(session, name, worker)
