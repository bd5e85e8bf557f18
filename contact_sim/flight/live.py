"""A simulation that goes on as the drone's clock does, in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from contact_sim.errors import SimulatorError
from contact_sim.scene import Snapshot
from contact_sim.simulation import STEP_NS, Simulation
from drone_client.autopilot.offboard_rules import OffboardRules
from rgbd_wire.clock import Clock

TURN_STEPS: Final = 2
"""Between two looks at what is commanded: 4 ms, the rate of the vehicle's own loops."""
TURN_NS: Final = TURN_STEPS * STEP_NS
LATE_NS: Final = 250_000_000
"""More than so much is not made up for at once: simulated time slips against the clock."""
JOIN_S: Final = 5.0


class LiveSimulation:
    """Steps a simulation; whoever looks into it holds its lock.

    Simulated time is the drone's clock less ``offset_ns``. A machine that is too slow lets it slip:
    ``slipped_ns`` says by how much, and every stamp is on the time line that was valid then.
    """

    late_ns = LATE_NS

    def __init__(
        self,
        simulation: Simulation,
        clock: Clock,
        on_turn: Callable[[Simulation, int], None] = lambda simulation, now_ns: None,
    ) -> None:
        """Take a simulation over; nobody else steps it.

        Args:
            simulation: at its beginning.
            clock: the drone's.
            on_turn: called after every 4 ms of simulated time, with the lock held: faults, logs.
        """
        self.rules = OffboardRules()
        self.slipped_ns = 0
        self.error: SimulatorError | None = None
        """Why it stands still; None: it does not."""
        self._simulation = simulation
        self._clock = clock
        self._on_turn = on_turn
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._offset_ns = clock.now_ns() - simulation.t_ns
        self._heard_ns = clock.now_ns()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)

    def start(self) -> None:
        """Let time pass."""
        self._offset_ns = self._clock.now_ns() - self._simulation.t_ns
        self._thread.start()

    def stop(self) -> None:
        """Let it stand still; also when it never ran."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    @contextmanager
    def look(self) -> Iterator[tuple[Simulation, int]]:
        """The simulation, and the offset of its time [ns]; both hold still meanwhile."""
        with self._lock:
            yield self._simulation, self._offset_ns

    @property
    def heard_ns(self) -> int:
        """When the vehicle was last alive, drone's clock."""
        return self._heard_ns

    def snapshot(self) -> tuple[Snapshot, int]:
        """Where everything is, and the offset of its time [ns]."""
        with self._lock:
            return self._simulation.snapshot(), self._offset_ns

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                left_ns = self._catch_up()
            except SimulatorError as error:
                self.error = error  # from now on the vehicle is silent, and the client notices
                return
            self._stopping.wait(left_ns / 1e9)

    def _catch_up(self) -> int:
        """Step up to now; returns the time until the next turn is due [ns]."""
        while not self._stopping.is_set():
            if (left_ns := self._left_ns()) > 0:
                return left_ns
            self._turn()
        return 0

    def _left_ns(self) -> int:
        """Time until the next turn is due; what is later than can be made up for slips."""
        with self._lock:
            now_ns = self._clock.now_ns()
            behind_ns = now_ns - self._offset_ns - self._simulation.t_ns
            if behind_ns < TURN_NS:
                self._heard_ns = now_ns
            elif behind_ns > self.late_ns:
                self._offset_ns += behind_ns - self.late_ns
                self.slipped_ns += behind_ns - self.late_ns
            return TURN_NS - behind_ns

    def _turn(self) -> None:
        with self._lock:
            simulation = self._simulation
            at_ns = simulation.t_ns + self._offset_ns
            wanted = self.rules.wanted(at_ns)
            simulation.set_velocity(wanted.velocity_world, wanted.yaw_rate_radps)
            simulation.step(TURN_STEPS)
            self._on_turn(simulation, at_ns + TURN_NS)
