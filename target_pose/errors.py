"""The errors of ``target_pose``.

::

    TargetError
    └── TargetFileError   a target TOML that cannot be read
"""

from __future__ import annotations


class TargetError(Exception):
    """Root of this package's errors."""


class TargetFileError(TargetError):
    """A target TOML is missing, malformed or describes no target."""
