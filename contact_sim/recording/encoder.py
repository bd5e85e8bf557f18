"""Pictures into a video file that browsers play, by OpenCV's own FFmpeg.

OpenCV's wheel has neither x264 (GPL) nor an encoder for AV1, but libvpx: VP9 into .mp4, VP8 into
.webm. It gives no way to choose speed or bit rate, so that VP9 takes a third of a second a picture
and more, and VP8 less than a tenth.
"""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from contact_sim.errors import FilmError

CODECS: Final = {".mp4": "vp09", ".webm": "VP80"}
"""FourCC by suffix."""
WAITING: Final = 8
"""Pictures between drawing and encoding, which share the cores."""


class VideoFile:
    """Takes pictures in the order in which they are shown; encodes in a thread of its own.

    It is written under another name until it is whole.
    """

    def __init__(self, path: Path, width: int, height: int, rate_hz: float) -> None:
        """Open the file.

        Raises:
            FilmError: the suffix is none of ``CODECS``, or it cannot be written.
        """
        if path.suffix not in CODECS:
            raise FilmError(f"{path}: a film is called {' or '.join(CODECS)}")
        self._path = path
        self._part = path.with_name(f".{path.stem}.part{path.suffix}")
        self._size = width, height
        self._frames = 0
        codec = cv2.VideoWriter.fourcc(*CODECS[path.suffix])
        with _quiet():
            self._writer = cv2.VideoWriter(
                str(self._part), cv2.CAP_FFMPEG, codec, rate_hz, (width, height)
            )
        if not self._writer.isOpened():
            raise FilmError(
                f"{path} cannot be written: no such folder, no room, or an OpenCV without libvpx"
            )
        self._queue: queue.Queue[NDArray[np.uint8] | None] = queue.Queue(WAITING)
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="video encoder", daemon=True)
        self._thread.start()

    def add(self, picture_rgb: NDArray[np.uint8]) -> None:
        """Take the next picture (height, width, 3); it may not be changed from now on.

        Raises:
            FilmError: encoding has failed.
        """
        self._check()
        self._frames += 1
        self._queue.put(picture_rgb)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._queue.put(None)
        self._thread.join()
        self._writer.release()
        if error is not None:
            self._part.unlink(missing_ok=True)
            return
        self._finish()

    def _finish(self) -> None:
        """OpenCV tells of no full disk: the file is read again, to its last picture."""
        try:
            self._check()
            readable = _last_frame(self._part, self._frames)
            if not readable:
                raise FilmError(f"{self._path} came out broken: is the disk full?")
            self._part.replace(self._path)
        except OSError as error:
            raise FilmError(f"{self._path}: {error.strerror}") from None
        finally:
            self._part.unlink(missing_ok=True)

    def _check(self) -> None:
        if self._failure is not None:
            raise FilmError(f"{self._path} could not be encoded: {self._failure}")

    def _run(self) -> None:
        while (picture := self._queue.get()) is not None:
            if self._failure is None:
                try:
                    self._writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
                except cv2.error as error:
                    self._failure = error


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV prints straight to the terminal that .webm has no code for VP8, and then does it."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _last_frame(path: Path, frames: int) -> bool:
    """Whether a video's last picture can be read."""
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        counted = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        if abs(counted - frames) > 1:
            return False
        video.set(cv2.CAP_PROP_POS_FRAMES, max(0, frames - 1))
        return bool(video.read()[0])
    finally:
        video.release()
