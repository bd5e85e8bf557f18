"""What can go wrong.

::

    EmulatorError
    +-- ImpairmentError     a link that cannot be, says which value and what would do
    +-- NotPermittedError   this needs root
    +-- ControlError        the relay is gone, or refused a command
"""

from __future__ import annotations


class EmulatorError(Exception):
    """The root of all errors of this package."""


class ImpairmentError(EmulatorError):
    """An impairment is out of bounds or does not go with another."""


class NotPermittedError(EmulatorError):
    """The kernel refuses; says what is missing."""


class ControlError(EmulatorError):
    """The relay does not answer, or refused what it was asked."""
