"""A drawing as a file: checked before the work starts, whole or not there."""

from __future__ import annotations

import os
from pathlib import Path

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from edge_service.errors import OutputError

JPEG_SUFFIXES = (".jpg", ".jpeg")
SUFFIXES = (".png", *JPEG_SUFFIXES)
JPEG_QUALITY = 92
PNG_LEVEL = 3


def check_drawing_path(path: Path) -> None:
    """Tell before anything is computed whether a drawing could be written there.

    Raises:
        OutputError: the name's ending is none of ``SUFFIXES``, or the folder cannot take it.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"--draw {path}: must end in {', '.join(SUFFIXES)}")
    if path.is_dir():
        raise OutputError(f"--draw {path}: is a folder")
    if not path.parent.is_dir():
        raise OutputError(f"--draw {path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise OutputError(f"--draw {path}: the folder {path.parent} cannot be written to")


def write_drawing(path: Path, sheet_rgb: NDArray[np.uint8]) -> None:
    """Write a sheet (H, W, 3).

    Raises:
        OutputError: it cannot be written; nothing half-written stays.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(encoded(sheet_rgb, path.suffix.lower()))
        os.replace(part, path)
    except OSError as error:
        raise OutputError(f"--draw {path}: {error.strerror or error}") from None
    finally:
        part.unlink(missing_ok=True)


def encoded(sheet_rgb: NDArray[np.uint8], suffix: str = ".png") -> bytes:
    """A sheet (H, W, 3) in the format of one of ``SUFFIXES``."""
    if suffix in JPEG_SUFFIXES:
        return bytes(imagecodecs.jpeg8_encode(sheet_rgb, level=JPEG_QUALITY))
    return bytes(imagecodecs.png_encode(sheet_rgb, level=PNG_LEVEL))
