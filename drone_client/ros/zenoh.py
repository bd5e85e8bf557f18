"""Publishes accepted poses to ROS 2: own session, own topics, never in the way of the flight.

A client of one router, bridge or peer, which then passes the poses on: the router of rmw_zenoh
does not route between peers. Until the session is open (``zenoh_client``) poses are dropped and
counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import zenoh

from drone_client.errors import LinkError
from drone_client.ros.cdr import pose_stamped, pose_with_covariance_stamped
from drone_client.ros.names import (
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
from drone_client.ros.zenoh_client import ClientOpener, check_way
from rgbd_wire.clock import Clock
from rgbd_wire.geometry import Array, Pose

COVARIANCE_SUFFIX = "_with_covariance"


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
        self._clock = clock
        self._unix_ns = unix_ns
        self._flavour = flavour
        self._frame_id = check_frame(frame_id)
        self._domain = domain
        self._node = node_name(drone)
        self._publishers: tuple[_Publisher, _Publisher] | None = None
        self._opener = ClientOpener(endpoints, self._prepare, "ros-poses-open")

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
        self._opener.close()

    def _prepare(self, session: zenoh.Session) -> None:
        first, second = (
            self._declare(session, number, *self._topics[number]) for number in range(2)
        )
        self._publishers = first, second

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
