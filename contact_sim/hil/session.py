"""From a connection to its end: one flight, paced by the machine's clock, and what it came to."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Final

from contact_sim.errors import HilError, PeerGoneError, VehicleError
from contact_sim.flight.outcome import Outcome, Witness
from contact_sim.hil.flight import TURN_NS, HilFlight, HilSettings
from contact_sim.hil.lockstep import ByteLine, Lockstep, Patience
from contact_sim.scene import Scene
from contact_sim.sensing import d455
from contact_sim.simulation import Simulation, SimulationSettings
from drone_client.airframe import Airframe
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.clock import Clock

LATE_NS: Final = 250_000_000
"""More than so much is not made up for: simulated time slips against the clock."""
INTERRUPTED: Final = "interrupted"


@dataclass(frozen=True, slots=True)
class FlightReport:
    """A flight in numbers."""

    why: str
    """It ended."""
    failed: bool
    """It ended by a fault: silence, garbage, diverged physics."""
    system: int | None
    """MAVLink's number of the autopilot."""
    simulated_s: float
    took_s: float
    armed_s: float
    counts: dict[str, int]
    """Of questions, answers, and what was wrong with them."""
    outcome: Outcome

    def as_json(self) -> dict[str, Any]:
        """For a program: what is not known is null."""
        outcome = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in self.outcome.as_json().items()
        }
        return {**asdict(self), "outcome": outcome}


class Session:
    """One flight."""

    def __init__(
        self,
        line: ByteLine,
        scene: Scene,
        seed: int,
        settings: HilSettings,
        patience: Patience,
        clock: Clock,
        airframe: Airframe | None = None,
        rig: RgbdCamera | None = None,
    ) -> None:
        """Put the drone into the scene; ``fly`` lets time pass.

        Args:
            line: to the autopilot.
            scene: with the drone on the ground.
            seed: of all that is drawn by chance.
            settings: what is sent.
            patience: how long is waited.
            clock: the machine's.
            airframe: None: the usual one.
            rig: None: the usual one.

        Raises:
            VehicleError: the drone cannot be built so.
            ValueError: a setting is out of its bounds.
        """
        simulation = Simulation(
            scene,
            airframe or Airframe(),
            rig or d455(),
            seed,
            SimulationSettings(rotors_from_outside=True),
        )
        self.flight = HilFlight(simulation, Lockstep(line, patience, clock), seed, settings)
        self._witness = Witness(scene.world_from_target)
        self._clock = clock
        self._begun_ns = clock.now_ns()
        self._slipped_ns = 0

    @property
    def simulation(self) -> Simulation:
        """The world; between two turns only."""
        return self.flight.simulation

    @property
    def took_s(self) -> float:
        """Time since the beginning, on the machine's clock."""
        return (self._clock.now_ns() - self._begun_ns) / 1e9

    def fly(self, speed: float, on_turn: Callable[[Session], None]) -> FlightReport:
        """Until the autopilot goes, fails or somebody interrupts.

        Args:
            speed: simulated seconds in a second of the machine at most; 0: as fast as it goes.
            on_turn: called after each turn; a ``KeyboardInterrupt`` in it ends the flight, too.
        """
        try:
            while True:
                self.flight.turn()
                self._witness.look(self.simulation)
                on_turn(self)
                if speed > 0.0:
                    self._pace(speed)
        except PeerGoneError as error:
            return self._report(str(error), failed=False)
        except (HilError, VehicleError) as error:
            return self._report(str(error), failed=True)
        except KeyboardInterrupt:
            return self._report(INTERRUPTED, failed=False)

    def _pace(self, speed: float) -> None:
        passed_ns = self._clock.now_ns() - self._begun_ns - self._slipped_ns
        ahead_ns = round(self.simulation.t_ns / speed) - passed_ns
        if ahead_ns < -LATE_NS:
            self._slipped_ns -= ahead_ns + LATE_NS
        elif ahead_ns > 0:
            time.sleep(ahead_ns / 1e9)

    def _report(self, why: str, *, failed: bool) -> FlightReport:
        return FlightReport(
            why,
            failed,
            self.flight.lockstep.reader.system,
            self.simulation.t_ns / 1e9,
            self.took_s,
            self.flight.armed_turns * TURN_NS / 1e9,
            self.flight.counts(),
            self._witness.outcome(self.simulation, TURN_NS / 1e9),
        )
