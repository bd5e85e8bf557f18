"""Pictures of the simulated camera from anywhere, and what is drawn over them."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from contact_sim.figures.style import AMBER, AXES, GREEN
from contact_sim.scene import Light, Scene, Snapshot
from contact_sim.scene.drone import add_drone
from contact_sim.sensing import d455
from contact_sim.sensing.rgbd import Picture, RgbdModel
from drone_client.airframe import FLU_FROM_RDF, Airframe
from drone_client.viewing.overlay import project
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Array, Pose, rotation_from_vector
from target_pose.target import Target

AXES_WORDS: Final = "x, out of the board, amber; y, to the right, blue; z, up, orange"
"""What ``target_lines`` draws, for captions."""
CIRCLE: Final = np.linspace(0.0, 2.0 * math.pi, 73)


class Studio:
    """The drone's camera in a scene, put wherever a picture is wanted; nothing flies.

    The drone is there with arm and lamp, as it would be. A context, for its renderer's sake.
    """

    def __init__(self, scene: Scene, seed: int, light: Light | None = None) -> None:
        self.rig = d455()
        self._airframe = Airframe()
        spec = scene.spec.copy()
        add_drone(spec, self._airframe, self.rig, scene.world_from_body)
        self._model = spec.compile()
        self._camera = RgbdModel(self._model, self.rig, light or scene.light, seed)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._camera.close()

    def take(
        self,
        t_ns: int,
        world_from_camera: Pose,
        lamps_out: frozenset[str] = frozenset(),
        arm_m: float = 0.0,
    ) -> Picture:
        """A picture with the camera there; moments come in order.

        Args:
            t_ns: simulated time.
            world_from_camera: where the colour camera is (RDF).
            lamps_out: names of lamps that do not shine.
            arm_m: by how much the arm is pressed in.
        """
        world_from_body = world_from_camera @ self._airframe.body_from_camera.inverse()
        qpos = self._model.qpos0.copy()
        qpos[:3], qpos[3:7] = world_from_body.translation, world_from_body.q_wxyz
        qpos[7] = -arm_m
        return self._camera.take(Snapshot(t_ns, qpos, lamps_out))

    def frame(self, picture: Picture) -> RgbdFrame:
        """The picture as the client sends it."""
        return RgbdFrame(
            picture.color_rgb,
            picture.depth_units,
            self.rig,
            picture.t_ns,
            picture.world_from_camera,
        )


def camera_at(place_world: Array, heading_rad: float, down_rad: float = 0.0) -> Pose:
    """``world_from_camera`` (RDF) of a camera without roll.

    Args:
        place_world: (3,) [m].
        heading_rad: where it looks, anticlockwise from the world's x.
        down_rad: how far it looks down.
    """
    heading = rotation_from_vector(np.array([0.0, 0.0, heading_rad]))
    pitch = rotation_from_vector(np.array([0.0, down_rad, 0.0]))
    return Pose.from_rotation(heading @ pitch @ FLU_FROM_RDF, place_world)


class Line(NamedTuple):
    """A line strip in the frame of the target."""

    points: Array  # (n, 3) [m]
    color: str


def target_lines(target: Target) -> list[Line]:
    """Edge and circles of the board, and its three axes."""
    half = target.board_side_m / 2
    square = half * np.array([(0, 1, 1), (0, -1, 1), (0, -1, -1), (0, 1, -1), (0, 1, 1)], float)
    around = np.column_stack([0.0 * CIRCLE, np.cos(CIRCLE), np.sin(CIRCLE)])
    circles = [Line(0.5 * disc.diameter_m * around, GREEN) for disc in target.discs]
    axes = [
        Line(np.stack([np.zeros(3), half * np.eye(3)[i]]), color)
        for i, color in enumerate((AMBER, *AXES[:2]))
    ]
    return [Line(square, GREEN), *circles, *axes]


def show(
    axes: Any,
    color_rgb: NDArray[np.uint8],
    camera_from_target: Pose | None,
    i: CameraIntrinsics,
    target: Target,
) -> None:
    """The picture, with the target drawn where an answer says it is."""
    axes.imshow(color_rgb, interpolation="antialiased")
    if camera_from_target is not None:
        for line in target_lines(target):
            pixels = project(line.points, camera_from_target, i)
            if pixels is not None:
                axes.plot(*pixels.T, color=line.color, lw=0.9)
    axes.set_xlim(-0.5, i.width - 0.5)
    axes.set_ylim(i.height - 0.5, -0.5)
    axes.set_axis_off()


def error_m(found: Pose, truth: Pose) -> float:
    """How far an answer's place is off."""
    return float(np.linalg.norm(found.translation - truth.translation))
