"""The camera's pictures of a flight as JPEG files, each named by the time of its exposure."""

from __future__ import annotations

import shutil
import threading
from collections import deque
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from drone_client.run_files import PICTURES_NAME, list_pictures
from drone_client.viewing.whole_file import write_whole

QUALITY: Final = 85
MAX_WAITING: Final = 4
"""Pictures on their way to the disk; one that comes on top is left out."""
MAX_BYTES: Final = 4_000_000_000
"""Of all pictures of a flight: over half an hour at 30 Hz."""
KEPT_BYTES: Final = 50_000_000
"""So much room on the disk is left to ledger and summary, which count more."""
CLOSE_S: Final = 5.0


class PictureWriter:
    """Writes pictures in a thread of its own, so that nobody waits for a disk."""

    def __init__(
        self, folder: Path, max_bytes: int = MAX_BYTES, kept_bytes: int = KEPT_BYTES
    ) -> None:
        """Make the folder; pictures of an earlier run in it go.

        Args:
            folder: of the run.
            max_bytes: of all pictures.
            kept_bytes: room that is left on the disk.

        Raises:
            OSError: it cannot be made.
        """
        self.written = self.left_out = 0
        self.problem: str | None = None
        """Why pictures were left out, the first time."""
        self._folder = folder / PICTURES_NAME
        self._folder.mkdir(exist_ok=True)
        for path, _ in list_pictures(folder):
            path.unlink()
        self._left_bytes = max_bytes
        self._kept_bytes = kept_bytes
        self._waiting: deque[tuple[int, NDArray[np.uint8]]] = deque()
        self._some = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="picture writer", daemon=True)
        self._thread.start()

    def put(self, t_ns: int, color_rgb: NDArray[np.uint8]) -> None:
        """Hand a picture over, which nobody may change from now on; never blocks, never raises."""
        with self._some:
            if self._closing or len(self._waiting) >= MAX_WAITING:
                self._leave_out("the disk or the processor is too slow for all of them")
                return
            self._waiting.append((t_ns, color_rgb))
            self._some.notify()

    def close(self) -> None:
        """Write what is left; what a disk that hangs has not taken by then is left out."""
        with self._some:
            self._closing = True
            self._some.notify()
        self._thread.join(CLOSE_S)

    def _run(self) -> None:
        while True:
            with self._some:
                self._some.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                t_ns, color_rgb = self._waiting.popleft()
            try:
                self._write(t_ns, color_rgb)
            except (OSError, cv2.error) as error:
                with self._some:
                    self._leave_out(getattr(error, "strerror", None) or str(error))

    def _write(self, t_ns: int, color_rgb: NDArray[np.uint8]) -> None:
        bgr = cv2.cvtColor(color_rgb, cv2.COLOR_RGB2BGR)
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        if data.nbytes > self._left_bytes:
            with self._some:
                self._leave_out("there are as many bytes of pictures as one flight may have")
            return
        if shutil.disk_usage(self._folder).free < self._kept_bytes:
            with self._some:
                self._leave_out("the disk has no more room than ledger and summary need")
            return
        # whoever follows the flight must not find half a picture
        write_whole(self._folder / f"{t_ns}.jpg", data.tobytes())
        self._left_bytes -= data.nbytes
        self.written += 1

    def _leave_out(self, why: str) -> None:
        self.left_out += 1
        self.problem = self.problem or why
