"""sensor_msgs/CameraInfo as our intrinsics.

``plumb_bob`` is OpenCV's model and our ``brown_conrady``: ideal points to seen ones. A rectified
picture (``image_rect...``) has no lens left and is described by P, any other one by K and D.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rgbd_wire.camera import CameraIntrinsics, DistortionModel
from rgbd_wire.errors import GeometryError

_PLUMB_BOB = "plumb_bob"
_RATIONAL = "rational_polynomial"


def intrinsics_of_info(info: Any, *, rectified: bool) -> CameraIntrinsics:
    """The camera of a CameraInfo, of ROS 1 or ROS 2.

    Raises:
        GeometryError: a lens model that we do not have, a cut or binned picture, or numbers that
            no camera has.
    """
    k = np.asarray(_field(info, "k"), dtype=np.float64).reshape(3, 3)
    p = np.asarray(_field(info, "p"), dtype=np.float64).reshape(3, 4)[:, :3]
    d = np.asarray(_field(info, "d"), dtype=np.float64).ravel()
    matrix = p if rectified and p[0, 0] > 0 else k
    if info.binning_x > 1 or info.binning_y > 1:
        raise GeometryError(f"pictures binned {info.binning_x}x{info.binning_y} are not supported")
    roi = info.roi
    if (roi.height and roi.height != info.height) or (roi.width and roi.width != info.width):
        raise GeometryError(f"pictures cut to {roi.width}x{roi.height} are not supported")
    if not matrix[0, 0] > 0:
        raise GeometryError("it is not calibrated: fx is 0")
    model: DistortionModel = "none"
    coefficients = (0.0, 0.0, 0.0, 0.0, 0.0)
    if not rectified and d.any():
        model = "brown_conrady"
        coefficients = _five(str(info.distortion_model), d)
    return CameraIntrinsics(
        int(info.width),
        int(info.height),
        float(matrix[0, 0]),
        float(matrix[1, 1]),
        float(matrix[0, 2]),
        float(matrix[1, 2]),
        model,
        coefficients,
    )


def _five(
    name: str, d: np.ndarray[Any, np.dtype[np.float64]]
) -> tuple[float, float, float, float, float]:
    """k1, k2, p1, p2, k3 of a model that is OpenCV's with no more than these."""
    if name not in (_PLUMB_BOB, _RATIONAL):
        raise GeometryError(
            f"lens model {name[:40]!r} is not supported; known: {_PLUMB_BOB}. Rectified pictures "
            "(image_rect) need none"
        )
    if d.size > 5 and d[5:].any():
        raise GeometryError(
            f"lens model {name} with {d.size} coefficients is not supported, only five of it; "
            "rectified pictures (image_rect) need none"
        )
    k1, k2, p1, p2, k3 = (float(c) for c in np.concatenate([d, np.zeros(5)])[:5])
    return k1, k2, p1, p2, k3


def _field(info: Any, name: str) -> Any:
    """K, D and P are written large in ROS 1."""
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())
