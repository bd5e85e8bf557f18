"""What the person in charge wants, between the thread that hears it and the one that flies."""

from __future__ import annotations

from drone_client.mission import Order


class Orders:
    """Stand until told to go; an abort is final. One writer; any reader."""

    def __init__(self) -> None:
        self._now = Order.HOLD

    @property
    def now(self) -> Order:
        """The order that holds."""
        return self._now

    def give(self, order: Order) -> None:
        """Change it, unless the mission was aborted."""
        if self._now is not Order.ABORT:
            self._now = order
