"""Pinhole intrinsics and the RGB-D rig: what a camera JSON says, bounded and checked."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.errors import CameraFileError, GeometryError
from rgbd_wire.geometry import Pose

MAX_SIDE_PX = 4096
MAX_PIXELS = 8_388_608
MAX_RIG_M = 10.0
"""How far apart two cameras that are bolted together may be."""

DistortionModel: TypeAlias = Literal["none", "brown_conrady", "inverse_brown_conrady"]
"""RealSense's names: the model maps ideal to seen points, its inverse seen to ideal points."""


@dataclass(frozen=True, slots=True)
class CameraIntrinsics:
    """A pinhole camera with an optional lens model; pixel (0, 0) is the centre of the first pixel.

    Raises:
        GeometryError: a size or a number is out of bounds.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: DistortionModel = "none"
    coefficients: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 (OpenCV's order)."""

    def __post_init__(self) -> None:
        if not (0 < self.width <= MAX_SIDE_PX and 0 < self.height <= MAX_SIDE_PX):
            raise GeometryError(
                f"an image side is 1 to {MAX_SIDE_PX} px, not {self.width}x{self.height}"
            )
        if self.width * self.height > MAX_PIXELS:
            raise GeometryError(f"{self.width}x{self.height} is over {MAX_PIXELS} pixels")
        # 0.1 to 100 image widths: from a fisheye to a telescope
        side = max(self.width, self.height)
        for name, f in (("fx", self.fx), ("fy", self.fy)):
            if not (math.isfinite(f) and 0.1 * side <= f <= 100 * side):
                raise GeometryError(f"{name} = {f} px does not fit an image {side} px wide")
        for name, c, size in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if not (math.isfinite(c) and -size <= c <= 2 * size):
                raise GeometryError(f"{name} = {c} px lies far outside an image of {size} px")
        if self.model not in get_args(DistortionModel):
            raise GeometryError(
                f"distortion model {self.model!r} is not one of {get_args(DistortionModel)}"
            )
        if len(self.coefficients) != 5 or not all(
            math.isfinite(k) and abs(k) <= 100 for k in self.coefficients
        ):
            raise GeometryError(f"distortion takes five finite numbers, not {self.coefficients}")

    @property
    def image_from_camera(self) -> NDArray[np.float64]:
        """K, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class RgbdCamera:
    """A colour and a depth camera that are bolted together."""

    color: CameraIntrinsics
    depth: CameraIntrinsics
    depth_scale_m: float
    """Metres of one depth unit; 0 units mean "no depth here"."""
    color_from_depth: Pose
    depth_lattice_m: float = 0.0
    """A of raw stereo depth ``round(A / n / depth_scale_m)``: fx x baseline x 32 [m]; 0: unknown,
    aligned or another kind of sensor, sent without rank coding (docs/protocol.md)."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.depth_scale_m) and 1e-5 <= self.depth_scale_m <= 0.1):
            raise GeometryError(f"depth_scale_m = {self.depth_scale_m} is not in [1e-5, 0.1]")
        if not (math.isfinite(self.depth_lattice_m) and 0 <= self.depth_lattice_m <= 1e5):
            raise GeometryError(f"depth_lattice_m = {self.depth_lattice_m} is not in [0, 1e5]")
        apart_m = float(np.abs(self.color_from_depth.translation).max())
        if apart_m > MAX_RIG_M:
            raise GeometryError(f"color_from_depth spans {apart_m:g} m, at most {MAX_RIG_M:g}")

    @property
    def aligned(self) -> bool:
        """Depth already lies on the colour pixels."""
        c = self.color_from_depth
        still = not c.translation.any() and not c.q_wxyz[1:].any()
        return still and self.depth == self.color

    def to_json(self) -> dict[str, Any]:
        """The camera JSON that ``load_camera`` reads."""

        def intrinsics(i: CameraIntrinsics) -> dict[str, Any]:
            d: dict[str, Any] = {k: getattr(i, k) for k in _INTRINSICS_KEYS}
            if i.model != "none":
                d |= {"model": i.model, "coefficients": list(i.coefficients)}
            return d

        return {
            "color": intrinsics(self.color),
            "depth": intrinsics(self.depth),
            "depth_scale_m": self.depth_scale_m,
            "depth_lattice_m": self.depth_lattice_m,
            "color_from_depth": {
                "translation_m": self.color_from_depth.translation.tolist(),
                "q_wxyz": self.color_from_depth.q_wxyz.tolist(),
            },
        }


_INTRINSICS_KEYS = ("width", "height", "fx", "fy", "cx", "cy")
_INTRINSICS_OPTIONAL = ("model", "coefficients")
_CAMERA_KEYS = ("color", "depth", "depth_scale_m", "depth_lattice_m", "color_from_depth")
MAX_CAMERA_JSON_BYTES = 65_536
_MAX_NUMBER = 1e9


