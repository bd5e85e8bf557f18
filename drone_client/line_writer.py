"""Lines on their way to files: whoever has one hands it over and goes on; one thread writes.

A disk takes its time when it likes. The control loop must never wait for one, nor for a thread that
does.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TextIO

MAX_WAITING: Final = 20_000
"""Lines on their way, some minutes of flight; what comes on top is lost, and counted."""

CLOSE_S: Final = 10.0
"""Time for the last lines at the end; a network disk may hang for good."""


class LineWriter:
    """Writes JSON lines to named files in a thread of its own, in order. Thread-safe.

    Every batch is flushed as soon as it is written, so that a killed client leaves files whose
    every line is whole.

    Raises:
        OSError: a file cannot be opened.
    """

    def __init__(self, paths: Mapping[str, Path]) -> None:
        self.lost = 0
        """Lines that the disk did not take, or that came faster than it took them."""
        self._files: dict[str, TextIO] = {}
        try:
            for name, path in paths.items():
                self._files[name] = path.open("w", encoding="utf-8")
        except OSError:
            self._close_files()
            raise
        self._waiting: deque[tuple[str, dict[str, Any]]] = deque()
        self._marks: list[tuple[int, threading.Event]] = []
        self._handed = self._written = 0
        self._lock = threading.Lock()
        self._closing = False
        self._some = threading.Event()
        self._thread = threading.Thread(target=self._run, name="line writer", daemon=True)
        self._thread.start()

    def put(self, name: str, line: dict[str, Any]) -> None:
        """Hand a line over, which nobody may change from now on; never blocks, never raises."""
        with self._lock:
            if self._closing or name not in self._files:
                return
            if len(self._waiting) >= MAX_WAITING:
                self.lost += 1
                return
            self._waiting.append((name, line))
            self._handed += 1
        self._some.set()

    def on_disk(self, timeout_s: float) -> bool:
        """Wait until all that was handed over so far is written, or lost and counted."""
        reached = threading.Event()
        with self._lock:
            if self._closing:
                return True
            self._marks.append((self._handed, reached))
        self._some.set()
        return reached.wait(timeout_s)

    def close(self) -> None:
        """Write what is left, and end; what a disk that hangs has not taken by then is lost."""
        with self._lock:
            self._closing = True
        self._some.set()
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self._lose(self._handed - self._written)

    def _run(self) -> None:
        while True:
            self._some.wait()
            self._some.clear()
            with self._lock:
                batch, self._waiting = self._waiting, deque()
                last = self._closing
            self._write(batch)
            self._written += len(batch)
            with self._lock:
                done = [mark for mark in self._marks if mark[0] <= self._written]
                self._marks = [mark for mark in self._marks if mark[0] > self._written]
            for _, reached in done:
                reached.set()
            if last:
                self._close_files()
                return

    def _write(self, batch: deque[tuple[str, dict[str, Any]]]) -> None:
        unsure: dict[str, int] = {}
        for name, line in batch:
            try:
                self._files[name].write(_json_line(line))
                unsure[name] = unsure.get(name, 0) + 1
            except (OSError, ValueError, TypeError):  # the disk, or what is no JSON
                self._lose(1)
        for name, count in unsure.items():
            try:
                self._files[name].flush()
            except OSError:
                self._lose(count)

    def _lose(self, count: int) -> None:
        with self._lock:
            self.lost += count

    def _close_files(self) -> None:
        for file in self._files.values():
            try:
                file.close()
            except OSError:
                self.lost += 1


def _json_line(line: dict[str, Any]) -> str:
    try:
        return json.dumps(line, allow_nan=False) + "\n"
    except ValueError:  # JSON knows no NaN; the frame keeps its line
        return json.dumps(_with_null_for_nan(line), allow_nan=False) + "\n"


def _with_null_for_nan(value: Any) -> Any:
    match value:
        case float():
            return value if math.isfinite(value) else None
        case dict():
            return {key: _with_null_for_nan(v) for key, v in value.items()}
        case list() | tuple():
            return [_with_null_for_nan(v) for v in value]
        case _:
            return value
