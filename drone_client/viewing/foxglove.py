"""A flight in Foxglove's schemas: into an MCAP file, or live to whoever connects.

Topics: ``/tf``, ``/camera/image``, ``/camera/calibration``, ``/camera/found``, ``/drone``,
``/target``, ``/scene``, ``/log``, and as JSON ``/control``, ``/frames``, ``/truth``. Stamps are
the drone's monotonic clock.
"""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any, Final

import foxglove
import numpy as np
from foxglove import channels
from foxglove import messages as fg
from numpy.typing import NDArray

from drone_client.errors import OutputError
from drone_client.viewing.facts import FlightFacts
from drone_client.viewing.moments import (
    Level,
    Line,
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
    Rgb,
    board_outlines,
    drone_outlines,
    funnel_outlines,
)
from drone_client.viewing.overlay import caption, marks
from drone_client.viewing.viewer import answer_numbers, tick_numbers
from drone_client.viewing.way import Way
from drone_client.viewing.whole_file import WholeFile, write_all
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose

SCENE_NS: Final = 1_000_000_000
"""How often what stands still is told again, for who comes later."""
LINE_M: Final = 0.006
WAY: Final[Rgb] = (1.0, 0.75, 0.2)
TRUE: Final[Rgb] = (0.75, 0.75, 0.75)
_NUMBER, _TEXT = {"type": ["number", "null"]}, {"type": ["string", "null"]}


def _schema(title: str, numbers: tuple[str, ...], texts: tuple[str, ...]) -> dict[str, Any]:
    fields = dict.fromkeys(numbers, _NUMBER) | dict.fromkeys(texts, _TEXT)
    return {"title": title, "type": "object", "properties": {"t_ns": {"type": "integer"}} | fields}


_CONTROL = _schema(
    "aerial.ControlTick",
    (
        *("h_m", "h_robust_m", "delta_m", "target_age_ms", "yaw_rate_radps"),
        *(f"tip_target_{a}_m" for a in "xyz"),
        *(f"command_{a}_mps" for a in "xyz"),
    ),
    ("phase", "known", "freshness", "status", "target_source"),
)
_FRAME = _schema(
    "aerial.Frame",
    ("network_delay_ms", "age_ms", "service_ms", "d1_ms", "d2_ms", "bytes", "tau_max_ms"),
    ("verdict", "outcome", "worker", "method"),
)
_TRUTH = _schema("aerial.Truth", ("tip_force_n", "arm_m", "drift_m"), ())


