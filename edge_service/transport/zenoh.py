"""The transport over Zenoh: a router of its own by default, so that nothing else needs to run.

Messages are handed over on the thread that read them from the socket. There is no channel between:
Zenoh's own default puts 256 samples before t2, and a ring of one sample would drop a frame without
a word to the drone, which then waits for its ack. The one place where the newest wins is the
mailbox behind ``on_message``, and it answers for what it drops; that works because ``on_message``
is quick. If it were not, the socket would not be read, and what waits would wait on the drone's
side, where the ack clock bounds it.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Thread

import msgspec
import zenoh

from edge_service.errors import AddressError
from edge_service.transport import OnMessage
from edge_service.transport.zenoh_access import access_control
from rgbd_wire.envelope import MAX_BODY_BYTES, PREFIX_BYTES, Kind
from rgbd_wire.messages import Name
from rgbd_wire.probe import PROBE_BYTES
from rgbd_wire.streams import (
    FRAME,
    PROBE,
    RESULT,
    Urgency,
    drone_of_key,
    worker_key,
    worker_status_key,
)
from rgbd_wire.tls_files import TlsFiles

_PRIORITY = {
    Urgency.DATA: zenoh.Priority.DATA,
    Urgency.REAL_TIME: zenoh.Priority.REAL_TIME,
}
CLOSE_S = 1.0
MAX_FRAME_BYTES = PREFIX_BYTES + MAX_BODY_BYTES[Kind.FRAME]


@dataclass(frozen=True, slots=True)
class ZenohAddress:
    """Where the worker's session listens, or whose router it joins: one of the two."""

    listen: tuple[str, ...] = ()
    """Endpoints of the router that this session is, such as ``tcp/0.0.0.0:7447``."""
    connect: tuple[str, ...] = ()
    """Endpoints of routers that run elsewhere; then no port is opened here."""
    lease_ms: int = 1000
    """After so long without a sign of life the other side counts as gone."""
    tls: TlsFiles | None = None
    """With these every endpoint is ``tls/...``, and both ends show a certificate."""
    drones: tuple[str, ...] = ()
    """With ``tls``, the common names that may fly here; each is the name of its drone."""
    workers: tuple[str, ...] = ()
    """With ``tls``, the common names of workers that join this one as their router."""

    def config(self) -> zenoh.Config:
        """The session's configuration.

        Raises:
            AddressError: an endpoint is malformed, or does not go with the TLS files.
        """
        self._check_tls()
        config = zenoh.Config()
        # Also where it joins a router: routers do not route between peers, so a worker that was
        # one would not be seen by drones that are peers themselves, and a client gives up at once
        # when the router is not there yet.
        config.insert_json5("mode", json.dumps("router"))
        for key, endpoints in (("listen", self.listen), ("connect", self.connect)):
            try:
                config.insert_json5(f"{key}/endpoints", json.dumps(endpoints))
            except zenoh.ZError as error:
                raise self._error(error) from None
        for key, value in {
            # Who takes part is said by name; nobody is found by chance
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "open/return_conditions/connect_scouted": False,  # and so nobody is waited for, 0.5 s
            # Silently carries everything over 3 kB on one host, with other latencies
            "transport/shared_memory/enabled": False,
            # A router that is not there yet, or no more, is tried again for ever
            "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000},
            "transport/link/tx/lease": self.lease_ms,
            "transport/link/tx/keep_alive": 4,
            # By default a hundred connections that say nothing keep every new drone out for 10 s
            "transport/unicast/accept_timeout": 2000,
            "transport/unicast/accept_pending": 1000,
            # Express messages take a batch each: with the default of 2, acks and results in quick
            # succession were dropped on a busy worker (22 of 1000; with 8 or more: none)
            "transport/link/tx/queue/size/real_time": 16,
            # More than a frame may have, so that a peer's oversized ones come in and are counted;
            # past this they are dropped on the link
            "transport/link/rx/max_message_size": 4 * MAX_BODY_BYTES[Kind.FRAME],
            **self._security(),
        }.items():
            config.insert_json5(key, json.dumps(value))
        return config

    def _check_tls(self) -> None:
        for endpoint in (*self.listen, *self.connect):
            if self.tls is None and endpoint.startswith("tls/"):
                raise AddressError(
                    f"{endpoint} needs certificates: name their folder with EDGE_ZENOH_TLS "
                    "(scripts/certificates makes one)"
                )
            if self.tls is not None and not endpoint.startswith("tls/"):
                raise AddressError(
                    f"{endpoint} would let in whoever comes, and EDGE_ZENOH_TLS is set: "
                    "write tls/HOST:PORT, or leave EDGE_ZENOH_TLS empty"
                )
        if self.tls is not None and self.listen and not self.drones:
            raise AddressError(
                "EDGE_ZENOH_TLS is set and no drone may come in: name them with EDGE_ZENOH_DRONES"
            )
        for name in self.drones:
            if not _is_name(name) or name == "workers":  # a key of theirs
                raise AddressError(f"EDGE_ZENOH_DRONES: {name!r} cannot be the name of a drone")

    def _security(self) -> dict[str, object]:
        if self.tls is None:
            return {"transport/link/protocols": ["tcp"]}
        certificate, key = str(self.tls.certificate), str(self.tls.key)
        security: dict[str, object] = {
            "transport/link/protocols": ["tls"],
            "transport/link/tls": {
                "root_ca_certificate": str(self.tls.ca),
                "listen_certificate": certificate,
                "listen_private_key": key,
                "connect_certificate": certificate,
                "connect_private_key": key,
                "enable_mtls": True,
                "verify_name_on_connect": True,
                "close_link_on_expiration": True,
            },
        }
        if self.listen:  # a router that runs elsewhere has rules of its own, for it sees the drones
            security["access_control"] = access_control(self.drones, self.workers)
        return security

    def session(self) -> zenoh.Session:
        """An open session.

        Raises:
            AddressError: an endpoint is malformed, taken or not ours.
        """
        try:
            return zenoh.open(self.config())
        except zenoh.ZError as error:
            raise self._error(error) from None

    def _error(self, error: zenoh.ZError) -> AddressError:
        word, endpoints = ("listen", self.listen) if self.listen else ("connect", self.connect)
        return AddressError(
            f"Zenoh on {', '.join(endpoints)}: {_plain(error)}; "
            f"give another address with --{word} or EDGE_ZENOH_{word.upper()}"
        )


