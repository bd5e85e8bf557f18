"""A bound on what others can make us log: each kind of record once a minute, and how often it was.

Whoever reaches the HTTP port can send garbage, as often as he likes, and each piece of it is a
warning of the HTTP server's. A detector that is broken fails with every frame. A log that grows
with it fills a disk and hides what matters.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

EVERY_S = 60.0
MAX_KINDS = 64
"""Kinds that are told apart; those beyond share one. A kind is a text in some program's source."""


@dataclass(slots=True)
class _Kind:
    """What was last let through."""

    at_s: float
    """Monotonic."""
    held_back: int = 0
    """Since then."""


class LogLimit(logging.Filter):
    """Lets records of one kind through once in ``every_s``; for a handler. Thread-safe.

    A kind is the text before its arguments are put in, with the type of the exception. The next
    record that is let through carries ``held_back``, the number of those that were not.

    Args:
        name: of the logger, with those below it, that is bounded; the records of others pass.
        every_s: least time between two of a kind [s].
        now_s: monotonic time [s].
    """

    def __init__(
        self, name: str, every_s: float = EVERY_S, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(name)
        self._every_s = every_s
        self._now_s = now_s
        self._kinds: dict[object, _Kind] = {}
        self._lock = threading.Lock()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is let through."""
        if not super().filter(record):
            return True
        now_s = self._now_s()
        error = record.exc_info[0] if record.exc_info else None
        key: object = (record.levelno, record.msg, error)
        with self._lock:
            if key not in self._kinds and len(self._kinds) >= MAX_KINDS:
                key = None
            kind = self._kinds.get(key)
            if kind is None:
                self._kinds[key] = _Kind(now_s)
                return True
            if now_s - kind.at_s < self._every_s:
                kind.held_back += 1
                return False
            if kind.held_back:
                record.held_back = kind.held_back
            self._kinds[key] = _Kind(now_s)
            return True
