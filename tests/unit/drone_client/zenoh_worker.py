"""A worker's Zenoh session on a loopback port, without a service behind it."""

from __future__ import annotations

import json
import queue
from collections.abc import Callable, Iterable

import zenoh

from rgbd_wire.streams import FRAME, PROBE, RESULT, worker_key, worker_status_key
from tests.service_process import free_port
from tests.unit.drone_client.builders import eventually

Answer = Callable[[str, bytes], Iterable[bytes]]


class ZenohWorker:
    """A router with a liveliness token that answers frames; may be closed and opened again."""

    def __init__(self, name: str = "w1", answer: Answer = lambda worker, frame: ()) -> None:
        self.name = name
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.frames: queue.Queue[bytes] = queue.Queue()
        self.probes: queue.Queue[zenoh.Sample] = queue.Queue()
        self._answer = answer
        self.open()

    def open(self) -> None:
        """Listen, subscribe, and say that it is there."""
        config = zenoh.Config()
        for key, value in {
            "mode": "router",
            "listen/endpoints": [self.endpoint],
            "open/return_conditions/connect_scouted": False,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/shared_memory/enabled": False,
            # A machine that stands still for a while loses no link
            "transport/link/tx/lease": 60_000,
        }.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self._subscriber = self.session.declare_subscriber(
            FRAME.key("*", self.name), self._on_frame
        )
        self._probe_subscriber = self.session.declare_subscriber(
            PROBE.key("*", self.name), self.probes.put
        )
        self.token = self.announce(self.name)

    def announce(self, name: str) -> zenoh.LivelinessToken:
        """Put up the token of a worker."""
        return self.session.liveliness().declare_token(worker_key(name))

    def reaches(self, drone: str) -> bool:
        """Whether the drone's subscriptions have got here before long.

        A drone that sees the token may not be heard of here yet, and what is sent meanwhile is
        lost (5 of 2400 first replies). A frame that came from it proves that it is.
        """
        keys = (RESULT.key(drone, self.name), worker_status_key(self.name))
        publishers = [self.session.declare_publisher(key) for key in keys]
        try:
            return eventually(
                lambda: all(p.matching_status.matching for p in publishers), timeout_s=20
            )
        finally:
            for publisher in publishers:
                publisher.undeclare()

    def reply(self, drone: str, message: bytes) -> None:
        """Send an ack or a result, and lose none on a busy machine."""
        self._put(RESULT.key(drone, self.name), message)

    def say(self, status: bytes) -> None:
        """Publish a status to all drones."""
        self._put(worker_status_key(self.name), status)

    def close(self) -> None:
        """Go away without a word, as a process that dies does."""
        self.session.close()

    def _put(self, key: str, message: bytes) -> None:
        self.session.put(key, message, congestion_control=zenoh.CongestionControl.BLOCK)

    def _on_frame(self, sample: zenoh.Sample) -> None:
        message = sample.payload.to_bytes()
        drone = str(sample.key_expr).split("/")[2]
        for reply in self._answer(self.name, message):
            self.reply(drone, reply)
        self.frames.put(message)
