"""A recording in the TUM RGB-D layout: ``rgb.txt``, ``depth.txt``, ``groundtruth.txt``.

https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats: each line of the first two is
``timestamp filename``, of the last ``timestamp tx ty tz qx qy qz qw``, the pose of the colour
camera in the world. ``groundtruth.txt`` may be missing: then the drone does not know its pose.
Colour and depth are listed apart, may differ in number, and are paired by time, each once.
The camera file says what one unit of depth is: 1/5000 m in TUM's own recordings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from drone_client.errors import SourceError
from drone_client.pose_buffer import PoseBuffer
from drone_client.source import Capture, stride
from drone_client.source.pairing import pair_lists
from rgbd_wire.camera import RgbdCamera, load_camera
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose

MAX_PAIR_DISTANCE_NS: Final = 20_000_000
"""Colour and depth further apart in time than this are not of one exposure (TUM's associate.py)."""
MAX_LINES: Final = 1_000_000
MAX_LIST_BYTES: Final = 128 * 1024 * 1024
MAX_PICTURE_BYTES: Final = 64 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class _Pair:
    t_source_ns: int
    color: Path
    depth: Path | None


class ReplaySource:
    """A recording on disk; pictures are read one at a time.

    Raises:
        SourceError: the folder, a list or its first picture is missing or malformed; one line
            that says which file, which line and what was expected.
    """

    def __init__(self, folder: Path, camera: RgbdCamera) -> None:
        self.camera = camera
        if not folder.is_dir():
            raise SourceError(f"recording {folder}: no such folder")
        color = _read_list(folder, "rgb.txt")
        if not color:
            raise SourceError(f"{folder / 'rgb.txt'}: lists no picture")
        depth = _read_list(folder, "depth.txt") if (folder / "depth.txt").exists() else []
        self._pairs = _associate(color, depth)
        self._trajectory = _read_trajectory(folder / "groundtruth.txt")
        self._load(self._pairs[0])  # a wrong camera file shows here and not in mid-flight

    def __len__(self) -> int:
        return len(self._pairs)

    @property
    def notes(self) -> tuple[str, ...]:
        """Nothing: what cannot be read of such a recording ends it with an error."""
        return ()

    def captures(self) -> Iterator[Capture]:
        """The captures, oldest first."""
        return map(self._load, self._pairs)

    def some_captures(self, at_most: int) -> Iterator[Capture]:
        """So many of the captures, spread evenly; the others are not even read."""
        step = stride(len(self._pairs), at_most)
        return map(self._load, self._pairs[::step])

    def world_from_camera(self, t_source_ns: int) -> Pose | None:
        """Interpolated ground truth; None outside it."""
        return self._trajectory.at(t_source_ns)

    def _load(self, pair: _Pair) -> Capture:
        color = _read_picture(pair.color, cv2.IMREAD_COLOR_RGB)
        want = self.camera.color
        if color.shape[:2] != (want.height, want.width):
            raise SourceError(
                f"{pair.color} is {color.shape[1]}x{color.shape[0]}, "
                f"the camera file says {want.width}x{want.height}"
            )
        depth = None
        if pair.depth is not None:
            depth = _read_picture(pair.depth, cv2.IMREAD_UNCHANGED)
            if depth.dtype != np.uint16 or depth.ndim != 2:
                raise SourceError(f"{pair.depth}: depth must be a 16-bit grey PNG")
            want = self.camera.depth
            if depth.shape != (want.height, want.width):
                raise SourceError(
                    f"{pair.depth} is {depth.shape[1]}x{depth.shape[0]}, "
                    f"the camera file says {want.width}x{want.height} for depth"
                )
        return Capture(pair.t_source_ns, color, depth, pair.color.name)


def open_recording(folder: Path, camera: Path | None = None) -> ReplaySource:
    """A recording with its camera file; without one, ``camera.json`` of the folder.

    Raises:
        SourceError: as ``ReplaySource``.
        CameraFileError: the camera file is missing or wrong.
    """
    if not folder.is_dir():
        raise SourceError(f"recording {folder}: no such folder")
    if camera is None and not (folder / "camera.json").exists():
        raise SourceError(f"recording {folder}: holds no camera.json; name one with --camera")
    return ReplaySource(folder, load_camera(camera or folder / "camera.json"))


def _read_picture(path: Path, flags: int) -> NDArray[Any]:
    """A picture of at most ``MAX_PICTURE_BYTES``, decoded."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_PICTURE_BYTES + 1)
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from None
    picture = None
    if 0 < len(data) <= MAX_PICTURE_BYTES:
        try:
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:  # a header that claims more pixels than any camera has
            picture = None
    if picture is None:
        raise SourceError(f"{path}: no picture that can be read")
    return np.asarray(picture)


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Fields of each line that is neither empty nor a comment, with its number."""
    try:
        if path.stat().st_size > MAX_LIST_BYTES:
            raise SourceError(f"{path}: over {MAX_LIST_BYTES} bytes")
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                if number > MAX_LINES:
                    raise SourceError(f"{path}: over {MAX_LINES} lines")
                fields = line.split()
                if fields and not fields[0].startswith("#"):
                    yield number, fields
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SourceError(f"{path}: not a text file") from None


def _time_ns(where: str, text: str) -> int:
    """Seconds as text to integer nanoseconds, without a float's rounding on the way."""
    whole, _, fraction = text.partition(".")
    digits = (fraction + "000000000")[:9]
    if not (whole.isascii() and whole.isdigit() and digits.isascii() and digits.isdigit()):
        raise SourceError(f"{where}: {text!r} is not a time in seconds")
    if len(whole) > 10:
        raise SourceError(f"{where}: {text!r} is not a time that ends before the year 2286")
    return int(whole) * 1_000_000_000 + int(digits)


def _read_list(folder: Path, name: str) -> list[tuple[int, Path]]:
    path = folder / name
    entries: list[tuple[int, Path]] = []
    for number, fields in _lines(path):
        where = f"{path} line {number}"
        if len(fields) != 2:
            raise SourceError(f"{where}: expected 'timestamp filename', got {len(fields)} fields")
        t_ns = _time_ns(where, fields[0])
        if entries and t_ns <= entries[-1][0]:
            raise SourceError(f"{where}: time does not go forward")
        inside = Path(fields[1])
        if not fields[1].isprintable():
            raise SourceError(f"{where}: {fields[1]!r} is not a file name")
        if inside.is_absolute() or ".." in inside.parts:
            raise SourceError(f"{where}: {fields[1]} lies outside the recording")
        entries.append((t_ns, folder / inside))
    return entries


def _associate(color: list[tuple[int, Path]], depth: list[tuple[int, Path]]) -> list[_Pair]:
    """Each colour picture with its depth picture, by stamp and never by number."""
    partners = pair_lists([t for t, _ in color], [t for t, _ in depth], MAX_PAIR_DISTANCE_NS)
    return [
        _Pair(t_ns, file, None if j is None else depth[j][1])
        for (t_ns, file), j in zip(color, partners, strict=True)
    ]


def _read_trajectory(path: Path) -> PoseBuffer:
    poses: list[tuple[int, Pose]] = []
    if path.exists():
        for number, fields in _lines(path):
            where = f"{path} line {number}"
            if len(fields) != 8:
                raise SourceError(
                    f"{where}: expected 'timestamp tx ty tz qx qy qz qw', got {len(fields)} fields"
                )
            t_ns = _time_ns(where, fields[0])
            try:
                tx, ty, tz, qx, qy, qz, qw = map(float, fields[1:])
                pose = Pose(np.array([tx, ty, tz]), np.array([qw, qx, qy, qz]))
            except (ValueError, GeometryError) as error:
                raise SourceError(f"{where}: {error}") from None
            if poses and t_ns <= poses[-1][0]:
                raise SourceError(f"{where}: time does not go forward")
            poses.append((t_ns, pose))
    buffer = PoseBuffer(capacity=max(1, len(poses)))
    for t_ns, pose in poses:
        buffer.add(t_ns, pose)
    return buffer
