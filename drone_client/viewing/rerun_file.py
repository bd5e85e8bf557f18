"""A flight as a Rerun recording.

The tree of entities is the tree of frames: ``world/drone/camera``, ``world/target``; beside it
``control``, ``link``, ``truth`` with their numbers, and ``log``. The time line is ``drone_time``,
the drone's monotonic clock.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from drone_client.errors import OutputError
from drone_client.viewing.facts import FlightFacts
from drone_client.viewing.moments import (
    Level,
    Moment,
    Moved,
    Pictured,
    Said,
    Settled,
    Ticked,
    Truly,
)
from drone_client.viewing.outlines import (
    Outline,
    board_outlines,
    drone_outlines,
    funnel_outlines,
)
from drone_client.viewing.overlay import caption, marks
from drone_client.viewing.viewer import answer_numbers, tick_numbers
from drone_client.viewing.way import Way
from drone_client.viewing.whole_file import WholeFile, write_all
from rgbd_wire.geometry import Pose

TIMELINE: Final = "drone_time"
BATCH: Final = 200
"""Moments between two writes to the disk."""
FLUSH_S: Final = 60.0
WAY_NS: Final = 500_000_000
"""How often the way so far is drawn anew."""
LINE_M: Final = 0.003
WAY_COLOR: Final = (255, 190, 50)
TRUE_COLOR: Final = (190, 190, 190)
IMAGE: Final = "world/drone/camera/image"


class RerunFile:
    """A ``Viewer`` that is an .rrd file.

    Raises:
        OutputError: it cannot be written, or is there already and may not go.
    """

    def __init__(self, path: Path, facts: FlightFacts | None, *, overwrite: bool = False) -> None:
        self._facts = facts
        self._way, self._true_way = Way(), Way()
        self._way_due_ns = 0
        self._unwritten = 0
        self._whole = WholeFile(path, overwrite=overwrite)
        self._stream = rr.RecordingStream("aerial-contact")
        rr.set_log_time_enabled(False, self._stream)  # when it was written down is nobody's time
        # Through our hands: the library, where a disk is full, waits for ever
        self._bytes = rr.binary_stream(self._stream)
        self._stream.send_blueprint(_blueprint())
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if facts is not None:
            self._log_standing(facts)

    def show(self, moment: Moment) -> None:
        """Write one down.

        Raises:
            OutputError: the disk does not take it.
        """
        self._at(moment.t_ns)
        match moment:
            case Moved():
                self._log("world/drone", _transform(moment.world_from_body))
                self._way.add(moment.world_from_body.translation)
                self._log_ways(moment.t_ns)
            case Pictured():
                if moment.path.is_file():
                    self._log(IMAGE, rr.EncodedImage(path=moment.path))
            case Settled():
                self._show_settled(moment)
            case Ticked():
                for name, value in tick_numbers(moment).items():
                    self._log(f"control/{name}", rr.Scalars(value))
            case Said():
                level = "INFO" if moment.level is Level.INFO else "WARN"
                self._log("log", rr.TextLog(moment.sentence, level=level))
            case Truly():
                self._show_truth(moment)
        self._unwritten += 1
        if self._unwritten >= BATCH:
            self._unwritten = 0
            self._write(self._bytes.read(flush=False))

    def close(self) -> None:
        """Finish the file.

        Raises:
            OutputError: it is not whole; nothing is left of it.
        """
        try:
            self._write(self._bytes.read(flush=True, flush_timeout_sec=FLUSH_S))
        except OutputError:
            self.discard()
            raise
        self._stream.disconnect()
        self._whole.keep()

    def discard(self) -> None:
        """Give the file up; nothing is left of it."""
        self._stream.disconnect()
        self._whole.discard()

    def _write(self, data: bytes | None) -> None:
        try:
            write_all(self._whole.file, data or b"")
        except OSError as error:
            raise OutputError(f"{self._whole.path} is not whole: {error.strerror}") from None

    def _show_settled(self, moment: Settled) -> None:
        for name, value in answer_numbers(moment).items():
            self._log(f"link/{name}", rr.Scalars(value))
        seen, place = moment.camera_from_target, moment.world_from_target
        if moment.accepted and place is not None and seen is not None:
            self._log("world/target", _transform(place))
            if self._facts is None:  # a replay: where it was is known when it saw the target
                self._log("world/drone/camera", _transform(place @ seen.inverse()))
        if self._facts is not None:
            # over the picture that it was found in
            self._at(moment.t_capture_ns)
            lines = marks(moment, self._facts)
            self._log(
                f"{IMAGE}/found",
                rr.LineStrips2D(
                    [mark.points_px for mark in lines],
                    colors=[_rgb(mark.color) for mark in lines],
                    radii=1.0,
                ),
            )
            self._log(f"{IMAGE}/verdict", rr.TextLog(caption(moment)))

    def _show_truth(self, moment: Truly) -> None:
        self._log("truth/tip_force_n", rr.Scalars(moment.tip_force_n))
        self._log("truth/arm_m", rr.Scalars(moment.arm_m))
        self._log("world/true_target", _transform(moment.world_from_target))
        self._log("world/true_drone", _transform(moment.world_from_body))
        self._true_way.add(moment.world_from_body.translation)

    def _log_ways(self, t_ns: int) -> None:
        if t_ns < self._way_due_ns:
            return
        self._way_due_ns = t_ns + WAY_NS
        for name, way, color in (
            ("world/way", self._way, WAY_COLOR),
            ("world/true_way", self._true_way, TRUE_COLOR),
        ):
            if len(points := way.points()) > 1:
                self._log(name, rr.LineStrips3D([points], colors=[color], radii=LINE_M))

    def _log_standing(self, facts: FlightFacts) -> None:
        camera = facts.camera.color
        self._log("world/drone/camera", _transform(facts.body_from_camera), static=True)
        self._log(
            IMAGE,
            rr.Pinhole(
                image_from_camera=camera.image_from_camera,
                resolution=[camera.width, camera.height],
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.4,
            ),
            static=True,
        )
        self._log_shape("world/drone/shape", drone_outlines(facts))
        self._log_shape("world/target/board", board_outlines(facts))
        self._log_shape("world/target/funnel", funnel_outlines(facts))

    def _log_shape(self, entity: str, outlines: list[Outline]) -> None:
        strips = rr.LineStrips3D(
            [outline.points for outline in outlines],
            colors=[_rgb(outline.color) for outline in outlines],
            radii=LINE_M,
        )
        self._log(entity, strips, static=True)

    def _at(self, t_ns: int) -> None:
        self._stream.set_time(TIMELINE, duration=np.timedelta64(t_ns, "ns"))

    def _log(self, entity: str, value: Any, *, static: bool = False) -> None:
        self._stream.log(entity, value, static=static)


def _transform(parent_from_child: Pose) -> Any:
    w, x, y, z = parent_from_child.q_wxyz.tolist()
    return rr.Transform3D(
        translation=parent_from_child.translation, quaternion=rr.Quaternion(xyzw=[x, y, z, w])
    )


def _rgb(color: tuple[float, float, float]) -> list[int]:
    return [round(255 * c) for c in color]


def _blueprint() -> Any:
    """The windows that open at first: the world, the picture, what was decided, what was said."""
    barrier = rrb.TimeSeriesView(
        name="h [m]", contents=["control/h_m", "control/h_robust_m"], origin="/"
    )
    link = rrb.TimeSeriesView(
        name="d1 + d2, age [ms]", contents=["link/network_delay_ms", "link/age_ms"], origin="/"
    )
    touch = rrb.TimeSeriesView(
        name="tip [m], force [N]",
        contents=["control/tip_target_x_m", "truth/tip_force_n"],
        origin="/",
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial3DView(name="world", origin="world"),
                rrb.Spatial2DView(name="camera", origin=IMAGE),
                rrb.TextLogView(name="log", origin="log"),
                column_shares=[3, 3, 2],
            ),
            rrb.Horizontal(barrier, link, touch),
            row_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
    )
