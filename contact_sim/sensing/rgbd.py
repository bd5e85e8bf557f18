"""The whole RGB-D camera: from where everything is to the picture and depth that it gives."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from contact_sim.chance import stream
from contact_sim.scene import Light, Snapshot
from contact_sim.sensing import as_built
from contact_sim.sensing.color import ColorCamera, Exposure, swept_px
from contact_sim.sensing.depth import measured
from contact_sim.sensing.renderer import COLOR_CAMERA, Renderer
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Pose


class Picture(NamedTuple):
    """One exposure."""

    t_ns: int
    """Simulated time of its middle."""
    color_rgb: NDArray[np.uint8]  # (H, W, 3)
    depth_units: NDArray[np.uint16]  # (h, w)
    world_from_camera: Pose
    """Where the colour camera truly was."""


class RgbdModel:
    """A D455 in a world. Belongs to the thread that made it, as its renderer does.

    Raises:
        RenderError: no OpenGL draws here without a screen.
    """

    def __init__(self, model: mujoco.MjModel, rig: RgbdCamera, light: Light, seed: int) -> None:
        """Open the renderer.

        Args:
            model: the world with the drone.
            rig: its cameras.
            light: of the world.
            seed: of noise, dust and holes.
        """
        # The world is seen through the camera as it is, and told through the one on its paper
        self._renderer = Renderer(model, as_built(rig, stream(seed, "rig")))
        self._rig = rig
        self._light = light
        self._color_rng = stream(seed, "color")
        self._depth_rng = stream(seed, "depth")
        self._color = ColorCamera(rig.color, stream(seed, "color sensor"))
        self._exposure: Exposure | None = None
        self._last: tuple[int, Pose] | None = None

    def take(self, snapshot: Snapshot) -> Picture:
        """The picture of a moment; moments come in order, for exposure and smear remember."""
        renderer, light = self._renderer, self._light
        renderer.place(snapshot)
        view = renderer.color()
        here = renderer.pose_of(COLOR_CAMERA)
        swept, elapsed_s = (0.0, 0.0), 0.0
        exposure = self._color.metered(view, light)
        if self._last is not None and self._exposure is not None:
            t_ns, before = self._last
            elapsed_s = max((snapshot.t_ns - t_ns) / 1e9, 1e-6)
            exposure = self._color.metered(view, light, self._exposure, elapsed_s)
            share = exposure.exposure_s / elapsed_s
            across = swept_px(before, here, self._rig.color, _middle_m(view.depth_m))
            still = swept_px(here, here, self._rig.color, _middle_m(view.depth_m))
            swept = (share * (across[0] - still[0]), share * (across[1] - still[1]))
        self._exposure, self._last = exposure, (snapshot.t_ns, here)
        color = self._color.expose(
            view, light, exposure, self._color_rng, swept, snapshot.lamps_out
        )
        depth = measured(renderer.depth(), self._rig, light, self._depth_rng)
        return Picture(snapshot.t_ns, color, depth, here)

    def close(self) -> None:
        """Give the renderer back."""
        self._renderer.close()


def _middle_m(depth_m: NDArray[np.float32]) -> float:
    """How far it is in the middle of the picture; the sky counts as far away."""
    h, w = depth_m.shape
    depth = float(np.median(depth_m[h // 3 : -h // 3 : 4, w // 3 : -w // 3 : 4]))
    return min(depth, 100.0)
