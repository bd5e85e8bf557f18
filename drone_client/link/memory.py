"""A link without a network: a function answers each frame. For tests and one's own experiments."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from drone_client.link import OnMessage
from rgbd_wire.clock import Clock


class MemoryLink:
    """Calls ``answer(worker, message)`` for each frame and delivers what it gives, at once."""

    def __init__(
        self,
        clock: Clock,
        answer: Callable[[str, bytes], Iterable[bytes]],
        workers: tuple[str, ...] = ("memory",),
    ) -> None:
        self._clock = clock
        self._answer = answer
        self._workers = workers
        self._on_message: OnMessage | None = None

    def start(self, on_message: OnMessage) -> None:
        """Begin to deliver."""
        self._on_message = on_message

    def workers(self) -> tuple[str, ...]:
        """The names given at construction."""
        return self._workers

    def send(self, worker: str, message: bytes) -> None:
        """Deliver the answers of a frame on the caller's thread."""
        for reply in self._answer(worker, message):
            if self._on_message is not None:
                self._on_message(reply, self._clock.now_ns())

    def close(self) -> None:
        """Stop delivering."""
        self._on_message = None
