"""What a RealSense says of its lenses, in our words.

Three traps. ``get_extrinsics_to`` of the depth stream, asked for the colour stream, maps points of
depth to colour: that is ``color_from_depth``. Its rotation comes column by column. And the names of
the lens models are not to be trusted: what the SDK calls "inverse Brown-Conrady" (a D4xx's colour)
it projects just as "modified Brown-Conrady", from ideal points to seen ones, and deprojects by
inverting that. It is OpenCV's model but for products of small terms, and the opposite of what
the name and our ``inverse_brown_conrady`` say: up to 10 px apart in a D455's pictures. So the name
is not asked: the five numbers are taken as OpenCV's, and compared with what the SDK makes of them.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from drone_client.errors import SourceError
from rgbd_wire.camera import CameraIntrinsics, DistortionModel, RgbdCamera
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose
from target_pose.lens import project

LATTICE_STEPS: Final = 32
"""A D4xx measures disparity in 1/32 px: depth is fx x baseline x 32 / n (rgbd_wire/depth)."""
MAX_LENS_ERROR_PX: Final = 0.1
"""Between the SDK's projection and ours, anywhere in the picture; far below what we see."""
_GRID: Final = 9
"""Points along each side, at which the two are compared."""


def camera_of_profiles(
    sdk: Any, color: Any, depth: Any, depth_scale_m: float, baseline_m: float
) -> RgbdCamera:
    """The rig of an opened colour and depth stream.

    Args:
        sdk: ``pyrealsense2``.
        color: ``video_stream_profile`` of the colour stream.
        depth: the same of the raw depth stream.
        depth_scale_m: metres of one depth unit.
        baseline_m: between the two eyes of a stereo depth camera; 0: none, or unknown.

    Raises:
        SourceError: a lens model that we do not have, or numbers that no camera has.
    """
    try:
        depth_intrinsics = intrinsics_of(sdk, depth.get_intrinsics(), "depth")
        extrinsics = depth.get_extrinsics_to(color)
        rotation = np.array(extrinsics.rotation, dtype=np.float64).reshape(3, 3, order="F")
        # It comes in single precision, as orthogonal as that is
        color_from_depth = Pose.from_rotation(rotation, np.array(extrinsics.translation))
        if not np.allclose(color_from_depth.rotation, rotation, atol=1e-4):
            raise GeometryError("its extrinsics are no rotation")
        return RgbdCamera(
            intrinsics_of(sdk, color.get_intrinsics(), "colour"),
            depth_intrinsics,
            depth_scale_m,
            color_from_depth,
            depth_intrinsics.fx * baseline_m * LATTICE_STEPS,
        )
    except GeometryError as error:
        raise SourceError(f"the camera's own calibration cannot be: {error}") from None


def intrinsics_of(sdk: Any, intrinsics: Any, stream: str) -> CameraIntrinsics:
    """``rs.intrinsics`` as ours.

    Raises:
        SourceError: a lens that the SDK projects otherwise than we can.
        GeometryError: numbers that no camera has.
    """
    k1, k2, p1, p2, k3 = (float(k) for k in intrinsics.coeffs)  # OpenCV's order, as ours
    model: DistortionModel = "brown_conrady" if any((k1, k2, p1, p2, k3)) else "none"
    ours = CameraIntrinsics(
        width=intrinsics.width,
        height=intrinsics.height,
        fx=intrinsics.fx,
        fy=intrinsics.fy,
        cx=intrinsics.ppx,
        cy=intrinsics.ppy,
        model=model,
        coefficients=(k1, k2, p1, p2, k3),
    )
    error_px = _lens_error_px(sdk, intrinsics, ours)
    if not error_px <= MAX_LENS_ERROR_PX:
        raise SourceError(
            f"the {stream} camera's lens model {intrinsics.model.name} is not supported: its five "
            f"numbers taken as OpenCV's are {error_px:.1f} px off; give a camera file of your own"
        )
    return ours


def _lens_error_px(sdk: Any, intrinsics: Any, ours: CameraIntrinsics) -> float:
    """How far the SDK's projection and ours are apart at most, over the picture."""
    u, v = np.meshgrid(
        np.linspace(0, ours.width - 1, _GRID), np.linspace(0, ours.height - 1, _GRID)
    )
    x, y = (u.ravel() - ours.cx) / ours.fx, (v.ravel() - ours.cy) / ours.fy
    points = np.column_stack([x, y, np.ones_like(x)])
    theirs = [sdk.rs2_project_point_to_pixel(intrinsics, list(map(float, p))) for p in points]
    return float(np.abs(project(points, ours) - np.array(theirs)).max())
