"""One RGB-D frame in memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import RgbdCamera
from rgbd_wire.errors import GeometryError
from rgbd_wire.geometry import Pose


@dataclass(frozen=True, slots=True, eq=False)
class RgbdFrame:
    """A colour picture, the raw depth picture beside it, and where and when both were taken.

    Raises:
        GeometryError: a picture does not have the size its camera has.
    """

    color_rgb: NDArray[np.uint8]  # (H, W, 3)
    depth_units: NDArray[np.uint16] | None  # (h, w)
    """Raw depth in units of ``camera.depth_scale_m``; 0: no depth there. None: no depth sensor."""
    camera: RgbdCamera
    t_capture_ns: int
    """Middle of the exposure, drone's monotonic clock."""
    world_from_camera: Pose | None
    """Colour camera at ``t_capture_ns``, where the drone knows it."""

    def __post_init__(self) -> None:
        color = (self.camera.color.height, self.camera.color.width, 3)
        if self.color_rgb.shape != color or self.color_rgb.dtype != np.uint8:
            raise GeometryError(
                f"colour is {self.color_rgb.shape} {self.color_rgb.dtype}, "
                f"the camera says {color} uint8"
            )
        if self.depth_units is not None:
            depth = (self.camera.depth.height, self.camera.depth.width)
            if self.depth_units.shape != depth or self.depth_units.dtype != np.uint16:
                raise GeometryError(
                    f"depth is {self.depth_units.shape} {self.depth_units.dtype}, "
                    f"the camera says {depth} uint16"
                )