class FoxgloveViewer:
    """Moments -> messages of one context, which has a file or a server behind it."""

    def __init__(self, context: foxglove.Context, facts: FlightFacts | None) -> None:
        self._context = context  # its channels close with it
        self._facts = facts
        self._scene_due_ns = -SCENE_NS
        self._way, self._true_way = Way(), Way()
        self._has_target = False
        self._tf = channels.FrameTransformsChannel("/tf", context=context)
        self._image = channels.CompressedImageChannel("/camera/image", context=context)
        self._calibration = channels.CameraCalibrationChannel(
            "/camera/calibration", context=context
        )
        self._found = channels.ImageAnnotationsChannel("/camera/found", context=context)
        self._drone = channels.PoseInFrameChannel("/drone", context=context)
        self._target = channels.PoseInFrameChannel("/target", context=context)
        self._scene = channels.SceneUpdateChannel("/scene", context=context)
        self._log = channels.LogChannel("/log", context=context)
        self._control = foxglove.Channel("/control", schema=_CONTROL, context=context)
        self._frames = foxglove.Channel("/frames", schema=_FRAME, context=context)
        self._truth = foxglove.Channel("/truth", schema=_TRUTH, context=context)

    def show(self, moment: Moment) -> None:
        """Write one down."""
        t_ns = moment.t_ns
        match moment:
            case Moved():
                self._show_moved(moment)
            case Pictured():
                with contextlib.suppress(OSError):  # it went while we came
                    data = moment.path.read_bytes()
                    image = fg.CompressedImage(
                        timestamp=_stamp(t_ns), frame_id="camera", data=data, format="jpeg"
                    )
                    self._image.log(image, log_time=t_ns)
            case Settled():
                self._show_settled(moment)
            case Ticked():
                self._control.log(_tick_json(moment), log_time=t_ns)
            case Said():
                level = fg.LogLevel.Info if moment.level is Level.INFO else fg.LogLevel.Warning
                message = fg.Log(
                    timestamp=_stamp(t_ns), level=level, message=moment.sentence, name="drone"
                )
                self._log.log(message, log_time=t_ns)
            case Truly():
                self._show_truth(moment)
        if t_ns - self._scene_due_ns >= SCENE_NS:
            self._scene_due_ns = t_ns
            self._show_standing(t_ns)

    def close(self) -> None:
        """Nothing: the file or server is its owner's."""

    def _show_moved(self, moment: Moved) -> None:
        t_ns = moment.t_ns
        self._way.add(moment.world_from_body.translation)
        transforms = [_transform(t_ns, "world", "drone", moment.world_from_body)]
        if self._facts is not None:
            transforms += [
                _transform(t_ns, "drone", "camera", self._facts.body_from_camera),
                _transform(t_ns, "drone", "tip", self._facts.body_from_tip),
            ]
        self._tf.log(fg.FrameTransforms(transforms=transforms), log_time=t_ns)
        self._drone.log(_pose_in("world", t_ns, moment.world_from_body), log_time=t_ns)

    def _show_settled(self, moment: Settled) -> None:
        t_ns, facts = moment.t_ns, self._facts
        numbers = answer_numbers(moment)
        texts = {k: moment.line.get(k) for k in ("outcome", "worker", "method")}
        tau = {} if facts is None else {"tau_max_ms": facts.tau_max_ms}
        self._frames.log(
            {"t_ns": t_ns, **numbers, **tau, "verdict": moment.verdict, **texts}, log_time=t_ns
        )
        if facts is not None:
            self._found.log(_annotations(moment, facts), log_time=t_ns)
        seen, place = moment.camera_from_target, moment.world_from_target
        if not moment.accepted or place is None or seen is None:
            return
        self._has_target = True
        transforms = [_transform(t_ns, "world", "target", place)]
        if facts is None:  # a replay: where it was is known when it saw the target
            transforms.append(_transform(t_ns, "world", "camera", place @ seen.inverse()))
        self._tf.log(fg.FrameTransforms(transforms=transforms), log_time=t_ns)
        self._target.log(_pose_in("world", t_ns, place), log_time=t_ns)

    def _show_truth(self, moment: Truly) -> None:
        t_ns = moment.t_ns
        self._true_way.add(moment.world_from_body.translation)
        transforms = [
            _transform(t_ns, "world", "true drone", moment.world_from_body),
            _transform(t_ns, "world", "true target", moment.world_from_target),
        ]
        self._tf.log(fg.FrameTransforms(transforms=transforms), log_time=t_ns)
        told = {k: moment.line.get(k) for k in ("tip_force_n", "arm_m", "drift_m")}
        self._truth.log({"t_ns": t_ns, **told}, log_time=t_ns)

    def _show_standing(self, t_ns: int) -> None:
        """The shapes, which move with their frames, and the ways so far."""
        facts, entities = self._facts, []
        if facts is not None:
            entities.append(_entity(t_ns, "drone", "drone", drone_outlines(facts)))
            self._calibration.log(_calibration(t_ns, facts.camera.color), log_time=t_ns)
            if self._has_target:
                entities.append(_entity(t_ns, "target", "board", board_outlines(facts)))
                entities.append(_entity(t_ns, "target", "funnel", funnel_outlines(facts)))
        for name, way, color in (("way", self._way, WAY), ("true way", self._true_way, TRUE)):
            if len(points := way.points()) > 1:
                entities.append(_entity(t_ns, "world", name, [Outline(points, color)]))
        if entities:
            self._scene.log(fg.SceneUpdate(entities=entities), log_time=t_ns)


class McapFile:
    """A ``Viewer`` that is an MCAP file.

    Raises:
        OutputError: it cannot be written, or is there already and may not go.
    """

    def __init__(self, path: Path, facts: FlightFacts | None, *, overwrite: bool = False) -> None:
        context = foxglove.Context()
        self._whole = WholeFile(path, overwrite=overwrite)
        self._file = _DeafFile(self._whole.file)
        try:
            self._writer = foxglove.open_mcap(self._file, context=context)
        except RuntimeError as error:
            self._whole.discard()
            raise OutputError(f"{path}: {_why(error)}") from None
        self._viewer = FoxgloveViewer(context, facts)

    def show(self, moment: Moment) -> None:
        """Write one down.

        Raises:
            OutputError: the disk does not take it.
        """
        self._viewer.show(moment)
        self._file.check(self._whole.path)

    def close(self) -> None:
        """Finish the file.

        Raises:
            OutputError: it is not whole; nothing is left of it.
        """
        try:
            self._writer.close()
            self._file.check(self._whole.path)
        except OutputError:
            self._whole.discard()
            raise
        except Exception as error:  # the library has a class of its own, and exports it not
            self._whole.discard()
            raise OutputError(f"{self._whole.path} is not whole: {_why(error)}") from None
        self._whole.keep()

    def discard(self) -> None:
        """Give the file up; nothing is left of it."""
        self._file.stop()
        with contextlib.suppress(Exception):  # as in close
            self._writer.close()
        self._whole.discard()


