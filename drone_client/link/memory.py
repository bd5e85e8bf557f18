"""A link without a network: a function answers each frame. For tests and one's own experiments."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from drone_client.link import OnMessage, OnWorkers
from rgbd_wire.clock import Clock


class MemoryLink:
    """Calls ``answer(worker, message)`` for each frame and delivers what it gives, at once.

    Probes go to ``echo`` in the same way; without one they are lost.
    """

    def __init__(
        self,
        clock: Clock,
        answer: Callable[[str, bytes], Iterable[bytes]],
        workers: tuple[str, ...] = ("memory",),
        echo: Callable[[str, bytes], Iterable[bytes]] = lambda worker, message: (),
    ) -> None:
        self._clock = clock
        self._answer = answer
        self._workers = workers
        self._echo = echo
        self._on_message: OnMessage | None = None
        self._on_workers: OnWorkers | None = None

    def start(self, on_message: OnMessage, on_workers: OnWorkers) -> None:
        """Begin to deliver."""
        self._on_message = on_message
        self._on_workers = on_workers

    def workers(self) -> tuple[str, ...]:
        """The names given at construction or set since."""
        return self._workers

    def set_workers(self, workers: tuple[str, ...]) -> None:
        """Let workers come and go."""
        self._workers = workers
        if self._on_workers is not None:
            self._on_workers()

    def send(self, worker: str, message: bytes, budget_ns: int) -> None:
        """Deliver the answers of a frame on the caller's thread."""
        self.deliver(self._answer(worker, message))

    def send_urgent(self, worker: str, message: bytes) -> None:
        """Deliver the echoes of a probe on the caller's thread."""
        self.deliver(self._echo(worker, message))

    def unheard(self, worker: str) -> None:
        """There is no other way."""

    def deliver(self, messages: Iterable[bytes]) -> None:
        """Hand over what came from a worker, now."""
        for message in messages:
            if self._on_message is not None:
                self._on_message(message, self._clock.now_ns())

    def close(self) -> None:
        """Stop delivering."""
        self._on_message = None
