"""A PX4 outside as the vehicle that the client flies, in the world that the client's camera sees.

Two lines go to it: the simulator's, over TCP, for sensors and motors; and the client's own, as to a
real drone, for commands and state. VIO and height reach it through the client, as on a real drone.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Final

from contact_sim.flight.live import LiveSimulation
from contact_sim.hil.flight import HilFlight, HilSettings
from contact_sim.hil.ground import on_the_ground
from contact_sim.hil.line import Door
from contact_sim.hil.live import HilLive
from contact_sim.hil.lockstep import Lockstep, Patience
from contact_sim.scene import Scene
from contact_sim.simulation import Simulation, SimulationSettings
from drone_client.airframe import Airframe
from drone_client.autopilot import FlyingAutopilot
from drone_client.autopilot.choose import open_autopilot
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.clock import Clock

KNOCK_S: Final = 0.5


class Outside:
    """Opens both lines. ``close`` ends them, the vehicle given back first.

    Raises:
        HilError: the address to listen at cannot be.
        AutopilotError: the other one cannot.
    """

    def __init__(self, host: str, port: int, autopilot: str, clock: Clock) -> None:
        """Listen on both, and wait for nobody yet.

        Args:
            host: of this machine, where PX4 calls its simulator.
            port: there.
            autopilot: the client's address of it.
            clock: the drone's.
        """
        self._clock = clock
        with ExitStack() as undo:
            self._door = Door(host, port)
            undo.callback(self._door.close)
            self.vehicle: FlyingAutopilot = open_autopilot(autopilot, clock)
            self._stack = undo.pop_all()
        self.address = self._door.address
        self._flight: HilFlight | None = None
        self._turned_away = 0

    def live(
        self,
        scene: Scene,
        airframe: Airframe,
        rig: RgbdCamera,
        seed: int,
        on_turn: Callable[[Simulation, int], None],
    ) -> LiveSimulation:
        """Wait until PX4 has connected, however long it takes; time is let pass by ``start``.

        While it flies, whoever else connects is turned away.

        Args:
            scene: the drone is put on the ground of it.
            airframe: of the drone.
            rig: its cameras.
            seed: of all that is drawn by chance.
            on_turn: called after every turn.

        Raises:
            VehicleError: the drone cannot be built so.
        """
        settings = SimulationSettings(rotors_from_outside=True)
        simulation = Simulation(on_the_ground(scene), airframe, rig, seed, settings)
        while (line := self._door.wait(KNOCK_S)) is None:
            pass
        self._stack.callback(line.close)
        exchange = Lockstep(line, Patience(), self._clock)
        flight = HilFlight(simulation, exchange, seed, HilSettings(vio=False))
        self._flight = flight
        live = HilLive(flight, self._clock, on_turn, self._turn_away)
        self._stack.callback(live.stop)
        return live

    def counts(self) -> dict[str, int]:
        """Of questions and answers, and what was wrong with them; empty: nobody has connected.

        Also ``turned_away``, if there were any: who connected beside the one that flies.
        """
        if self._flight is None:
            return {}
        strangers = {"turned_away": self._turned_away} if self._turned_away else {}
        return self._flight.counts() | strangers

    def close(self) -> None:
        """Give the vehicle back while it still flies, then let the world stand still."""
        try:
            self.vehicle.close()
        finally:
            self._stack.close()

    def _turn_away(self) -> None:
        # the door may just have been closed; what is wrong with a stranger is not the flight's
        with suppress(OSError, ValueError):
            self._turned_away += self._door.turn_away()
