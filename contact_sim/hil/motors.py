"""PX4's motors onto the simulated rotors: whose number is where, and how much a control lifts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from contact_sim.vehicle.rotors import MAX_THRUST_N, Mixer, Thrusts
from drone_client.cbf.vector import Vec3

QUARTERS: Final = ((True, False), (False, True), (True, True), (False, False))
"""(ahead, left) of PX4's motors 1 to 4 of a quadrotor x: front right, rear left, front left, rear
right. The first two turn counter-clockwise, as the simulated ones there do."""
STILL: Final[Thrusts] = (0.0, 0.0, 0.0, 0.0)


class Controls(NamedTuple):
    """HIL_ACTUATOR_CONTROLS, as far as it counts."""

    t_us: int
    """PX4's clock: the stamp of the HIL_SENSOR that it answers."""
    motors: tuple[float, float, float, float]
    """0 to 1, in PX4's order."""
    armed: bool
    lockstep: bool
    """PX4 waits for us as we wait for it."""


@dataclass(frozen=True, slots=True)
class Motors:
    """Makes thrusts of controls.

    A control ``u`` lifts ``MAX_THRUST_N (f u^2 + (1 - f) u)``, with ``f`` the curve: what PX4
    calls THR_MDL_FAC. At 0, PX4's default, thrust is linear, and the drone hovers at 0.49.
    """

    motor_of_rotor: tuple[int, ...]
    """For each rotor of the simulation the index of PX4's motor."""
    curve: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.curve <= 1.0:
            raise ValueError(f"a thrust curve is from 0 to 1, not {self.curve}")

    @classmethod
    def of(cls, places_body: Sequence[Vec3], curve: float = 0.0) -> Motors:
        """For rotors at these places [m] (FLU).

        Raises:
            VehicleError: they are no X of four.
            ValueError: the curve is none.
        """
        Mixer.of(places_body)  # says what is wrong with them
        return cls(tuple(QUARTERS.index((x > 0.0, y > 0.0)) for x, y, _ in places_body), curve)

    def thrusts(self, controls: Controls, faults: Counter[str]) -> Thrusts:
        """What the rotors shall do [N], in the simulation's order.

        A motor whose control is no number stands still, as PX4 means it by NaN; what is out of 0
        to 1 is cut; both are counted. Disarmed, all of them stand still, whatever is said.
        """
        if not controls.armed:
            return STILL
        a, b, c, d = (self._thrust(controls.motors[m], faults) for m in self.motor_of_rotor)
        return a, b, c, d

    def _thrust(self, control: float, faults: Counter[str]) -> float:
        if not math.isfinite(control):
            faults["not_a_number"] += 1
            return 0.0
        if not 0.0 <= control <= 1.0:
            faults["out_of_range"] += 1
            control = min(max(control, 0.0), 1.0)
        return MAX_THRUST_N * control * (self.curve * control + 1.0 - self.curve)
