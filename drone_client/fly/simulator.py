"""A simulated world in place of camera, autopilot and odometry; whoever is installed brings it.

The client knows no simulator. One that is installed beside it says so by an entry point of the
group ``drone_client.simulators``: a function that takes a ``SimulatorRequest`` and a clock, and
gives a ``Simulator``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final, Protocol, cast

from drone_client.airframe import Airframe
from drone_client.autopilot import FlyingAutopilot
from drone_client.cbf import Funnel
from drone_client.errors import WorldError
from drone_client.flight_settings import FlightSettings
from drone_client.odometry.source import OdometrySource
from drone_client.source import LiveSource
from rgbd_wire.clock import Clock

GROUP: Final = "drone_client.simulators"


@dataclass(frozen=True, slots=True)
class SimulatorRequest:
    """Which flight."""

    world: str
    seed: int
    board: str
    """State of the print."""
    link: str | None
    """Name of an emulated link to the service; None: none in between."""
    drone: str
    """This drone's name."""
    folder: Path
    """For logs, keys, and how it truly was."""
    starts_service: bool
    """No service was named: start one."""
    hil: str | None = None
    """HOST:PORT where a PX4 outside calls its simulator, to be the vehicle; None: the simulator has
    a vehicle of its own."""
    autopilot: str = ""
    """The client's address of that PX4."""
    airframe: Airframe = field(default_factory=Airframe)
    """Of the drone: what the client believes of it, the world has."""
    mouth_m: float = Funnel().r_c_m
    """Radius within which the tip may touch."""


class Simulator(Protocol):
    """A world that runs. ``close`` ends all of it, whatever has happened."""

    @property
    def camera(self) -> LiveSource:
        """The simulated camera."""
        ...

    @property
    def vehicle(self) -> FlyingAutopilot:
        """Hovers, armed, in its pilot's mode."""
        ...

    @property
    def odometry(self) -> OdometrySource:
        """VIO and lidars."""
        ...

    @property
    def floor_m(self) -> float:
        """Height of the floor in the odometry's world."""
        ...

    @property
    def ceiling_m(self) -> float | None:
        """Height of the ceiling; None: open sky."""
        ...

    def tuned(self, parts: FlightSettings) -> FlightSettings:
        """The settings for this world, where the user has tuned none."""
        ...

    @property
    def reach(self) -> dict[str, Any]:
        """The client's settings to reach the service that was started, if one was."""
        ...

    def report(self) -> dict[str, Any]:
        """What the flight truly came to; may be asked at any time.

        The client shows of it what ``truly`` names. ``safe``: nothing but the tip touched anything,
        and that not beside the mouth.
        """
        ...

    def film(self, run: Path, path: Path, on_progress: Callable[[float], None]) -> None:
        """Let the world stand still, and draw the flight that is over into a video.

        Args:
            run: folder of the run.
            path: of the video; its suffix says which kind.
            on_progress: told the share that is done, now and then.

        Raises:
            WorldError: it cannot be drawn here, or not be written.
        """
        ...

    def close(self) -> None:
        """Let the world stand still and end what was started."""
        ...


def open_simulator(request: SimulatorRequest, clock: Clock) -> Simulator:
    """The world of a request, running.

    Raises:
        WorldError: no simulator is installed, there is no such world, seed or link, no drone of
            that airframe, nothing that draws its pictures, or no service came up.
    """
    for entry in entry_points(group=GROUP):
        try:
            opener = entry.load()
        except ModuleNotFoundError as error:
            raise WorldError(
                f"the simulator needs package {error.name}: install aerial-contact[sim]"
            ) from None
        return cast("Simulator", opener(request, clock))
    raise WorldError("no simulator is installed: install aerial-contact[sim]")
