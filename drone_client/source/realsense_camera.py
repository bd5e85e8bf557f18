"""What a RealSense says of its lenses, in our words.

Three traps. ``get_extrinsics_to`` of the depth stream, asked for the colour stream, maps points of
depth to colour: that is ``color_from_depth``. Its rotation comes column by column. And "modified
Brown-Conrady" is none of the models that we know unless its tangential part is zero.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from drone_client.errors import SourceError
from rgbd_wire.camera import CameraIntrinsics, DistortionModel, RgbdCamera
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose

LATTICE_STEPS: Final = 32
"""A D4xx measures disparity in 1/32 px: depth is fx x baseline x 32 / n (rgbd_wire/depth)."""
_NO_TANGENTIAL: Final = "modified_brown_conrady"
_MODELS: Final[dict[str, DistortionModel]] = {
    "none": "none",
    "brown_conrady": "brown_conrady",
    "inverse_brown_conrady": "inverse_brown_conrady",
}


def camera_of_profiles(
    color: Any, depth: Any, depth_scale_m: float, baseline_m: float
) -> RgbdCamera:
    """The rig of an opened colour and depth stream.

    Args:
        color: ``video_stream_profile`` of the colour stream.
        depth: the same of the raw depth stream.
        depth_scale_m: metres of one depth unit.
        baseline_m: between the two eyes of a stereo depth camera; 0: none, or unknown.

    Raises:
        SourceError: a lens model that we do not have, or numbers that no camera has.
    """
    try:
        depth_intrinsics = intrinsics_of(depth.get_intrinsics(), "depth")
        extrinsics = depth.get_extrinsics_to(color)
        rotation = np.array(extrinsics.rotation, dtype=np.float64).reshape(3, 3, order="F")
        # It comes in single precision, as orthogonal as that is
        color_from_depth = Pose.from_rotation(rotation, np.array(extrinsics.translation))
        if not np.allclose(color_from_depth.rotation, rotation, atol=1e-4):
            raise GeometryError("its extrinsics are no rotation")
        return RgbdCamera(
            intrinsics_of(color.get_intrinsics(), "colour"),
            depth_intrinsics,
            depth_scale_m,
            color_from_depth,
            depth_intrinsics.fx * baseline_m * LATTICE_STEPS,
        )
    except GeometryError as error:
        raise SourceError(f"the camera's own calibration cannot be: {error}") from None


def intrinsics_of(intrinsics: Any, stream: str) -> CameraIntrinsics:
    """``rs.intrinsics`` as ours.

    Raises:
        SourceError: a lens model that we do not have.
        GeometryError: numbers that no camera has.
    """
    k1, k2, p1, p2, k3 = (float(k) for k in intrinsics.coeffs)  # OpenCV's order, as ours
    name = str(intrinsics.model.name)
    if not any((k1, k2, p1, p2, k3)):
        model: DistortionModel = "none"
    elif name in _MODELS:
        model = _MODELS[name]
    elif name == _NO_TANGENTIAL and p1 == p2 == 0:
        model = "brown_conrady"
    else:
        raise SourceError(
            f"the {stream} camera's lens model {name} is not supported; known: "
            + ", ".join((*_MODELS, f"{_NO_TANGENTIAL} without a tangential part"))
        )
    return CameraIntrinsics(
        width=intrinsics.width,
        height=intrinsics.height,
        fx=intrinsics.fx,
        fy=intrinsics.fy,
        cx=intrinsics.ppx,
        cy=intrinsics.ppy,
        model=model,
        coefficients=(k1, k2, p1, p2, k3),
    )
