"""Where the exceptions of a network thread end: nobody else would hear of them."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from rgbd_wire.tunnel.errors import Counters, Refusal

REST_S = 0.02
"""After a fault of its own a loop rests so long: what failed may fail again at once."""
_log = logging.getLogger(__name__)


class Faults:
    """Counts them, and logs the first of each type with its traceback.

    Args:
        counters: where they are counted.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._seen: set[type[Exception]] = set()

    def note(self, error: Exception, place: str) -> None:
        """An exception came out of a place that should have none."""
        self._counters.count(Refusal.FAULT)
        if type(error) not in self._seen:  # the counter tells how often; the log, that it is so
            self._seen.add(type(error))
            _log.error("fault in %s; it goes on", place, exc_info=error)

    @contextmanager
    def contained(self, place: str) -> Iterator[None]:
        """Nothing but a fault's note comes out of this."""
        try:
            yield
        except Exception as error:  # the thread's boundary: it serves others, too
            self.note(error, place)
