"""The errors of ``contact_sim``.

::

    SimulatorError
    ├── WorldError       a world, a board or a seed that there is not
    ├── RenderError      no OpenGL that could draw without a screen, or a drawing that failed
    ├── VehicleError     a drone that cannot be built, or a command that it cannot take
    ├── ServiceError     no service to fly with
    ├── CampaignError    faults, tables or numbers of a campaign that cannot be
    ├── FilmError        a flight that cannot be filmed: nothing recorded, no encoder, a full disk
    ├── FigureError      a figure that cannot be drawn, or not be written
    └── HilError         a PX4 that hangs or speaks something else, or a port that is taken
        └── PeerGoneError    it went: the end of a flight, and no fault
"""

from __future__ import annotations


class SimulatorError(Exception):
    """Root of this package's errors."""


class WorldError(SimulatorError):
    """A world was asked for by a name or a number that makes none."""


class RenderError(SimulatorError):
    """Nothing here draws without a screen, or what does was used wrongly."""


class VehicleError(SimulatorError):
    """A drone cannot be built as asked, or a command is none that it could follow."""


class ServiceError(SimulatorError):
    """A service could not be started, or reached, or the way to it is none that there is."""


class CampaignError(SimulatorError):
    """A campaign cannot be flown as asked, or its table not be written."""


class FilmError(SimulatorError):
    """A flight cannot be drawn into a video, or the video not be written."""


class FigureError(SimulatorError):
    """A figure cannot be drawn from what there is, or not be written."""


class HilError(SimulatorError):
    """An autopilot outside cannot be spoken with: a port, a protocol, or its silence."""


class PeerGoneError(HilError):
    """The autopilot outside has closed its connection, or died."""
