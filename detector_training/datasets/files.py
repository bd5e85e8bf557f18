"""Files below a folder: sorted, bounded, the same on every machine."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NoReturn

from detector_training.errors import DatasetError

MAX_FILES = 1_000_000
PART = ".part"
"""Ends the name of what is not finished yet."""


def walk(folder: Path, suffixes: Collection[str]) -> Iterator[Path]:
    """Files whose suffix in small letters is one of ``suffixes``, nested folders included.

    Hidden and unfinished folders are passed over; links to folders are followed, each folder once.

    Raises:
        DatasetError: there are more than ``MAX_FILES``, or a folder cannot be listed.
    """
    seen = 0
    visited: set[tuple[int, int]] = set()

    def refuse(error: OSError) -> NoReturn:
        raise DatasetError(f"{error.filename}: {error.strerror}") from None

    for root, folders, files in os.walk(folder, onerror=refuse, followlinks=True):
        try:
            place = os.stat(root)
        except OSError as error:  # gone meanwhile
            refuse(error)
        if (place.st_dev, place.st_ino) in visited:  # links may lead in a circle
            folders.clear()
            continue
        visited.add((place.st_dev, place.st_ino))
        folders[:] = sorted(f for f in folders if not f.startswith(".") and not f.endswith(PART))
        seen += len(files)
        if seen > MAX_FILES:
            raise DatasetError(f"{folder} holds over {MAX_FILES} files; give a folder of its own")
        for name in sorted(files):
            if not name.startswith(".") and os.path.splitext(name)[1].lower() in suffixes:
                yield Path(root, name)


def inside(root: Path, path: Path) -> bool:
    """Whether ``path`` stays below ``root`` when its ``..`` are followed, on paper."""
    top, normal = os.path.abspath(root), os.path.abspath(path)
    return normal == top or normal.startswith(top.rstrip(os.sep) + os.sep)


def is_file(path: Path) -> bool:
    """Whether a file lies there; a name that no file can have is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or with a NUL
        return False