def camera_from_json(text: str | bytes) -> RgbdCamera:
    """Read a camera JSON.

    Only ``color`` and ``depth_scale_m`` are required; without ``depth`` and ``color_from_depth``
    the depth image is taken as aligned to the colour image.

    Raises:
        CameraFileError: with the field at fault and what it may be.
    """
    if len(text) > MAX_CAMERA_JSON_BYTES:
        raise CameraFileError(f"over {MAX_CAMERA_JSON_BYTES} bytes")
    try:
        raw = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CameraFileError(f"not JSON: {error}") from None
    _check_keys("camera", raw, ("color", "depth_scale_m"), _CAMERA_KEYS)
    try:
        color = _intrinsics("color", raw["color"])
        depth = _intrinsics("depth", raw["depth"]) if "depth" in raw else color
        if ("depth" in raw) != ("color_from_depth" in raw):
            raise CameraFileError("depth and color_from_depth belong together: give both or none")
        pose = Pose.identity()
        if "color_from_depth" in raw:
            pose = _pose("color_from_depth", raw["color_from_depth"])
        return RgbdCamera(
            color,
            depth,
            _number("depth_scale_m", raw["depth_scale_m"]),
            pose,
            _number("depth_lattice_m", raw.get("depth_lattice_m", 0.0)),
        )
    except GeometryError as error:
        raise CameraFileError(str(error)) from None


def load_camera(path: Path) -> RgbdCamera:
    """Read a camera JSON from a file.

    Raises:
        CameraFileError: with the path, the field at fault and what it may be.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MAX_CAMERA_JSON_BYTES + 1)
    except OSError as error:
        raise CameraFileError(f"camera file {path}: {error.strerror}") from None
    try:
        return camera_from_json(text)
    except CameraFileError as error:
        raise CameraFileError(f"camera file {path}: {error}") from None


def _check_keys(
    where: str, raw: object, required: tuple[str, ...], known: tuple[str, ...] | None = None
) -> None:
    if not isinstance(raw, dict):
        raise CameraFileError(f"{where} must be an object with {', '.join(required)}")
    if missing := [k for k in required if k not in raw]:
        raise CameraFileError(f"{where} lacks {', '.join(missing)}")
    if unknown := [k for k in raw if k not in (known or required)]:
        raise CameraFileError(
            f"{where} has unknown {_shown(unknown[0])}; known: {', '.join(known or required)}"
        )


def _shown(value: object) -> str:
    """A value from a stranger's file, short and on one line."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _number(name: str, value: Any) -> float:
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    if not (plain and abs(value) <= _MAX_NUMBER):  # false for NaN too
        raise CameraFileError(f"{name} must be a finite number, not {_shown(value)}")
    return float(value)


def _numbers(name: str, value: object, count: int) -> list[float]:
    if not isinstance(value, list) or len(value) != count:
        raise CameraFileError(f"{name} must be a list of {count} numbers, not {_shown(value)}")
    return [_number(name, v) for v in value]


def _side(name: str, value: object) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and 0 < value <= MAX_SIDE_PX:
        return value
    raise CameraFileError(
        f"{name} must be a whole number from 1 to {MAX_SIDE_PX}, not {_shown(value)}"
    )


def _pose(where: str, raw: dict[str, Any]) -> Pose:
    _check_keys(where, raw, ("translation_m", "q_wxyz"))
    t = _numbers(f"{where}.translation_m", raw["translation_m"], 3)
    q = _numbers(f"{where}.q_wxyz", raw["q_wxyz"], 4)
    try:
        return Pose(np.array(t), np.array(q))
    except GeometryError as error:
        raise CameraFileError(f"{where}: {error}") from None


def _intrinsics(where: str, raw: dict[str, Any]) -> CameraIntrinsics:
    _check_keys(where, raw, _INTRINSICS_KEYS, _INTRINSICS_KEYS + _INTRINSICS_OPTIONAL)
    fx, fy, cx, cy = (_number(f"{where}.{k}", raw[k]) for k in ("fx", "fy", "cx", "cy"))
    ks = _numbers(f"{where}.coefficients", raw.get("coefficients", [0.0] * 5), 5)
    model = raw.get("model", "none")
    if model not in get_args(DistortionModel):
        raise CameraFileError(
            f"{where}.model must be one of {', '.join(get_args(DistortionModel))}, "
            f"not {_shown(model)}"
        )
    try:
        return CameraIntrinsics(
            _side(f"{where}.width", raw["width"]),
            _side(f"{where}.height", raw["height"]),
            fx,
            fy,
            cx,
            cy,
            model=model,
            coefficients=(ks[0], ks[1], ks[2], ks[3], ks[4]),
        )
    except GeometryError as error:
        raise CameraFileError(f"{where}: {error}") from None
