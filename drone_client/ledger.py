"""The ledger: one JSON line for each captured frame, whatever became of it.

A line is written as soon as the frame's fate is known (``line_writer``), so that a killed client
leaves a ledger whose every line is whole. The frames that nobody answered are in it as well: what
is missing tells as much as what came.
"""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from drone_client.errors import OutputError
from drone_client.line_writer import LineWriter
from drone_client.run_files import (
    EVENTS_NAME,
    LEDGER_NAME,
    ONBOARD_NAME,
    TICKS_NAME,
    check_earlier,
    clear_earlier,
)


class Fate(StrEnum):
    """What became of a captured frame; exactly one holds for each."""

    ANSWERED = "answered"
    """A result came; its verdict says whether it could be used."""
    SUPERSEDED_ON_BOARD = "superseded_on_board"
    """A newer frame came before this one could be sent."""
    SEND_FAILED = "send_failed"
    """It could not be encoded or handed to the link; the log has the details."""
    TOO_OLD_ON_BOARD = "too_old_on_board"
    """By the time it could leave, no answer could have come within age_max."""
    NO_WORKER = "no_worker"
    NO_REPLY = "no_reply"
    INTERRUPTED = "interrupted"
    """The run ended while it was under way."""


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """What is known of a frame before its fate is."""

    sequence: int
    name: str
    t_capture_ns: int
    """Drone's clock, as t1."""
    t1_ns: int | None = None
    worker: str | None = None
    size_bytes: int | None = None
    encoding: dict[str, Any] | None = None
    """How it was coded, and why so."""


class Ledger:
    """Writes ``ledger.jsonl`` and beside it events, control ticks, and looks on board. Thread-safe.

    A disk that fills up in flight costs lines, never the flight: they are counted in
    ``lost_lines``.

    Raises:
        OutputError: the folder cannot be made or written at the start, or holds an earlier run,
            which is evidence and goes only when ``overwrite`` says so.
    """

    def __init__(self, folder: Path, *, overwrite: bool = False, own_eyes: bool = False) -> None:
        self.fates: Counter[Fate] = Counter()
        self.settled = threading.Event()
        """Set whenever a frame's fate becomes known; lockstep playback waits for it."""
        self._lock = threading.Lock()
        self._open: dict[int, FrameEntry] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            check_earlier(folder, overwrite=overwrite)
            names = [LEDGER_NAME, EVENTS_NAME, TICKS_NAME]
            if own_eyes:
                names.append(ONBOARD_NAME)
            if overwrite:
                clear_earlier(folder)
            self._writer = LineWriter({name: folder / name for name in names})
        except FileExistsError:
            raise OutputError(f"folder {folder}: there is a file of that name") from None
        except OSError as error:
            raise OutputError(f"folder {folder}: {error.strerror}") from None

    def captured(self, entry: FrameEntry) -> None:
        """A frame exists; it will get one line."""
        with self._lock:
            self._open[entry.sequence] = entry

    def sent(
        self,
        sequence: int,
        t1_ns: int,
        worker: str,
        size_bytes: int,
        encoding: dict[str, Any] | None = None,
    ) -> None:
        """It was handed to the link."""
        with self._lock:
            if (entry := self._open.get(sequence)) is not None:
                self._open[sequence] = replace(
                    entry,
                    t1_ns=t1_ns,
                    worker=worker,
                    size_bytes=size_bytes,
                    encoding=encoding,
                )

    def close_frame(self, sequence: int, fate: Fate, details: dict[str, Any]) -> bool:
        """Write the frame's line; False if it has one already."""
        with self._lock:
            entry = self._open.pop(sequence, None)
            if entry is None:
                return False
            self._write_frame(entry, fate, details)
            return True

    def close_unanswered(self, sent_before_ns: int, details: dict[str, Any]) -> int:
        """Give up on frames sent before a time; returns how many."""
        with self._lock:
            late = [
                e for e in self._open.values() if e.t1_ns is not None and e.t1_ns < sent_before_ns
            ]
            for entry in late:
                del self._open[entry.sequence]
                self._write_frame(entry, Fate.NO_REPLY, details)
            return len(late)

    @property
    def lost_lines(self) -> int:
        """Lines that the disk did not take."""
        return self._writer.lost

    @property
    def under_way(self) -> int:
        """Frames without a line yet."""
        with self._lock:
            return len(self._open)

    def event(self, t_ns: int, event: str, **details: Any) -> None:
        """Something that happened to the run, not to a frame."""
        self._writer.put(EVENTS_NAME, {"t_ns": t_ns, "event": event, **details})

    def tick(self, line: dict[str, Any]) -> None:
        """One control tick."""
        self._writer.put(TICKS_NAME, line)

    def look(self, line: dict[str, Any]) -> None:
        """One frame that the drone looked at, or would have, by itself."""
        self._writer.put(ONBOARD_NAME, line)

    def on_disk(self, timeout_s: float = 5.0) -> bool:
        """Wait until every line so far is written; for whoever reads the files of a running one."""
        return self._writer.on_disk(timeout_s)

    def close(self) -> None:
        """Give every open frame its line, and close the files."""
        with self._lock:
            for entry in self._open.values():
                self._write_frame(entry, Fate.INTERRUPTED, {})
            self._open.clear()
        self._writer.close()

    def _write_frame(self, entry: FrameEntry, fate: Fate, details: dict[str, Any]) -> None:
        self.fates[fate] += 1
        line = {
            "sequence": entry.sequence,
            "name": entry.name,
            "fate": fate.value,
            "worker": entry.worker,
            "bytes": entry.size_bytes,
            "encoding": entry.encoding,
            "t_capture_ns": entry.t_capture_ns,
            "t1_ns": entry.t1_ns,
        }
        self._writer.put(LEDGER_NAME, line | details)
        self.settled.set()
