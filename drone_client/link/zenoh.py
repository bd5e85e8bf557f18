"""The Zenoh link: peer mode, explicit endpoints, no discovery (docs/protocol.md).

Peer mode connected to every worker noticed a dead one within 41 ms, client mode not within 7 s.
"""

from __future__ import annotations

import json
import re
import threading
from contextlib import suppress
from pathlib import Path

import msgspec
import zenoh

from drone_client.errors import LinkError
from drone_client.link import OnMessage, OnWorkers
from rgbd_wire.clock import Clock
from rgbd_wire.envelope import MAX_BODY_BYTES, PREFIX_BYTES, Kind
from rgbd_wire.messages import Name
from rgbd_wire.streams import (
    FRAME,
    PROBE,
    RESULT,
    Stream,
    Urgency,
    worker_key,
    worker_of_key,
    worker_status_key,
)
from rgbd_wire.tls_files import TlsFiles

MAX_WORKERS = 64
"""More than any cluster that a drone would choose from; bounds what a rogue peer can announce."""
MAX_MESSAGE_BYTES = PREFIX_BYTES + MAX_BODY_BYTES[Kind.RESULT]
MAX_STATUS_BYTES = PREFIX_BYTES + MAX_BODY_BYTES[Kind.STATUS]
CLOSE_S = 1.0
CONGESTION_CONTROL_FILE = Path("/proc/sys/net/ipv4/tcp_congestion_control")
_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9._-]+):([0-9]{1,5})")
_LOOPBACK = re.compile(r"127\..*|\[::1\]|localhost")
_PRIORITY = {
    Urgency.DATA: zenoh.Priority.DATA,
    Urgency.REAL_TIME: zenoh.Priority.REAL_TIME,
}


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
        LinkError: there is no endpoint, one is malformed or does not go with the TLS files, or the
            session cannot be opened.
    """

    def __init__(
        self, drone: str, endpoints: tuple[str, ...], clock: Clock, tls: TlsFiles | None = None
    ) -> None:
        if not endpoints:
            raise LinkError("no endpoint to connect to; such as tcp/192.0.2.7:7447")
        for endpoint in endpoints:
            check_endpoint(endpoint)
        if drone == "workers":
            raise LinkError("a drone cannot be called 'workers': the workers' keys begin so")
        _check_tls(drone, endpoints, tls)
        self.warnings = (*_congestion_warning(endpoints), *(tls.warnings if tls else ()))
        """Sentences for the person who starts the client, and for the run's summary."""
        self.send_errors = 0
        self._drone = drone
        self._clock = clock
        self._is_closed = False
        self._lock = threading.Lock()
        self._workers: set[str] = set()
        self._publishers: dict[tuple[Stream, str], zenoh.Publisher] = {}
        config = zenoh.Config()
        for key, value in (_CONFIG | _security(tls)).items():
            config.insert_json5(key, json.dumps(value))
        config.insert_json5("connect/endpoints", json.dumps(endpoints))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise LinkError(
                f"cannot open a Zenoh session to {', '.join(endpoints)}: {error}"
            ) from None

    def start(self, on_message: OnMessage, on_workers: OnWorkers) -> None:
        """Subscribe to this drone's answers, to the workers' status and to their liveliness."""
        self._on_workers = on_workers
        for key, max_bytes in (
            (RESULT.key(self._drone, "*"), MAX_MESSAGE_BYTES),
            (worker_status_key("*"), MAX_STATUS_BYTES),
        ):
            self._subscribe(key, max_bytes, on_message)
        self._session.liveliness().declare_subscriber(
            worker_key("*"),
            zenoh.handlers.Callback(self._on_liveliness, indirect=False),
            history=True,
        )

    def workers(self) -> tuple[str, ...]:
        """Names of the workers whose token is up, sorted."""
        with self._lock:
            return tuple(sorted(self._workers))

    def send(self, worker: str, message: bytes, budget_ns: int) -> None:
        """Publish a frame to a worker; drops rather than blocks.

        Args:
            worker: its name.
            message: the whole message.
            budget_ns: of no use here; what TCP loses it sends again, in time or not.
        """
        self._put(FRAME, worker, message)

    def send_urgent(self, worker: str, message: bytes) -> None:
        """Publish a probe to a worker: before all frames, and dropped rather than waited for."""
        self._put(PROBE, worker, message)

    def unheard(self, worker: str) -> None:
        """Nothing to try: the session connects again by itself, and there is no other way."""

    def close(self) -> None:
        """Close the session; nothing is handed over afterwards."""
        self._is_closed = True
        # Zenoh waits up to 10 s for a connection that is just being tried, or for a receiver that
        # stands still, and offers no time-out: a run shall not end so late
        closing = threading.Thread(target=self._close_session, name="zenoh-close", daemon=True)
        closing.start()
        closing.join(CLOSE_S)

    def _close_session(self) -> None:
        with suppress(zenoh.ZError):
            self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stub lacks "-> None"

    def _subscribe(self, key: str, max_bytes: int, on_message: OnMessage) -> None:
        def on_sample(sample: zenoh.Sample) -> None:
            t4_ns = self._clock.now_ns()
            if self._is_closed:
                return
            # What is too long is cut: the envelope's length then tells, and it is counted there.
            on_message(sample.payload.to_bytes()[: max_bytes + 1], t4_ns)

        # Direct: the indirect default puts a hidden FIFO of 256 samples before t4
        callback = zenoh.handlers.Callback(on_sample, indirect=False)
        self._session.declare_subscriber(key, callback)

    def _put(self, stream: Stream, worker: str, message: bytes) -> None:
        if self._is_closed:  # the session may take a moment longer
            self.send_errors += 1
            return
        try:
            publisher = self._publishers.get((stream, worker))
            if publisher is None:
                publisher = self._declare(stream, worker)
            publisher.put(message)
        except zenoh.ZError:
            self.send_errors += 1  # the message is lost, and the ack clock will say so

    def _declare(self, stream: Stream, worker: str) -> zenoh.Publisher:
        if len(self._publishers) >= 2 * MAX_WORKERS:  # names that come and go fill no memory
            self._publishers.pop(next(iter(self._publishers))).undeclare()  # type: ignore[no-untyped-call]
        publisher = self._session.declare_publisher(
            stream.key(self._drone, worker),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=_PRIORITY[stream.urgency],
            express=stream.urgency is Urgency.REAL_TIME,
        )
        self._publishers[stream, worker] = publisher
        return publisher

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        worker = worker_of_key(str(sample.key_expr))
        with self._lock:
            before = len(self._workers)
            if sample.kind == zenoh.SampleKind.DELETE:
                self._workers.discard(worker)
            elif before < MAX_WORKERS and _is_name(worker):
                self._workers.add(worker)
            has_changed = len(self._workers) != before
        if has_changed and not self._is_closed:
            self._on_workers()


