"""A real service as the eyes of a flight in lockstep: real codec, real link, real pictures.

Simulated time stands still while it looks, so its answer does not depend on how busy the machine
is, and the flight is the same every time.
"""

from __future__ import annotations

import secrets
import threading
import time
from typing import Final, Self

from contact_sim.errors import ServiceError
from contact_sim.lockstep.eyes import Look, Sizes
from drone_client.encoding_choice import ChosenEncoding
from drone_client.errors import ClientError
from drone_client.link import Link
from drone_client.link.choose import open_link
from drone_client.settings import default_settings
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.errors import DecodeError, WireError
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import BEST, FrameStamp, compress, pack
from rgbd_wire.geometry import Pose
from rgbd_wire.messages import Result, decode_result

BUDGET_NS: Final = 60_000_000_000
ANSWER_S: Final = 30.0
WORKER_S: Final = 20.0


class ServiceEyes:
    """Asks a worker for every frame, one at a time.

    Raises:
        ServiceError: no worker there, or one that does not answer.
    """

    needs_pictures = True

    def __init__(self, endpoint: str, drone: str = "lockstep") -> None:
        """Connect to a service; waits for its first worker."""
        self._drone = drone
        self._clock = MonotonicClock()
        self._boot_id = secrets.randbits(62)
        self._next = 0
        self._changed = threading.Condition()
        self._results: dict[int, Result] = {}
        try:
            reach = {"name": drone, "connect": endpoint}
            self._link: Link = open_link(default_settings().model_copy(update=reach), self._clock)
            self._link.start(self._on_message, self._on_workers)
        except (ClientError, WireError) as error:
            raise ServiceError(str(error)) from None
        give_up = time.monotonic() + WORKER_S
        with self._changed:
            while not self._link.workers():
                left = give_up - time.monotonic()
                if left <= 0.0:
                    self._link.close()
                    raise ServiceError(f"no worker at {endpoint} within {WORKER_S:g} s")
                self._changed.wait(min(left, 0.1))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the service."""
        self._link.close()

    def look(
        self, frame: RgbdFrame, camera_from_target: Pose, chosen: ChosenEncoding | None = None
    ) -> Look:
        """What the worker says of a frame.

        Raises:
            ServiceError: nothing, for too long, or that it did not look; or there is no worker
                any more.
        """
        workers = self._link.workers()
        if not workers:
            raise ServiceError("the service has gone: no worker is left")
        # A number of its own: a worker takes none twice, and flights count from zero
        number, self._next = self._next, self._next + 1
        stamp = FrameStamp(self._drone, self._boot_id, number, self._clock.now_ns(), BUDGET_NS)
        compressed = compress(frame, BEST if chosen is None else chosen.encoding)
        message = pack(compressed, stamp)
        with self._changed:
            self._results.clear()
        self._link.send(workers[0], message, BUDGET_NS)
        with self._changed:
            if not self._changed.wait_for(lambda: number in self._results, ANSWER_S):
                raise ServiceError(f"no answer to a frame within {ANSWER_S:g} s")
            result = self._results.pop(number)
        if not result.outcome.looked_at:
            # by the clock on the wall, or for what else it does: the flight would be another one
            raise ServiceError(f"the service looked at no picture of a flight: {result.outcome}")
        # And not what was sent, in which a name or a number of one digit more is another flight
        sizes = Sizes.of_pictures(len(compressed.color), compressed.depth.size_bytes)
        return Look(result.outcome, result.target, sizes)

    def _on_workers(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _on_message(self, message: bytes, t4_ns: int) -> None:
        try:
            kind, body = unseal(message, Kind.RESULT, Kind.ACK, Kind.PROBE, Kind.STATUS)
            result = decode_result(body) if kind is Kind.RESULT else None
        except DecodeError:
            return
        if result is None or (result.drone, result.boot_id) != (self._drone, self._boot_id):
            return
        with self._changed:
            self._results[result.sequence] = result
            self._changed.notify_all()
