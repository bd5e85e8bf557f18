"""The thread that sends what could not leave at once: the rest of paced frames, second copies."""

from __future__ import annotations

import threading

from rgbd_wire.clock import Clock
from rgbd_wire.tunnel.channel import Channel
from rgbd_wire.tunnel.faults import Faults


class Pump:
    """Calls ``pump`` of each channel when it is due.

    Args:
        name: of the thread.
        clock: own clock.
        faults: where what goes wrong with a channel is counted; the others are served on.
    """

    def __init__(self, name: str, clock: Clock, faults: Faults) -> None:
        self._clock = clock
        self._faults = faults
        self._due: dict[Channel, int] = {}
        self._wake = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    def is_alive(self) -> bool:
        """The thread runs."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def at(self, channel: Channel, due_ns: int | None) -> None:
        """Come back to a channel at a time; None: nothing is due."""
        if due_ns is None:
            return
        with self._wake:
            known_ns = self._due.get(channel)
            if known_ns is None or due_ns < known_ns:
                self._due[channel] = due_ns
                self._wake.notify()

    def close(self) -> None:
        """Stop; what has not left stays."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while (ready := self._wait()) is not None:
            for channel in ready:
                with self._faults.contained("the pump"):  # it is not due again, so this cannot spin
                    self.at(channel, channel.pump(self._clock.now_ns()))

    def _wait(self) -> list[Channel] | None:
        with self._wake:
            while not self._closed:
                now_ns = self._clock.now_ns()
                ready = [c for c, due_ns in self._due.items() if due_ns <= now_ns]
                for channel in ready:
                    del self._due[channel]
                if ready:
                    return ready
                next_ns = min(self._due.values(), default=None)
                self._wake.wait(None if next_ns is None else (next_ns - now_ns) / 1e9)
        return None
