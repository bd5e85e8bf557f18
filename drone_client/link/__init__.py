"""The way to the workers and back: bytes, no meaning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

OnMessage: TypeAlias = Callable[[bytes, int], None]
"""Called with a message and the time [ns, drone's clock] at which its last byte was here."""


class Link(Protocol):
    """Sends frames to a named worker and hands over what comes back."""

    def start(self, on_message: OnMessage) -> None:
        """Begin to receive; ``on_message`` runs on a thread of the link's and must be quick."""
        ...

    def workers(self) -> tuple[str, ...]:
        """Names of the workers that are alive as far as the link knows, sorted."""
        ...

    def send(self, worker: str, message: bytes) -> None:
        """Hand a frame to the link; drops rather than blocks."""
        ...

    def close(self) -> None:
        """Stop receiving and free everything."""
        ...