_CONFIG: dict[str, object] = {
    "mode": "peer",
    # A worker that is not there yet, or no more, is tried again for ever, in the background
    # (0 would try once: a drone that starts first would never find its worker)
    "connect/timeout_ms": {"peer": -1},
    "connect/exit_on_failure": {"peer": False},
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    # A try that nobody answers is given up sooner than after 10 s: the next may find the way back
    "transport/unicast/open_timeout": 3000,
    # Nobody is scouted for: waiting for who might turn up would cost 0.5 s at the start
    "open/return_conditions/connect_scouted": False,
    "listen/endpoints": [],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/lease": 1000,
    # A frame of three batches meets a queue of two: by default it is dropped when the
    # sending thread gets no core for 1 ms. The ack clock bounds what can lie in the queue,
    # so give it room for the whole window, and wait a little before a frame is lost; but no longer
    # than that, since the frames for the other workers wait behind.
    "transport/link/tx/queue/size/data": 16,
    "transport/link/tx/queue/congestion_control/drop": {
        "wait_before_drop": 20_000,
        "max_wait_before_drop_fragments": 20_000,
    },
    # No so_sndbuf: 64 kB takes 670 ms of age down to 420 ms where frames are sent without an ack
    # clock, and changes nothing where there is one (83 and 82 ms, 100 kB at 30 fps into 20 Mbit/s),
    # but it would bound what a path with a long round trip carries.
    #
    # What a rogue worker can make us hold, for each link and priority
    "transport/link/rx/max_message_size": 4 * MAX_MESSAGE_BYTES,
}


def _check_tls(drone: str, endpoints: tuple[str, ...], tls: TlsFiles | None) -> None:
    for endpoint in endpoints:
        if tls is None and endpoint.startswith("tls/"):
            raise LinkError(
                f"{endpoint} needs certificates: name their folder with DRONE_TLS "
                "(scripts/certificates makes one)"
            )
        if tls is not None and not endpoint.startswith("tls/"):
            raise LinkError(
                f"{endpoint} is not encrypted, and DRONE_TLS is set: write tls/HOST:PORT, or leave "
                "DRONE_TLS empty"
            )
    if tls is not None and tls.common_name != drone:
        raise LinkError(
            f"{tls.certificate} is the certificate of {tls.common_name!r} and this drone is called "
            f"{drone!r}: no worker would serve it"
        )


def _security(tls: TlsFiles | None) -> dict[str, object]:
    if tls is None:
        return {"transport/link/protocols": ["tcp"]}
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(tls.ca),
            "connect_certificate": str(tls.certificate),
            "connect_private_key": str(tls.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        },
    }


def _congestion_warning(endpoints: tuple[str, ...]) -> list[str]:
    if all(_LOOPBACK.match(endpoint.partition("/")[2]) for endpoint in endpoints):
        return []
    try:
        name = CONGESTION_CONTROL_FILE.read_text(encoding="ascii").strip()
    except OSError:  # not Linux, or a container that hides it: nothing to tell
        return []
    if name == "bbr":
        return []
    return [
        f"TCP congestion control is {name!r}: over a radio that loses 1 % of the packets nearly no "
        "frame arrives in time. `sysctl -w net.ipv4.tcp_congestion_control=bbr` helps, udp/ "
        "endpoints help more"
    ]


def _is_name(text: str) -> bool:
    try:
        msgspec.convert(text, Name)
    except msgspec.ValidationError:
        return False
    return True
