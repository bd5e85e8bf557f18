"""The Zenoh link: peer mode, explicit endpoints, no discovery (docs/protocol.md).

Peer mode connected to every worker noticed a dead one within 41 ms, client mode not within 7 s.
"""

from __future__ import annotations

import json
import re
import threading

import zenoh

from drone_client.errors import LinkError
from drone_client.link import OnMessage
from rgbd_wire.clock import Clock
from rgbd_wire.envelope import MAX_BODY_BYTES, PREFIX_BYTES, Kind
from rgbd_wire.streams import FRAME, RESULT, worker_key, worker_of_key

MAX_WORKERS = 64
"""More than any cluster that a drone would choose from; bounds what a rogue peer can announce."""
MAX_MESSAGE_BYTES = PREFIX_BYTES + MAX_BODY_BYTES[Kind.RESULT]
_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):([0-9]{1,5})")


def check_endpoint(endpoint: str) -> str:
    """The endpoint itself, if it is one.

    Raises:
        LinkError: says what an endpoint looks like.
    """
    if not _is_endpoint(endpoint):
        hint = "such as tcp/192.0.2.7:7447 (protocols: tcp, tls)"
        if _is_endpoint(f"tcp/{endpoint}"):
            hint = f"did you mean tcp/{endpoint}?"
        raise LinkError(f"endpoint {endpoint!r} is not PROTOCOL/HOST:PORT; {hint}")
    return endpoint


def _is_endpoint(text: str) -> bool:
    match = _ENDPOINT.fullmatch(text)
    return match is not None and 0 < int(match[3]) <= 65535


class ZenohLink:
    """One session to all workers.

    Raises:
        LinkError: there is no endpoint, one is malformed, or the session cannot be opened.
    """

    def __init__(self, drone: str, endpoints: tuple[str, ...], clock: Clock) -> None:
        if not endpoints:
            raise LinkError("no endpoint to connect to; such as tcp/192.0.2.7:7447")
        self._drone = drone
        self._clock = clock
        self._lock = threading.Lock()
        self.send_errors = 0
        self._workers: set[str] = set()
        self._publishers: dict[str, zenoh.Publisher] = {}
        config = zenoh.Config()
        for key, value in {
            "mode": "peer",
            "connect/endpoints": [check_endpoint(e) for e in endpoints],
            # A worker that is not there yet, or no more, is tried again for ever, in the background
            # (0 would try once: a drone that starts first would never find its worker)
            "connect/timeout_ms": {"peer": -1},
            "connect/exit_on_failure": {"peer": False},
            "connect/retry": {
                "period_init_ms": 100,
                "period_max_ms": 1000,
                "period_increase_factor": 2,
            },
            # Nobody is scouted for: waiting for who might turn up would cost 0.5 s at the start
            "open/return_conditions/connect_scouted": False,
            "listen/endpoints": [],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/link/tx/lease": 1000,
            # A frame of three batches meets a queue of two: by default it is dropped when the
            # sending thread gets no core for 1 ms. The ack clock bounds what can lie in the queue,
            # so give it room for the whole window, and wait a little before a frame is lost.
            "transport/link/tx/queue/size/data": 16,
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 20_000,
        }.items():
            config.insert_json5(key, json.dumps(value))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise LinkError(
                f"cannot open a Zenoh session to {', '.join(endpoints)}: {error}"
            ) from None

    def start(self, on_message: OnMessage) -> None:
        """Subscribe to this drone's results and to the workers' liveliness."""

        def on_sample(sample: zenoh.Sample) -> None:
            t4_ns = self._clock.now_ns()
            # What is too long is cut: the envelope's length then tells, and it is counted there.
            on_message(sample.payload.to_bytes()[: MAX_MESSAGE_BYTES + 1], t4_ns)

        # Direct: the indirect default puts a hidden FIFO of 256 samples before t4
        callback = zenoh.handlers.Callback(on_sample, indirect=False)
        self._results = self._session.declare_subscriber(RESULT.key(self._drone, "*"), callback)
        self._liveliness = self._session.liveliness().declare_subscriber(
            worker_key("*"), self._on_liveliness, history=True
        )

    def workers(self) -> tuple[str, ...]:
        """Names of the workers whose token is up, sorted."""
        with self._lock:
            return tuple(sorted(self._workers))

    def send(self, worker: str, message: bytes) -> None:
        """Publish a frame to a worker; drops rather than blocks."""
        try:
            publisher = self._publishers.get(worker)
            if publisher is None:
                publisher = self._publishers[worker] = self._session.declare_publisher(
                    FRAME.key(self._drone, worker),
                    congestion_control=zenoh.CongestionControl.DROP,
                    priority=zenoh.Priority.DATA,
                )
            publisher.put(message)
        except zenoh.ZError:
            self.send_errors += 1  # the frame is lost, and the ack clock will say so

    def close(self) -> None:
        """Close the session."""
        self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stub leaves out "-> None"

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        worker = worker_of_key(str(sample.key_expr))
        with self._lock:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._workers.discard(worker)
            elif len(self._workers) < MAX_WORKERS:
                self._workers.add(worker)
