"""A live camera written down, to be replayed, calibrated from, or sent along with a bug report."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drone_client.errors import SourceError
from drone_client.source import LiveSource
from drone_client.source.recording_folder import RecordingFolder

LOOK_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class Recorded:
    """What became of a recording."""

    folder: Path
    frames: int
    with_depth: int
    left_out: int
    """Captures that came faster than they could be written."""
    seconds: float
    """From the first to the last capture."""
    ended_by: str
    """``time``, ``interrupt``, or what was wrong."""
    camera_counts: dict[str, int]


def record(
    source: LiveSource,
    out: Path,
    seconds: float | None = None,
    on_progress: Callable[[float, int], None] = lambda seconds, frames: None,
    stop: threading.Event | None = None,
) -> Recorded:
    """Start a camera and record until the time is over, an interrupt, or the camera's end.

    Args:
        source: not started yet; it is stopped in the end.
        out: the folder, which must not exist. It is ``OUT.part`` until it is whole.
        seconds: of recording; None: until an interrupt (Ctrl-C).
        on_progress: told after each look, with seconds and frames so far.
        stop: set by whoever wants the end, besides an interrupt.

    Raises:
        SourceError: the camera cannot be started, or gave not one picture.
        OutputError: the folder exists, or cannot be written.
    """
    folder = RecordingFolder(out)
    ended_by, times_ns = "time", [0, 0]
    try:
        source.start()
        began_s = time.monotonic()
        for capture in source.captures(LOOK_S):
            if capture is not None:
                folder.add(capture)
                times_ns = [times_ns[0] or capture.t_source_ns, capture.t_source_ns]
            so_far_s = time.monotonic() - began_s
            on_progress(so_far_s, folder.frames)
            if stop is not None and stop.is_set():
                ended_by = "interrupt"
                break
            if folder.failure is not None:
                ended_by = folder.failure
                break
            if seconds is not None and so_far_s >= seconds:
                break
    except KeyboardInterrupt:
        ended_by = "interrupt"
    except SourceError as error:
        if not folder.frames:
            folder.discard()
            raise
        ended_by = str(error)  # what came before it is worth having
    finally:
        counts = source.counts()
        source.stop()
    if not folder.frames:
        folder.discard()
        raise SourceError("the camera gave not one picture: nothing was recorded")
    frames = folder.finish(source.camera.to_json())
    return Recorded(
        folder=out,
        frames=frames,
        with_depth=folder.with_depth,
        left_out=folder.left_out,
        seconds=(times_ns[1] - times_ns[0]) / 1e9,
        ended_by=ended_by,
        camera_counts=counts,
    )
