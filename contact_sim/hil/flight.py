"""One flight of an autopilot outside: read the instruments, ask, turn the rotors, step."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from contact_sim.hil.instruments import Instruments
from contact_sim.hil.lockstep import Lockstep
from contact_sim.hil.motors import Controls, Motors
from contact_sim.hil.outgoing import Outgoing
from contact_sim.hil.place import Place
from contact_sim.scene.drone import rotor_places
from contact_sim.simulation import CONTROL_STEPS, STEP_NS, Simulation

TURN_NS: Final = CONTROL_STEPS * STEP_NS
"""From one question to the next: HIL_SENSOR at 250 Hz."""


@dataclass(frozen=True, slots=True)
class HilSettings:
    """What the autopilot outside is told, and how its motors pull."""

    gps: bool = True
    """HIL_GPS: a home, for a PX4 that wants one before it arms."""
    vio: bool = True
    """ODOMETRY and DISTANCE_SENSOR; not where the client passes them on, as on the real robot."""
    thrust_curve: float = 0.0
    """``Motors.curve``."""
    place: Place = field(default_factory=Place)


class HilFlight:
    """Drives a simulation whose rotors are turned from outside."""

    def __init__(
        self, simulation: Simulation, lockstep: Lockstep, seed: int, settings: HilSettings
    ) -> None:
        """Take a simulation over, at its beginning.

        Args:
            simulation: with ``rotors_from_outside``; nobody else steps it.
            lockstep: the exchange with the autopilot.
            seed: of the noise of compass and barometer.
            settings: what is sent.

        Raises:
            VehicleError: its rotors are no X of four.
            ValueError: the thrust curve is none.
        """
        self.simulation = simulation
        self.lockstep = lockstep
        self.faults: Counter[str] = Counter()
        """Controls that were no thrust: ``not_a_number``, ``out_of_range``."""
        self.armed_turns = 0
        """In which it flew."""
        self._instruments = Instruments(settings.place, seed)
        self._outgoing = Outgoing(settings.place, gps=settings.gps, vio=settings.vio)
        self._motors = Motors.of(rotor_places(simulation.airframe), settings.thrust_curve)

    def counts(self) -> dict[str, int]:
        """Of questions and answers, and what was wrong with them."""
        # copies: they may be asked for while another thread flies
        counts = dict(self.lockstep.counts) | dict(self.lockstep.reader.counts)
        return counts | dict(self.faults)

    def turn(self) -> None:
        """The next 4 ms.

        Raises:
            PeerGoneError: the autopilot went.
            HilError: it cannot be spoken with.
            VehicleError: the physics have diverged.
        """
        self.obey(self.exchange(self.question()))

    def question(self) -> bytes | None:
        """What to ask now; None: nothing, at the very beginning."""
        simulation = self.simulation
        imu = simulation.read_imu()
        if imu is None:
            return None
        pose = simulation.truth.world_from_body
        w, x, y, z = pose.q_wxyz.tolist()
        reading = self._instruments.read(
            simulation.t_ns, imu, (w, x, y, z), float(pose.translation[2])
        )
        return self._outgoing.question(simulation, reading)

    def exchange(self, question: bytes | None) -> Controls | None:
        """Ask, and wait for the answer: what is to be flown now; None: nothing was said yet.

        The only part of a turn that waits, and it touches nothing of the simulation.
        """
        if question is None:
            return None
        controls = self.lockstep.ask(self.simulation.t_ns // 1000, question)
        for wish in self.lockstep.wishes:
            self._outgoing.heed(wish)
        return controls

    def obey(self, controls: Controls | None) -> None:
        """Turn the rotors, and let 4 ms pass."""
        if controls is not None:
            self.armed_turns += controls.armed
            self.simulation.set_rotors(self._motors.thrusts(controls, self.faults))
        self.simulation.step(CONTROL_STEPS)
