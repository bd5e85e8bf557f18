"""Files that have their name only when they are whole: half a file looks like a result."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

from drone_client.errors import OutputError


class WholeFile:
    """A file that is written beside its name, and gets it at the end.

    Raises:
        OutputError: it cannot be written, or is there already and may not go.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self.path = path
        self._part = part_of(path)
        self._overwrite = overwrite
        self._make_sure()
        try:
            self.file: io.FileIO = self._part.open("wb", buffering=0)
        except OSError as error:
            raise OutputError(f"{path}: {error.strerror}") from None

    def keep(self) -> None:
        """Give it its name.

        Raises:
            OutputError: the disk has not taken all of it; nothing is left of it then.
        """
        try:
            self.file.close()
            self._make_sure()
            self._part.replace(self.path)
        except OSError as error:
            raise OutputError(f"{self.path} could not be written: {error.strerror}") from None
        finally:
            self.discard()

    def discard(self) -> None:
        """Leave nothing of it; what has its name stays."""
        with contextlib.suppress(OSError):
            self.file.close()
        with contextlib.suppress(OSError):
            self._part.unlink(missing_ok=True)

    def _make_sure(self) -> None:
        if self.path.exists() and not self._overwrite:
            raise OutputError(f"{self.path} is there already: another name, or --overwrite")


def part_of(path: Path) -> Path:
    """What a file is called until it is whole; its suffix stays, by which libraries go."""
    return path.with_name(f".{path.stem}.part{path.suffix}")


def write_all(file: io.FileIO, data: bytes | bytearray) -> None:
    """Write all of it: a disk that is nearly full takes a part first.

    Raises:
        OSError: the disk does not take it.
    """
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def write_whole(path: Path, data: bytes) -> None:
    """Write a file at once, or leave what was there.

    Raises:
        OSError: it cannot be written; it names the file that was to be.
    """
    part = part_of(path)
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from None


def remove_if_empty(path: Path) -> None:
    """Take a file away that nothing came into: a disk was full."""
    with contextlib.suppress(OSError):
        if path.stat().st_size == 0:
            path.unlink()
