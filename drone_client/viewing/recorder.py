"""What a flight's viewers need besides the ledger, written down while it is flown.

It stands between camera and client as a camera itself: whatever goes wrong here costs lines and
pictures, never the flight.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from drone_client.autopilot import VehicleState
from drone_client.line_writer import LineWriter
from drone_client.run_files import FACTS_NAME, POSES_NAME
from drone_client.source import Capture, LiveSource
from drone_client.viewing.facts import FlightFacts
from drone_client.viewing.live import Address, LiveView
from drone_client.viewing.pictures import PictureWriter
from drone_client.viewing.whole_file import remove_if_empty, write_whole
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.messages import pose_numbers

POSE_S: Final = 1 / 30
JOIN_S: Final = 2.0


class FlightRecorder:
    """A ``LiveSource`` that lets another's captures through."""

    def __init__(
        self,
        source: LiveSource,
        state: Callable[[], VehicleState | None],
        folder: Path,
        facts: Callable[[RgbdCamera], FlightFacts],
        *,
        pictures: bool,
        live: Address | None = None,
    ) -> None:
        """Take a camera over; nothing is written before ``start``.

        Args:
            source: the camera.
            state: the vehicle's newest.
            folder: of the run, which the ledger has made by the time of ``start``.
            facts: what is known of the flight once its camera is.
            pictures: write the camera's pictures, too.
            live: address to serve the flight at while it is flown.
        """
        self._source = source
        self._state = state
        self._folder = folder
        self._facts = facts
        self._wants_pictures = pictures
        self._live = None if live is None else LiveView(folder, live)
        self._lines: LineWriter | None = None
        self._pictures: PictureWriter | None = None
        self._problems: list[str] = []
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pose recorder", daemon=True)

    @property
    def camera(self) -> RgbdCamera:
        """The rig."""
        return self._source.camera

    def start(self) -> None:
        """Open the camera, then the files; a disk that takes none is a line in ``report``.

        Raises:
            SourceError: of the camera's own.
        """
        self._source.start()
        self._try(self._write_facts)
        if self._wants_pictures:
            self._try(self._open_pictures)
        self._try(self._open_poses)
        if self._lines is not None:
            self._thread.start()
        if self._live is not None:
            self._live.start()

    def captures(self, timeout_s: float) -> Iterator[Capture | None]:
        """The camera's captures.

        Raises:
            SourceError: of the camera's own.
        """
        for capture in self._source.captures(timeout_s):
            if capture is not None and self._pictures is not None:
                self._pictures.put(capture.t_source_ns, capture.color_rgb)
            yield capture

    def counts(self) -> dict[str, int]:
        """The camera's."""
        return self._source.counts()

    def stop(self) -> None:
        """Stop the camera, which may take as long as it likes; the files are ``close``'s."""
        self._source.stop()

    def close(self) -> None:
        """Close the files, end the live view: what a slow disk has not taken in time is lost."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)
        if self._lines is not None:
            self._lines.close()
            if self._lines.lost:
                remove_if_empty(self._folder / POSES_NAME)
        if self._pictures is not None:
            self._pictures.close()
        if self._live is not None:
            self._live.close()

    def report(self) -> dict[str, Any]:
        """What was written, and what was not; whatever comes from now on is not written."""
        self.close()
        problems = list(self._problems)
        lines, pictures, live = self._lines, self._pictures, self._live
        if lines is not None and lines.lost:
            problems.append(f"{lines.lost} lines of {POSES_NAME}")
        if pictures is not None and pictures.left_out:
            problems.append(f"{pictures.left_out} pictures: {pictures.problem}")
        if live is not None and live.problem is not None:
            problems.append(live.problem)
        return {"pictures": 0 if pictures is None else pictures.written, "unwritten": problems}

    def _try(self, job: Callable[[], None]) -> None:
        """A disk that does not take one thing may take the next."""
        try:
            job()
        except OSError as error:
            self._problems.append(f"{error.filename or self._folder}: {error.strerror}")

    def _write_facts(self) -> None:
        facts = json.dumps(self._facts(self._source.camera).to_json(), indent=2)
        write_whole(self._folder / FACTS_NAME, f"{facts}\n".encode())

    def _open_pictures(self) -> None:
        self._pictures = PictureWriter(self._folder)

    def _open_poses(self) -> None:
        self._lines = LineWriter({POSES_NAME: self._folder / POSES_NAME})

    def _run(self) -> None:
        lines, seen_ns = self._lines, None
        assert lines is not None
        while not self._stopping.wait(POSE_S):
            state = self._state()
            if state is None or state.world_from_body is None or state.t_pose_ns == seen_ns:
                continue
            seen_ns, velocity = state.t_pose_ns, state.velocity_world
            lines.put(
                POSES_NAME,
                {
                    "t_ns": seen_ns,
                    "world_from_body": [round(v, 6) for v in pose_numbers(state.world_from_body)],
                    "velocity_mps": None
                    if velocity is None
                    else [round(v, 4) for v in velocity.tolist()],
                    "mode": state.mode,
                    "obeying": state.obeying,
                    "resets": state.pose_resets,
                },
            )
