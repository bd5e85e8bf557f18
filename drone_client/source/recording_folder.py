"""A recording while it is written: pictures by threads of their own, lists at the end."""

from __future__ import annotations

import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import cv2
from numpy.typing import NDArray

from drone_client.errors import OutputError
from drone_client.source import Capture

WRITERS: Final = 2
MAX_WAITING: Final = 16
"""Captures that wait for a writer; half a second at 30 Hz."""


class RecordingFolder:
    """``OUT.part`` in the TUM RGB-D layout, which becomes ``OUT`` in the end.

    A capture that there is no room for is left out and counted: ``add`` never waits. One thread
    adds.

    Raises:
        OutputError: one of the two exists, or cannot be made.
    """

    def __init__(self, out: Path) -> None:
        self.left_out = 0
        self.failure: str | None = None
        """The first thing that could not be written."""
        self._out = out
        self._part = out.with_name(out.name + ".part")
        self._taken: list[str] = []
        self._done: dict[str, bool] = {}
        """By stamp: whether it has depth."""
        self._last_ns = -1
        self._room = threading.BoundedSemaphore(MAX_WAITING)
        if out.exists():
            raise OutputError(f"{out} exists; a recording gets a folder of its own")
        try:
            for name in ("rgb", "depth"):
                (self._part / name).mkdir(parents=True)
        except FileExistsError:
            raise OutputError(
                f"{self._part} is left of a recording that was cut off; remove it"
            ) from None
        except OSError as error:
            raise OutputError(f"{self._part}: {error.strerror}") from None
        self._writers = ThreadPoolExecutor(WRITERS, "record")

    @property
    def frames(self) -> int:
        """Captures that were taken; all of them written once it is finished."""
        return len(self._taken)

    @property
    def with_depth(self) -> int:
        """Captures that were written with depth."""
        return sum(self._done.values())

    def add(self, capture: Capture) -> None:
        """Take a capture, or leave it out."""
        if capture.t_source_ns <= self._last_ns or not self._room.acquire(blocking=False):
            self.left_out += 1
            return
        self._last_ns = capture.t_source_ns
        seconds, ns = divmod(capture.t_source_ns, 1_000_000_000)
        stamp = f"{seconds}.{ns:09d}"
        self._taken.append(stamp)
        self._writers.submit(self._write, stamp, capture)

    def finish(self, camera: dict[str, Any]) -> int:
        """Wait for the writers, write the lists and the camera file, and rename.

        Args:
            camera: the camera JSON.

        Returns:
            Captures that are in the recording.

        Raises:
            OutputError: the lists cannot be written, or not one picture could.
        """
        self._writers.shutdown()
        stamps = [stamp for stamp in self._taken if stamp in self._done]
        if not stamps:
            raise OutputError(f"{self._part}: {self.failure or 'nothing was recorded'}")
        depths = [stamp for stamp in stamps if self._done[stamp]]
        try:
            for name, of in (("rgb", stamps), ("depth", depths)):
                lines = ["# timestamp filename", *(f"{s} {name}/{s}.png" for s in of)]
                self._text(f"{name}.txt", "\n".join(lines) + "\n")
            self._text("camera.json", json.dumps(camera, indent=2) + "\n")
            os.replace(self._part, self._out)
        except OSError as error:
            raise OutputError(f"{self._part}: {error.strerror}; the pictures are there") from None
        return len(stamps)

    def discard(self) -> None:
        """Nothing was recorded: leave nothing behind."""
        self._writers.shutdown()
        with suppress(OSError):  # not empty after all
            for path in (self._part / "rgb", self._part / "depth", self._part):
                path.rmdir()

    def _write(self, stamp: str, capture: Capture) -> None:
        try:
            bgr = cv2.cvtColor(capture.color_rgb, cv2.COLOR_RGB2BGR)
            self._picture(f"rgb/{stamp}.png", bgr)
            if capture.depth_units is not None:
                self._picture(f"depth/{stamp}.png", capture.depth_units)
            self._done[stamp] = capture.depth_units is not None
        except (OSError, cv2.error) as error:
            self.failure = self.failure or str(error)
        finally:
            self._room.release()

    def _picture(self, name: str, picture: NDArray[Any]) -> None:
        # OpenCV's own setting is the quickest: 13 ms for 640x480 colours, 21 ms at level 1
        ok, data = cv2.imencode(".png", picture)
        if not ok:
            raise OSError(f"{name} cannot be compressed")
        (self._part / name).write_bytes(data.tobytes())

    def _text(self, name: str, text: str) -> None:
        (self._part / name).write_text(text, encoding="utf-8")
