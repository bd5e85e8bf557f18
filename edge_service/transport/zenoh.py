"""The transport over Zenoh: a router of its own by default, so that nothing else needs to run."""

from __future__ import annotations

import json
import re
import time
from dataclasses import dataclass

import zenoh

from edge_service.errors import AddressError
from edge_service.transport import OnFrame
from rgbd_wire.envelope import MAX_BODY_BYTES, Kind
from rgbd_wire.streams import FRAME, RESULT, Urgency, worker_key

_PRIORITY = {
    Urgency.DATA: zenoh.Priority.DATA,
    Urgency.REAL_TIME: zenoh.Priority.REAL_TIME,
}


@dataclass(frozen=True, slots=True)
class ZenohAddress:
    """Where the worker's session listens, or whose router it joins: one of the two."""

    listen: tuple[str, ...] = ()
    """Endpoints of the router that this session is, such as ``tcp/0.0.0.0:7447``."""
    connect: tuple[str, ...] = ()
    """Endpoints of routers that run elsewhere; then no port is opened here."""
    lease_ms: int = 1000
    """After so long without a sign of life the other side counts as gone."""

    def config(self) -> zenoh.Config:
        """The session's configuration.

        Raises:
            AddressError: an endpoint is malformed.
        """
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
        }.items():
            config.insert_json5(key, json.dumps(value))
        return config

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

    @property
    def is_open(self) -> bool:
        """The session stands and, where it joins routers, at least one of them is there."""
        session = self._session
        if session is None or session.is_closed():
            return False
        return bool(self._address.listen or session.info.routers_zid())

    def open(self) -> None:
        """Open the session.

        Raises:
            AddressError: an endpoint cannot be listened on or is none.
        """
        self._session = self._address.session()

    def start(self, on_frame: OnFrame) -> None:
        """Subscribe to this worker's frames."""
        assert self._session is not None, "open before start"

        def hand_over(sample: zenoh.Sample) -> None:
            t2_ns = time.monotonic_ns()
            on_frame(sample.payload.to_bytes(), t2_ns)

        # Direct: the indirect default puts a hidden FIFO of 256 samples before t2
        callback = zenoh.handlers.Callback(hand_over, indirect=False)
        self._session.declare_subscriber(FRAME.key("*", self._worker), callback)

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
        """Publish an ack or a result; dropped rather than waited for on a congested link."""
        session = self._session
        if session is None or session.is_closed():
            return False
        try:
            session.put(
                RESULT.key(drone, self._worker),
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=_PRIORITY[RESULT.urgency],
                express=RESULT.urgency is Urgency.REAL_TIME,
            )
        except zenoh.ZError:  # closed by another thread since the check
            return False
        return True

    def close(self) -> None:
        """Close the session."""
        self.withdraw()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call] # zenoh's stub lacks it


def _plain(error: zenoh.ZError) -> str:
    """Zenoh's message without the places in its own source."""
    text = re.sub(r"\s+at /\S+?\.rs:\d+\.?|\s+\(os error \d+\)", "", str(error))
    inner = re.search(r"\[[^\[\]]*?: ([^\[\]]*?)\]", text) or re.search(r'msg: "(.*?)"', text)
    return (inner.group(1) if inner else text).strip().rstrip(".")
