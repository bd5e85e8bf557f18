"""A simulation in real time whose rotors are turned by an autopilot outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from contact_sim.flight.live import TURN_NS, LiveSimulation
from contact_sim.hil.flight import HilFlight
from contact_sim.simulation import Simulation
from rgbd_wire.clock import Clock

LATE_NS: Final = 3_000_000_000
"""Up to so much is made up for. The autopilot's clock is the simulated one: each slip of it would
have to be noticed by whoever keeps the two clocks together, and until then no stamp is right."""
ASIDE_NS: Final = 500_000_000
"""Between two times that something else is seen to."""


class HilLive(LiveSimulation):
    """Steps as its autopilot answers, and no faster than the clock.

    While an answer is waited for, time stands still, and whoever looks into the simulation does not
    wait for it. An autopilot that goes or hangs is the end: ``error`` says so, and time stands
    still for good.
    """

    late_ns = LATE_NS

    def __init__(
        self,
        flight: HilFlight,
        clock: Clock,
        on_turn: Callable[[Simulation, int], None] = lambda simulation, now_ns: None,
        aside: Callable[[], None] = lambda: None,
    ) -> None:
        """Take a flight over, at its beginning.

        Args:
            flight: nobody else turns it.
            clock: the drone's.
            on_turn: called after every turn, with the lock held.
            aside: called before the first turn, and at most every ``ASIDE_NS`` again, without the
                lock; it neither waits nor raises.
        """
        super().__init__(flight.simulation, clock, on_turn)
        self._flight = flight
        self._aside = aside
        self._aside_due_ns = clock.now_ns()

    def _turn(self) -> None:
        flight = self._flight
        with self._lock:
            question = flight.question()
        if (now_ns := self._clock.now_ns()) >= self._aside_due_ns:
            self._aside_due_ns = now_ns + ASIDE_NS
            self._aside()
        controls = flight.exchange(question)
        with self._lock:
            at_ns = flight.simulation.t_ns + self._offset_ns
            flight.obey(controls)
            self._on_turn(flight.simulation, at_ns + TURN_NS)
