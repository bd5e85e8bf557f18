"""The errors of ``rgbd_wire``.

::

    WireError
    ├── GeometryError     a transform or camera that cannot be one
    ├── CameraFileError   a camera JSON that cannot be read
    ├── TlsFilesError     a certificate or key that cannot be used
    └── DecodeError       bytes that are not a message of ours; carries a ``Reject`` reason
"""

from __future__ import annotations

from enum import StrEnum


class WireError(Exception):
    """Root of this package's errors."""


class GeometryError(WireError):
    """A transform or a camera model with impossible numbers."""


class CameraFileError(WireError):
    """A camera JSON is missing, malformed or out of bounds."""


class TlsFilesError(WireError):
    """A certificate or key is missing, unreadable, expired, or does not fit the others."""


class Reject(StrEnum):
    """Why bytes from the network were refused; each is counted under this name."""

    TRUNCATED = "truncated"
    OVERSIZED = "oversized"
    WRONG_MAGIC = "wrong_magic"
    WRONG_VERSION = "wrong_version"
    WRONG_KIND = "wrong_kind"
    WRONG_SIZE = "wrong_size"
    CHECKSUM = "checksum"
    BAD_HEADER = "bad_header"
    BAD_COLOR = "bad_color"
    BAD_DEPTH = "bad_depth"
    BAD_POSE = "bad_pose"


class DecodeError(WireError):
    """Bytes that are not a valid message; raised before anything large is allocated."""

    def __init__(self, reason: Reject, detail: str) -> None:
        super().__init__(f"{reason.value}: {detail}")
        self.reason = reason
        self.detail = detail
