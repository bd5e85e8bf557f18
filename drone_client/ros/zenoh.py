"""Publishes accepted poses to ROS 2: own session, own topics, never in the way of the flight.

A client of one router, bridge or peer, which then passes the poses on: the router of rmw_zenoh
does not route between peers. The session is opened on a thread of its own, for a client's session
opens only where somebody listens; until then poses are dropped and counted. Once open, it connects
again by itself.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import zenoh

from drone_client.errors import LinkError
from drone_client.link.zenoh import check_endpoint
from drone_client.ros.cdr import pose_stamped, pose_with_covariance_stamped
from drone_client.ros.names import (
    MAX_DOMAIN,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED,
    Flavour,
    MessageType,
    attachment,
    check_frame,
    check_topic,
    gid,
    key,
    node_name,
    node_token,
    publisher_token,
)
from rgbd_wire.clock import Clock
from rgbd_wire.geometry import Array, Pose

COVARIANCE_SUFFIX = "_with_covariance"
RETRY_S = 1.0
"""Between two tries to open the session."""


class RosPoses:
    """Two topics: ``<topic>`` and ``<topic>_with_covariance``.

    ``publish`` belongs to one thread.

    Raises:
        LinkError: no endpoint, or one that is malformed or encrypted; a topic, frame or domain
            that ROS 2 would not take.
    """

    def __init__(
        self,
        drone: str,
        endpoints: tuple[str, ...],
        topic: str,
        clock: Clock,
        *,
        flavour: Flavour = Flavour.BRIDGE,
        frame_id: str = "world",
        domain: int = 0,
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Begin to connect, in the background.

        Args:
            drone: its name; with rmw_zenoh, that of the node.
            endpoints: routers, bridges or peers; the first that answers gets the poses.
            topic: ROS 2's name of it, with or without leading slash.
            clock: the drone's, of the capture times.
            flavour: the way into ROS 2.
            frame_id: the parent frame of the poses.
            domain: ROS_DOMAIN_ID of the subscribers; for rmw_zenoh alone.
            unix_ns: the drone's wall clock [ns].
        """
        if not endpoints:
            raise LinkError("no endpoint to publish poses to; such as tcp/127.0.0.1:7447")
        check_way(endpoints, domain)
        name = check_topic(topic)
        self.published = 0
        """Poses handed to the session; what its queue drops is not known."""
        self.not_connected = 0
        """Poses dropped because the session was never open yet."""
        self.errors = 0
        """Poses that could not be written or handed over."""
        self._topics = (
            (name, POSE_STAMPED),
            (check_topic(name + COVARIANCE_SUFFIX), POSE_WITH_COVARIANCE_STAMPED),
        )
        self._endpoints = endpoints
        self._clock = clock
        self._unix_ns = unix_ns
        self._flavour = flavour
        self._frame_id = check_frame(frame_id)
        self._domain = domain
        self._node = node_name(drone)
        self._lock = threading.Lock()
        self._session: zenoh.Session | None = None
        self._publishers: tuple[_Publisher, _Publisher] | None = None
        self._closing = threading.Event()
        self._opener = threading.Thread(target=self._open, name="ros-poses-open", daemon=True)
        self._opener.start()

    @property
    def connected(self) -> bool:
        """Whether the session has been opened."""
        return self._publishers is not None

    def publish(self, pose: Pose, covariance: Array, t_capture_ns: int) -> None:
        """Publish an accepted pose on both topics; drops rather than blocks, and never raises.

        Args:
            pose: ``frame_from_target``.
            covariance: (6, 6), of a perturbation from the left in the frame's axes.
            t_capture_ns: of the exposure, drone's clock.
        """
        if self._publishers is None:
            self.not_connected += 1
            return
        # Mapped anew each time: the wall clock may be set while the drone flies
        unix_ns = self._unix_ns()
        stamp_ns = unix_ns - (self._clock.now_ns() - t_capture_ns)
        plain, with_covariance = self._publishers
        try:
            plain.put(pose_stamped(stamp_ns, self._frame_id, pose), unix_ns)
            with_covariance.put(
                pose_with_covariance_stamped(stamp_ns, self._frame_id, pose, covariance), unix_ns
            )
        except (zenoh.ZError, ValueError):
            self.errors += 1
        else:
            self.published += 1

    def close(self) -> None:
        """Stop connecting and close the session; poses after that are counted as errors."""
        with self._lock:
            self._closing.set()
            session, self._session = self._session, None
        if session is not None:
            close_client(session)
        # A try that hangs in a connect ends by itself, and then closes what it opened
        self._opener.join(timeout=RETRY_S)

    def _open(self) -> None:
        while not self._closing.is_set():
            try:
                session = self._opened()
            except zenoh.ZError:
                self._closing.wait(RETRY_S)
                continue
            with self._lock:
                if not self._closing.is_set():
                    self._session = session
                    return
            close_client(session)

    def _opened(self) -> zenoh.Session:
        session = open_client(self._endpoints)
        try:
            first, second = (
                self._declare(session, number, *self._topics[number]) for number in range(2)
            )
        except zenoh.ZError:
            close_client(session)
            raise
        self._publishers = first, second
        return session

    def _declare(
        self, session: zenoh.Session, number: int, topic: str, message: MessageType
    ) -> _Publisher:
        publisher = session.declare_publisher(
            key(self._flavour, topic, message, self._domain),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA,
            express=True,
        )
        if self._flavour is Flavour.BRIDGE:
            return _Publisher(publisher, None, ())
        where = self._domain, str(session.zid()), self._node
        token = publisher_token(*where, number + 1, topic, message)
        keys = (node_token(*where), token) if number == 0 else (token,)
        tokens = tuple(session.liveliness().declare_token(k) for k in keys)
        return _Publisher(publisher, gid(token), tokens)


