"""VIO and lidars of a robot that runs ROS 2, over Zenoh: nothing of ROS is needed here.

A session of its own, as a client of one router, bridge or peer. Each topic has one slot with its
newest sample; what is no message, or no sample, is counted by its reason and changes nothing.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

import zenoh

from drone_client.errors import LinkError
from drone_client.odometry import OdometrySample, RangeSample
from drone_client.odometry.ros_samples import SampleError, odometry_sample, range_sample
from drone_client.ros.cdr_read import MAX_MESSAGE_BYTES, read_odometry, read_range
from drone_client.ros.names import ODOMETRY, RANGE, Flavour, check_topic, heard_key
from drone_client.ros.zenoh_client import ClientOpener, check_way
from rgbd_wire.clock import Clock

OnMessage = Callable[[bytes, int, int], None]
MALFORMED: Final = "malformed"


class RosOdometry:
    """An ``OdometrySource`` that hears ROS 2 topics.

    Raises:
        LinkError: no topic or no endpoint, or one that cannot be one.
    """

    def __init__(
        self,
        endpoints: tuple[str, ...],
        clock: Clock,
        *,
        vio_topic: str | None = None,
        lidar_topic: str | None = None,
        ahead_topic: str | None = None,
        flavour: Flavour = Flavour.BRIDGE,
        domain: int = 0,
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Begin to connect, in the background.

        Args:
            endpoints: routers, bridges or peers; the first that answers is heard.
            clock: the drone's.
            vio_topic: of ``nav_msgs/Odometry``: the body (FLU) in a level world; None: no VIO.
            lidar_topic: of ``sensor_msgs/Range``, looking down; None: no such lidar.
            ahead_topic: of ``sensor_msgs/Range``, looking along the body's x.
            flavour: the way into ROS 2.
            domain: ROS_DOMAIN_ID of the publishers; for rmw_zenoh alone.
            unix_ns: this machine's wall clock, which the stamps are of [ns].
        """
        if not endpoints:
            raise LinkError("no endpoint to hear odometry from; such as tcp/127.0.0.1:7447")
        check_way(endpoints, domain)
        topics = [
            (vio_topic, ODOMETRY, self._on_odometry),
            (lidar_topic, RANGE, self._on_height),
            (ahead_topic, RANGE, self._on_ahead),
        ]
        self._heard = [
            (heard_key(flavour, check_topic(topic), kind, domain), take)
            for topic, kind, take in topics
            if topic is not None
        ]
        if not self._heard:
            raise LinkError("no topic of a VIO or lidar to hear; such as /vio/odometry")
        self.taken: Counter[str] = Counter()
        """Samples by what they are of: odometry, height, ahead."""
        self.refused: Counter[str] = Counter()
        """Messages that were none, by reason."""
        self._clock = clock
        self._unix_ns = unix_ns
        self._lock = threading.Lock()
        self._odometry: OdometrySample | None = None
        self._height: RangeSample | None = None
        self._ahead: RangeSample | None = None
        self._opener = ClientOpener(endpoints, self._prepare, "ros-odometry-open")

    @property
    def connected(self) -> bool:
        """Whether the session has been opened."""
        return self._opener.connected

    def odometry(self) -> OdometrySample | None:
        """The newest of the VIO; None: none yet."""
        with self._lock:
            return self._odometry

    def height(self) -> RangeSample | None:
        """The newest of the lidar that looks down; None: none yet."""
        with self._lock:
            return self._height

    def ahead(self) -> RangeSample | None:
        """The newest of the lidar that looks forward; None: none yet."""
        with self._lock:
            return self._ahead

    def close(self) -> None:
        """Stop connecting, and close the session."""
        self._opener.close()

    def _prepare(self, session: zenoh.Session) -> None:
        for key, take in self._heard:
            callback = zenoh.handlers.Callback(self._on_sample(take), indirect=False)
            session.declare_subscriber(key, callback)

    def _on_sample(self, take: OnMessage) -> Callable[[zenoh.Sample], None]:
        def on_sample(sample: zenoh.Sample) -> None:
            # Both clocks at once, before any work: the wall clock may be set while the drone flies
            now_ns, unix_now_ns = self._clock.now_ns(), self._unix_ns()
            try:
                if len(sample.payload) > MAX_MESSAGE_BYTES:
                    raise ValueError(f"{len(sample.payload)} bytes")
                take(sample.payload.to_bytes(), unix_now_ns, now_ns)
            except SampleError as error:
                self._refuse(str(error))
            except ValueError:
                self._refuse(MALFORMED)

        return on_sample

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self.refused[reason] += 1

    def _on_odometry(self, message: bytes, unix_now_ns: int, now_ns: int) -> None:
        sample = odometry_sample(read_odometry(message), unix_now_ns, now_ns)
        with self._lock:
            self._odometry = sample
            self.taken["odometry"] += 1

    def _on_height(self, message: bytes, unix_now_ns: int, now_ns: int) -> None:
        sample = range_sample(read_range(message), unix_now_ns, now_ns, looks_down=True)
        with self._lock:
            self._height = sample
            self.taken["height"] += 1

    def _on_ahead(self, message: bytes, unix_now_ns: int, now_ns: int) -> None:
        sample = range_sample(read_range(message), unix_now_ns, now_ns, looks_down=False)
        with self._lock:
            self._ahead = sample
            self.taken["ahead"] += 1
