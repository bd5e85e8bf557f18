"""The way to the workers and back: bytes, no meaning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

OnMessage: TypeAlias = Callable[[bytes, int], None]
"""Called with a message (ACK, RESULT, PROBE or STATUS) and the time [ns, drone's clock] at which
its last byte was here."""

OnWorkers: TypeAlias = Callable[[], None]
"""Called after ``workers()`` has changed."""


class Link(Protocol):
    """Sends messages to a named worker and hands over what comes back."""

    def start(self, on_message: OnMessage, on_workers: OnWorkers) -> None:
        """Begin to receive; both run on threads of the link's and must be quick."""
        ...

    def workers(self) -> tuple[str, ...]:
        """Names of the workers that are alive as far as the link knows, sorted."""
        ...

    def send(self, worker: str, message: bytes, budget_ns: int) -> None:
        """Hand a frame to the link; drops rather than blocks.

        Args:
            worker: its name.
            message: the whole message.
            budget_ns: how long from now the frame is of use; a link that sends lost parts again
                does so only within it.
        """
        ...

    def send_urgent(self, worker: str, message: bytes) -> None:
        """Hand a probe to the link: past all frames, dropped rather than waited for."""
        ...

    def unheard(self, worker: str) -> None:
        """Told of a worker that left several replies out: a link with another way tries it."""
        ...

    def close(self) -> None:
        """Stop receiving and free everything."""
        ...