class _Publisher:
    """One topic, with what rmw_zenoh wants beside each message."""

    def __init__(
        self,
        publisher: zenoh.Publisher,
        publisher_gid: bytes | None,
        tokens: tuple[zenoh.LivelinessToken, ...],
    ) -> None:
        self._publisher = publisher
        self._gid = publisher_gid
        self._tokens = tokens  # held: a token that is collected is taken down
        self._sequence = 0

    def put(self, message: bytes, unix_ns: int) -> None:
        if self._gid is None:
            self._publisher.put(message)
            return
        self._sequence += 1
        self._publisher.put(message, attachment=attachment(self._sequence, unix_ns, self._gid))


def check_way(endpoints: tuple[str, ...], domain: int) -> None:
    """Whether ROS 2 can be reached like this.

    Raises:
        LinkError: an endpoint is malformed or encrypted, or the domain has no ports in DDS.
    """
    for endpoint in endpoints:
        if not check_endpoint(endpoint).startswith("tcp/"):
            raise LinkError(f"{endpoint}: messages of ROS 2 go over tcp/ alone")
    if not 0 <= domain <= MAX_DOMAIN:
        raise LinkError(f"ROS domain {domain}, expected 0 to {MAX_DOMAIN}")


def open_client(endpoints: tuple[str, ...]) -> zenoh.Session:
    """A session with the first of some routers, bridges or peers that answers.

    Raises:
        zenoh.ZError: none does.
    """
    config = zenoh.Config()
    for path, value in _CONFIG.items():
        config.insert_json5(path, json.dumps(value))
    config.insert_json5("connect/endpoints", json.dumps(endpoints))
    return zenoh.open(config)


def close_client(session: zenoh.Session) -> None:
    """Close it, whatever it says."""
    with suppress(zenoh.ZError):  # a receiver that stands still: 10 s, and then it is left
        session.close()  # type: ignore[no-untyped-call]  # zenoh's stub lacks "-> None"


_CONFIG: dict[str, object] = {
    "mode": "client",
    "connect/timeout_ms": {"client": 0},
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    "listen/endpoints": [],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    "transport/link/protocols": ["tcp"],
    # Room for some poses while the sending thread gets no core, and no waiting for more: the
    # default of two batches is one pose, and holds up the caller by 1 ms for each that is full
    "transport/link/tx/queue/size/data": 16,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    # Poses, odometry and distances: whatever comes in is small
    "transport/link/rx/max_message_size": 1_000_000,
}
