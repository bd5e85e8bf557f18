"""Lets one picture at a time through to the detector, and only so many wait for it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager


class BusyError(Exception):
    """Enough wait already."""


class Turnstile:
    """A bounded line before one place; bounds what waiting requests hold in memory, too."""

    def __init__(self, max_waiting: int) -> None:
        self._max_inside = 1 + max_waiting
        self._inside = 0
        self._place = asyncio.Lock()

    @asynccontextmanager
    async def line(self) -> AsyncIterator[asyncio.Lock]:
        """Stand in line; the lock that this gives is the place itself.

        Raises:
            BusyError: the line is full.
        """
        if self._inside >= self._max_inside:
            raise BusyError
        self._inside += 1
        try:
            yield self._place
        finally:
            self._inside -= 1