class _DeafFile:
    """Takes all that the library writes, and keeps a disk's complaint for whoever asks.

    The library would log it, with a traceback, at every message from then on.
    """

    def __init__(self, file: io.FileIO) -> None:
        self._file: io.FileIO | None = file
        self._error: OSError | None = None
        self._at = self._end = 0

    def write(self, data: bytes | bytearray) -> int:
        if self._file is not None:
            try:
                write_all(self._file, data)
            except OSError as error:
                self._error, self._file = error, None
        self._at += len(data)
        self._end = max(self._end, self._at)
        return len(data)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._end}[whence]
        self._at = start + offset
        if self._file is not None:
            self._file.seek(self._at)
        return self._at

    def flush(self) -> None:
        """Nothing is held back."""

    def stop(self) -> None:
        """Write nothing more."""
        self._file = None

    def check(self, path: Path) -> None:
        if self._error is not None:
            raise OutputError(f"{path} is not whole: {_why(self._error)}")


class LiveServer:
    """A ``Viewer`` that Foxglove connects to.

    Raises:
        OutputError: the address is taken.
    """

    def __init__(self, host: str, port: int, facts: FlightFacts | None) -> None:
        context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="drone-client", host=host, port=port, context=context
            )
        except (OSError, RuntimeError) as error:
            raise OutputError(f"--foxglove {host}:{port}: {_why(error)}") from None
        self.port = self._server.port
        self._viewer = FoxgloveViewer(context, facts)

    def show(self, moment: Moment) -> None:
        """Send one to all who are connected."""
        self._viewer.show(moment)

    def close(self) -> None:
        """Let them go."""
        self._server.stop()


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _stamp(t_ns: int) -> fg.Timestamp:
    sec, nsec = divmod(t_ns, 1_000_000_000)
    return fg.Timestamp(sec, nsec)


def _vector(v: NDArray[np.float64]) -> fg.Vector3:
    x, y, z = v.tolist()
    return fg.Vector3(x=x, y=y, z=z)


def _quaternion(pose: Pose) -> fg.Quaternion:
    w, x, y, z = pose.q_wxyz.tolist()
    return fg.Quaternion(x=x, y=y, z=z, w=w)


def _transform(t_ns: int, parent: str, child: str, parent_from_child: Pose) -> fg.FrameTransform:
    return fg.FrameTransform(
        timestamp=_stamp(t_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=_vector(parent_from_child.translation),
        rotation=_quaternion(parent_from_child),
    )


def _pose_in(frame: str, t_ns: int, pose: Pose) -> fg.PoseInFrame:
    place = fg.Pose(position=_vector(pose.translation), orientation=_quaternion(pose))
    return fg.PoseInFrame(timestamp=_stamp(t_ns), frame_id=frame, pose=place)


def _color(rgb: Rgb) -> fg.Color:
    r, g, b = rgb
    return fg.Color(r=r, g=g, b=b, a=1.0)


def _entity(t_ns: int, frame: str, name: str, outlines: list[Outline]) -> fg.SceneEntity:
    lines = [
        fg.LinePrimitive(
            type=fg.LinePrimitiveLineType.LineStrip,
            thickness=LINE_M,
            points=[fg.Point3(x=x, y=y, z=z) for x, y, z in outline.points.tolist()],
            color=_color(outline.color),
        )
        for outline in outlines
    ]
    return fg.SceneEntity(
        timestamp=_stamp(t_ns), frame_id=frame, id=name, frame_locked=True, lines=lines
    )


def _annotations(moment: Settled, facts: FlightFacts) -> fg.ImageAnnotations:
    """Stamped as the picture that it lies over; also empty, to take the last one away."""
    stamp = _stamp(moment.t_capture_ns)
    points = [
        fg.PointsAnnotation(
            timestamp=stamp,
            type=fg.PointsAnnotationType.LineStrip,
            points=[fg.Point2(x=x, y=y) for x, y in mark.points_px.tolist()],
            outline_color=_color(mark.color),
            thickness=2.0,
        )
        for mark in marks(moment, facts)
    ]
    text = fg.TextAnnotation(
        timestamp=stamp,
        position=fg.Point2(x=8.0, y=20.0),
        text=caption(moment),
        font_size=14.0,
        text_color=fg.Color(r=1.0, g=1.0, b=1.0, a=1.0),
        background_color=fg.Color(r=0.0, g=0.0, b=0.0, a=0.6),
    )
    return fg.ImageAnnotations(timestamp=stamp, points=points, texts=[text])


def _calibration(t_ns: int, camera: CameraIntrinsics) -> fg.CameraCalibration:
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    # only this model tells seen points of ideal ones, as Foxglove's does
    lens = list(camera.coefficients) if camera.model == "brown_conrady" else []
    return fg.CameraCalibration(
        timestamp=_stamp(t_ns),
        frame_id="camera",
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob" if lens else "",
        D=lens,
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def _tick_json(tick: Ticked) -> Line:
    names = ("phase", "known", "freshness", "status", "target_source")
    texts = {name: tick.line.get(name) for name in names}
    return {"t_ns": tick.t_ns, **tick_numbers(tick), **texts}
