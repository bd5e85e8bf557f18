"""After the mission the VIO goes on to the autopilot, until the vehicle's motors stand still.

What this client passes on may be all that the vehicle knows its place by, also in the hands of its
pilot: an estimator that hears nothing any more loses the hold within seconds, a metre from the wall
(docs/px4.md).
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Final

from drone_client.autopilot import FlyingAutopilot
from drone_client.errors import ClientError
from drone_client.odometry.feed import OdometryFeed
from rgbd_wire.clock import Clock

FEED_S: Final = 0.01
"""How often the newest sample is looked for; a VIO says up to a hundred a second."""
LOOK_S: Final = 0.1
GONE_NS: Final = 10_000_000_000
"""A vehicle that has not been heard for so long is switched off, or out of reach."""


class FeedOn:
    """A context: feeding that was begun inside it goes on at its end until the vehicle is down.

    Ctrl-C ends the wait; a terminal that is closed does not, for nobody may have the sticks yet.
    """

    def __init__(
        self,
        feed: OdometryFeed | None,
        vehicle: FlyingAutopilot,
        clock: Clock,
        tell: Callable[[str], None],
        look: Callable[[], None] = lambda: None,
    ) -> None:
        """Nothing begins yet.

        Args:
            feed: None, or one that has passed nothing on: nobody is waited for.
            vehicle: gets the samples; its line stays open.
            clock: the drone's.
            tell: a sentence to the person in charge.
            look: called some times a second while it waits.
        """
        self._feed = feed
        self._vehicle = vehicle
        self._clock = clock
        self._tell = tell
        self._look = look
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> FeedOn:
        """Itself."""
        return self

    def begin(self) -> None:
        """Feed from a thread of its own: the control loop, which did, is about to end."""
        if self._feed is not None and self._thread is None:
            self._thread = threading.Thread(target=self._run, name="feed on", daemon=True)
            self._thread.start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Wait until the vehicle needs no feeding; says first what ended the flight."""
        if self._thread is None:
            return
        try:
            if self._is_needed():
                if isinstance(error, ClientError):
                    self._tell(str(error))
                self._wait()
        except KeyboardInterrupt:
            self._tell("no VIO is passed on to the vehicle any more")
        finally:
            self._stop.set()
            self._thread.join(timeout=1.0)

    def _wait(self) -> None:
        self._tell(
            "the vehicle may know its place by the VIO alone that this client passes on, which it "
            "does until the motors stand still: fly it down by hand (Ctrl-C ends it)"
        )
        with _deaf_to_hang_up():
            while self._is_needed():
                self._look()
                time.sleep(LOOK_S)

    def _is_needed(self) -> bool:
        if self._feed is None or not self._feed.given:
            return False
        state = self._vehicle.state()
        if state is None or not state.armed:
            return False
        return self._clock.now_ns() - state.t_heard_ns < GONE_NS

    def _run(self) -> None:
        assert self._feed is not None
        while not self._stop.wait(FEED_S):
            self._feed.tick(self._clock.now_ns())


@contextmanager
def _deaf_to_hang_up() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)
