"""The errors of ``drone_client``.

::

    ClientError          ends a command with one line that says what, where and what to do
    ├── SourceError      a recording or camera that cannot give frames
    ├── LinkError        an address that cannot be one, or nobody there
    ├── AutopilotError   an address that cannot be one, or a line that cannot be opened
    ├── AirframeError    an airframe file that cannot be read
    ├── TuningError      a tuning file that cannot be read, or holds a value that may not be
    ├── WorldError       a simulated flight that cannot be: no simulator, world, link or service
    └── OutputError      a folder that cannot take the run's files
"""

from __future__ import annotations


class ClientError(Exception):
    """Root of this package's errors; the command line prints it as one line."""


class SourceError(ClientError):
    """A recording is missing, malformed or holds no frame."""


class LinkError(ClientError):
    """An endpoint is malformed, or no worker answers there."""


class AutopilotError(ClientError):
    """An autopilot's address is malformed, its line cannot be opened, or nobody answers there."""


class AirframeError(ClientError):
    """An airframe file is missing or malformed."""


class TuningError(ClientError):
    """A tuning file is missing or malformed, or a value in it is out of its bounds."""


class WorldError(ClientError):
    """A simulated flight that cannot be: no simulator, no such world or link, no service."""


class OutputError(ClientError):
    """The run's folder cannot be written."""
