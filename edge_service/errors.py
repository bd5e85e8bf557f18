"""The errors of ``edge_service``.

::

    EdgeError
    ├── SelfCheckError a detector that does not find what it is there for
    ├── WeightsError   a weights file that cannot be read or does not fit the net
    ├── ImageError     a picture that the detector cannot take
    ├── SettingsError  an EDGE_ variable or a flag that cannot be used
    ├── AddressError   an address that cannot be listened on or connected to
    ├── InputError     a picture or camera that somebody handed in and that cannot be used
    └── OutputError    a file that cannot be written
"""

from __future__ import annotations


class EdgeError(Exception):
    """Root of this package's errors."""


class WeightsError(EdgeError):
    """A weights file is missing, damaged, foreign or of the wrong shape."""


class SelfCheckError(EdgeError):
    """The detector as it runs here does not find the target that it is there for."""


class ImageError(EdgeError):
    """An array is no colour image that the detector takes."""


class SettingsError(EdgeError):
    """A variable or flag is unknown, malformed or out of bounds."""


class AddressError(EdgeError):
    """An endpoint is malformed, taken or out of reach."""


class OutputError(EdgeError):
    """A file cannot be written where it should go."""


class InputError(EdgeError):
    """A picture or camera of a single request; ``field`` says which one is at fault."""

    def __init__(self, field: str, sentence: str) -> None:
        super().__init__(f"{field}: {sentence}")
        self.field = field
        self.sentence = sentence