class ZenohTransport:
    """A worker's Zenoh session."""

    def __init__(self, worker: str, address: ZenohAddress) -> None:
        self._worker = worker
        self._address = address
        self._session: zenoh.Session | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._on_message: OnMessage | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the log, once at the start."""
        return self._address.tls.warnings if self._address.tls else ()

    @property
    def is_open(self) -> bool:
        """The session stands and, where it joins routers, at least one of them is there."""
        session = self._session
        if session is None or session.is_closed():
            return False
        return bool(self._address.listen or session.info.routers_zid())

    @property
    def is_alive(self) -> bool:
        """Its threads are Zenoh's own, and go on whatever a callback does."""
        return True

    def open(self) -> None:
        """Open the session.

        Raises:
            AddressError: an endpoint cannot be listened on or is none.
        """
        self._session = self._address.session()

    def start(self, on_message: OnMessage) -> None:
        """Subscribe to this worker's frames and probes."""
        assert self._session is not None, "open before start"
        self._on_message = on_message
        for stream, max_bytes in ((FRAME, MAX_FRAME_BYTES), (PROBE, PROBE_BYTES)):
            # Direct: the indirect default puts a hidden FIFO of 256 samples before t2
            callback = zenoh.handlers.Callback(self._hand_over(max_bytes), indirect=False)
            self._session.declare_subscriber(stream.key("*", self._worker), callback)

    def _hand_over(self, max_bytes: int) -> Callable[[zenoh.Sample], None]:
        def hand_over(sample: zenoh.Sample) -> None:
            t2_ns = time.monotonic_ns()
            on_message = self._on_message
            drone = drone_of_key(str(sample.key_expr))
            if on_message is None:
                return
            if not _is_name(drone):
                on_message(None, b"", t2_ns)  # nobody could be answered: it is not even looked at
                return
            data: bytes | memoryview = sample.payload.to_bytes()
            if len(data) > max_bytes:
                # Cut, so that it is looked at no further; the envelope tells, and it is counted
                data = memoryview(data)[: max_bytes + 1]
            on_message(drone, data, t2_ns)

        return hand_over

    def announce(self) -> None:
        """Put up the liveliness token that drones look for."""
        if self._session is not None and self._token is None:
            self._token = self._session.liveliness().declare_token(worker_key(self._worker))

    def withdraw(self) -> None:
        """Take the liveliness token down."""
        if self._token is not None:
            self._token.undeclare()  # type: ignore[no-untyped-call] # zenoh's stub lacks it
            self._token = None

    def send(self, drone: str, payload: bytes) -> bool:
        """Publish an ack, an echo or a result; dropped rather than waited for on a busy link."""
        return self._put(RESULT.key(drone, self._worker), payload, RESULT.urgency)

    def publish(self, status: bytes) -> None:
        """Publish a status to all drones; dropped rather than waited for on a busy link."""
        self._put(worker_status_key(self._worker), status, Urgency.REAL_TIME)

    def _put(self, key: str, payload: bytes, urgency: Urgency) -> bool:
        session = self._session
        if session is None or session.is_closed():
            return False
        try:
            session.put(
                key,
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=_PRIORITY[urgency],
                express=urgency is Urgency.REAL_TIME,
            )
        except zenoh.ZError:  # closed by another thread since the check
            return False
        return True

    def close(self) -> None:
        """Close the session; nothing is handed over afterwards."""
        self._on_message = None
        self.withdraw()
        if self._session is not None:
            # Zenoh waits up to 10 s for a connection that is just being tried, or for a consumer
            # that stands still, and offers no time-out: a stop shall not take so long
            closing = Thread(target=_close, args=(self._session,), name="zenoh-close", daemon=True)
            closing.start()
            closing.join(CLOSE_S)


def _close(session: zenoh.Session) -> None:
    with suppress(zenoh.ZError):
        session.close()  # type: ignore[no-untyped-call] # zenoh's stub lacks it


def _is_name(text: str) -> bool:
    try:
        msgspec.convert(text, Name)
    except msgspec.ValidationError:
        return False
    return True


def _plain(error: zenoh.ZError) -> str:
    """Zenoh's message without the places in its own source."""
    text = re.sub(r"\s+at /\S+?\.rs:\d+\.?|\s+\(os error \d+\)", "", str(error))
    inner = re.search(r"\[[^\[\]]*?: ([^\[\]]*?)\]", text) or re.search(r'msg: "(.*?)"', text)
    return (inner.group(1) if inner else text).strip().rstrip(".")
