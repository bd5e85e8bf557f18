"""A run's folder as moments in the order of time: all of it, or what has been added to it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from drone_client.errors import OutputError
from drone_client.run_files import FACTS_NAME, LEDGER_NAME, list_pictures
from drone_client.viewing.facts import FlightFacts, load_facts
from drone_client.viewing.moments import READERS, Moment, Pictured
from rgbd_wire.errors import WireError

MAX_LINE_BYTES: Final = 1_000_000
CHUNK_BYTES: Final = 4_000_000


class RunFolder:
    """The files of one run, which may be under way."""

    def __init__(self, folder: Path) -> None:
        """Look at a folder.

        Raises:
            OutputError: no run is in it.
        """
        if not (folder / LEDGER_NAME).is_file():
            raise OutputError(f"{folder} holds no run: there is no {LEDGER_NAME} in it")
        self.folder = folder
        self.unread = 0
        """Lines that are none of a run, such as one that a full disk cut off."""
        self._tails = {name: _Tail(folder / name) for name in READERS}
        self._picture_ns = -1

    def facts(self) -> FlightFacts | None:
        """What is known of the drone; None: nothing, as of a replay.

        Raises:
            OutputError: its file is broken.
        """
        return load_facts(self.folder / FACTS_NAME)

    def grown(self) -> list[Moment]:
        """What was added since the last call, by time; at the first call all that there is.

        Raises:
            OutputError: a file cannot be read.
        """
        moments: list[Moment] = []
        for name, tail in self._tails.items():
            for text in tail.lines():
                moment = self._read(name, text)
                if moment is not None:
                    moments.append(moment)
        for path, t_ns in list_pictures(self.folder, self._picture_ns):
            moments.append(Pictured(t_ns, path))
            self._picture_ns = t_ns
        moments.sort(key=lambda moment: moment.t_ns)
        return moments

    def _read(self, name: str, text: bytes) -> Moment | None:
        try:
            line: Any = json.loads(text)
            return READERS[name](line)
        except (WireError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            self.unread += 1
            return None


class _Tail:
    """The whole lines at the end of a file that grows; it may not be there yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read_bytes = 0
        self._half = b""

    def lines(self) -> Iterator[bytes]:
        try:
            with self._path.open("rb") as file:
                file.seek(self._read_bytes)
                while chunk := file.read(CHUNK_BYTES):
                    self._read_bytes += len(chunk)
                    *whole, self._half = (self._half + chunk).split(b"\n")
                    yield from whole
                    if len(self._half) > MAX_LINE_BYTES:
                        raise OutputError(
                            f"{self._path}: a line of over {MAX_LINE_BYTES} bytes, as no run has"
                        )
        except FileNotFoundError:
            return
        except OSError as error:
            raise OutputError(f"{self._path}: {error.strerror}") from None
