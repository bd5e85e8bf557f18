"""The world of a flight once more, as a chase camera sees it."""

from __future__ import annotations

from typing import Final, Self

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from contact_sim.scene import SEEN_GROUP, Scene, Snapshot
from contact_sim.scene.drone import add_drone
from contact_sim.sensing import d455
from contact_sim.sensing.renderer import Renderer
from drone_client.airframe import Airframe
from drone_client.cbf.keep_out import BodyPart, KeepOut
from drone_client.viewing.facts import FlightFacts
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Array, Pose

OVERSAMPLE: Final = 2
"""Pixels drawn a pixel shown, each way: thin things such as the arm would flicker else."""
FOV_RAD: Final = 1.1
"""Of the chase camera, across."""
DARKEST: Final = 0.30
"""Mean level up to which a dark world is lifted, for people who want to see it."""
MAX_GAIN: Final = 6.0
SETTLING: Final = 0.05
"""By so much of what is missing the gain follows, a picture."""
HULL_RGBA: Final = (0.95, 0.55, 0.12, 1.0)
PROPELLER_RGBA: Final = (0.35, 0.65, 0.95, 0.35)
TIP_RGBA: Final = (0.95, 0.2, 0.15, 1.0)
CLEAR_M: Final = 0.25
"""So far before a wall the camera stays."""


class Stage:
    """Draws moments; belongs to the thread that made it.

    Raises:
        RenderError: no OpenGL draws here without a screen.
    """

    def __init__(self, scene: Scene, facts: FlightFacts, width: int, height: int) -> None:
        spec = scene.spec.copy()
        add_drone(spec, _airframe(facts), d455(), scene.world_from_body)
        _paint(spec)
        self.model = spec.compile()
        self.intrinsics = _pinhole(OVERSAMPLE * width, OVERSAMPLE * height)
        rig = RgbdCamera(self.intrinsics, self.intrinsics, 0.001, Pose.identity())
        self._size = width, height
        self._data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self._data)
        self._renderer = Renderer(self.model, rig)
        self._gain: float | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._renderer.close()

    def picture(self, snapshot: Snapshot, world_from_camera: Pose) -> NDArray[np.uint8]:
        """What the chase camera sees, (H, W, 3) RGB, neither dark nor coarse."""
        self._renderer.place(snapshot)
        color = self._renderer.color(world_from_camera).color
        small = cv2.resize(color, self._size, interpolation=cv2.INTER_AREA)
        level = float(small.mean())
        wanted = min(MAX_GAIN, max(1.0, DARKEST * 255 / max(1.0, level)))
        self._gain = wanted if self._gain is None else self._gain + SETTLING * (wanted - self._gain)
        return np.asarray(cv2.convertScaleAbs(small, alpha=self._gain))

    def free_m(self, origin: Array, direction: Array) -> float:
        """How far something may go from a place along a unit vector before it meets the world."""
        nearest = mujoco.mj_ray(
            self.model,
            self._data,
            origin,
            direction,
            np.array([group == SEEN_GROUP for group in range(6)], dtype=np.uint8),
            1,
            self.model.body("drone").id,
            np.zeros(1, dtype=np.int32),
        )
        return np.inf if nearest < 0 else max(0.0, nearest - CLEAR_M)


def _airframe(facts: FlightFacts) -> Airframe:
    """The drone that was flown, as far as it is drawn."""
    discs = tuple(BodyPart(p.center_body, p.radius_m, (0.0, 0.0, 1.0)) for p in facts.propellers)
    return Airframe(
        facts.body_from_camera, facts.body_from_tip, (KeepOut("wall of the board", discs),)
    )


def _paint(spec: mujoco.MjSpec) -> None:
    """Colours that a drone is found by, and the propellers, which its cameras do not see."""
    for geom in spec.geoms:
        if geom.name.startswith("drone/propeller"):
            geom.group, geom.rgba = SEEN_GROUP, PROPELLER_RGBA
        elif geom.name == "drone/body":
            geom.rgba = HULL_RGBA
        elif geom.name == "drone/tip":
            geom.rgba = TIP_RGBA


def _pinhole(width: int, height: int) -> CameraIntrinsics:
    f = width / 2 / float(np.tan(FOV_RAD / 2))
    return CameraIntrinsics(width, height, f, f, (width - 1) / 2, (height - 1) / 2)
