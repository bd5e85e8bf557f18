"""A one-slot mailbox between two threads: the newest item wins, and what it displaced is told."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """Holds at most one item. ``put`` never blocks; ``take`` waits."""

    def __init__(self) -> None:
        self._item: T | None = None
        self._closed = False
        self._changed = threading.Condition()

    def put(self, item: T) -> T | None:
        """Place an item; returns the one that it displaced, which nobody will ever take."""
        with self._changed:
            displaced, self._item = self._item, item
            self._changed.notify()
            return displaced

    def take(self, timeout_s: float) -> T | None:
        """Take the item out; None after the time-out or once closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._item is not None or self._closed, timeout_s)
            item, self._item = self._item, None
            return item

    def close(self) -> None:
        """Wake whoever waits; what is in the slot can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
