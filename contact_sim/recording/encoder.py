"""Pictures into a video file that browsers play, by OpenCV's own FFmpeg.

OpenCV's wheel has neither x264 (GPL) nor an encoder for AV1, but libvpx: VP9 into .mp4, VP8 into
.webm. It gives no way to choose speed or bit rate, so that VP9 takes a third of a second a picture
and more, and VP8 less than a tenth.

It encodes in a process of its own (``python -m contact_sim.recording.encoder``): VP9 looks at 25
pictures ahead, which nobody can take from it again, and a process can be ended at once.
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from contact_sim.errors import FilmError
from drone_client.viewing.whole_file import part_of

CODECS: Final = {".mp4": "vp09", ".webm": "VP80"}
"""FourCC by suffix."""
READY, PICTURE, END = b"r", b"p", b"e"
LEAST_BYTES: Final = 1_000_000
"""With less room on the disk there is no use in going on."""
FULL: Final = "the disk is full"
BROKEN: Final = "it came out broken: is the disk full?"


class VideoFile:
    """Takes pictures in the order in which they are shown.

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
        self._part = part_of(path)
        self._shape = height, width, 3
        command = [sys.executable, "-m", "contact_sim.recording.encoder", str(self._part)]
        self._process = subprocess.Popen(
            [*command, str(width), str(height), str(rate_hz)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # FFmpeg talks straight to the terminal
            start_new_session=True,  # a Ctrl-C is ours to understand
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pictures: IO[bytes] = self._process.stdin
        self._words: IO[bytes] = self._process.stdout
        try:
            ready = self._words.read(1) == READY
        except BaseException:
            self._give_up()
            raise
        if not ready:
            self._give_up()
            raise FilmError(
                f"{path} cannot be written: no such folder, no room, or an OpenCV without libvpx"
            )

    def add(self, picture_rgb: NDArray[np.uint8]) -> None:
        """Take the next picture (height, width, 3).

        Raises:
            FilmError: encoding has failed.
        """
        assert picture_rgb.shape == self._shape
        try:
            self._pictures.write(PICTURE)
            self._pictures.write(np.ascontiguousarray(picture_rgb).data)
            self._pictures.flush()
        except OSError:
            raise FilmError(f"{self._path} could not be encoded: {self._why()}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if error is None:
                self._finish()
        finally:
            self._give_up()

    def _finish(self) -> None:
        with contextlib.suppress(OSError):  # why it has gone is told below
            self._pictures.write(END)
            self._pictures.close()
        why = self._why()
        if self._process.returncode != 0:
            raise FilmError(f"{self._path}: {why}")
        try:
            self._part.replace(self._path)
        except OSError as error:
            raise FilmError(f"{self._path}: {error.strerror}") from None

    def _why(self) -> str:
        """The encoder's last words, once it has ended."""
        words = self._words.read().decode(errors="replace").strip()
        self._process.wait()
        return words or f"the encoder has ended ({self._process.returncode})"

    def _give_up(self) -> None:
        """End the encoder, and leave nothing that has not its name; nothing more if all is done."""
        self._process.kill()
        self._process.wait()
        self._words.close()
        with contextlib.suppress(OSError):
            self._pictures.close()
        with contextlib.suppress(OSError):
            self._part.unlink(missing_ok=True)


def encode(
    path: Path, width: int, height: int, rate_hz: float, pictures: IO[bytes], words: IO[bytes]
) -> int:
    """Encode what comes in, until it says that this was all; returns an exit code.

    Whoever sends the pictures may die: then this ends, too, and leaves nothing.
    """
    writer = cv2.VideoWriter(
        str(path),
        cv2.CAP_FFMPEG,
        cv2.VideoWriter.fourcc(*CODECS[path.suffix]),
        rate_hz,
        (width, height),
    )
    if not writer.isOpened():
        return 1
    words.write(READY)
    words.flush()
    frames = 0
    while (kind := pictures.read(1)) == PICTURE:
        data = pictures.read(3 * width * height)
        if len(data) < 3 * width * height:
            break
        if shutil.disk_usage(path.parent).free < LEAST_BYTES:
            path.unlink(missing_ok=True)
            words.write(FULL.encode())
            return 1
        picture = np.frombuffer(data, dtype=np.uint8).reshape(height, width, 3)
        writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        frames += 1
    if kind != END:
        path.unlink(missing_ok=True)
        return 1
    writer.release()
    if not _last_frame(path, frames):
        words.write(BROKEN.encode())
        return 1
    return 0


def _last_frame(path: Path, frames: int) -> bool:
    """Whether a video's last picture can be read: OpenCV tells of no full disk."""
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        counted = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        if abs(counted - frames) > 1:
            return False
        video.set(cv2.CAP_PROP_POS_FRAMES, max(0, frames - 1))
        return bool(video.read()[0])
    finally:
        video.release()


def main() -> None:
    """``PART WIDTH HEIGHT RATE``; pictures from standard input."""
    part, width, height, rate_hz = sys.argv[1:]
    words = sys.stdout.buffer
    try:
        code = encode(Path(part), int(width), int(height), float(rate_hz), sys.stdin.buffer, words)
    except (cv2.error, OSError, MemoryError) as error:
        words.write(" ".join(str(error).split()).encode())
        code = 1
    words.flush()
    sys.exit(code)


if __name__ == "__main__":
    main()
