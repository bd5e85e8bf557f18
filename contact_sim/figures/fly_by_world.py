"""A tunnel with boards along its walls, and a camera's way past them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from contact_sim.chance import stream
from contact_sim.errors import FigureError
from contact_sim.figures.picture import camera_at
from contact_sim.scene import SEEN_GROUP, Scene, build_scene
from contact_sim.scene.board import print_texture
from contact_sim.scene.shapes import add_shape, moved, panel
from contact_sim.scene.textures import add_material
from drone_client.airframe import CAMERA_DOWN_RAD
from drone_client.viewing.overlay import project
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose
from target_pose.target import Target, load_round_target

SEED: Final = 12
"""A straight tunnel whose own board hangs on its end."""
ALONG_M: Final = (3.6, 8.8, 6.0, 11.0)
"""How far from the end each further board hangs; the first two left of one who looks there."""
STATES: Final = ("clean", "scratched", "glossy", "clean")
HEIGHT_M: Final = 1.45
OFF_M: Final = 0.04
"""So far before the rock."""
PRINT_PX: Final = 1024
SPEED_MPS: Final = 0.7
TURN_RADPS: Final = 0.5
ASIDE_RAD: Final = math.radians(80.0)
"""How far the camera looks aside of where it goes."""
FARTHEST_M: Final = 5.0
STEEPEST_RAD: Final = math.radians(70.0)
"""A board that is turned further away, or is farther off, does not count as in view."""
HARDLY_M: Final = 7.0
HARDLY_RAD: Final = math.radians(80.0)
"""And not even as in view in part."""
NEAR_M, FAR_M = 2.6, 12.4
"""The way turns so far from the end, and begins so far from it."""


@dataclass(frozen=True, slots=True, eq=False)
class FlyBy:
    """The world, its boards, and the way."""

    scene: Scene
    target: Target
    world_from_boards: tuple[Pose, ...]
    way: tuple[Pose, ...]
    """``world_from_camera`` of each picture."""
    rate_hz: float


def build_fly_by(rate_hz: float) -> FlyBy:
    """The tunnel of ``SEED`` with boards, and the camera's way at so many pictures a second.

    Raises:
        FigureError: no rock where a board should hang.
    """
    scene = build_scene("tunnel", SEED)
    target = load_round_target()
    heading = math.radians(scene.facts["heading_deg"])
    out = np.array([math.cos(heading), math.sin(heading), 0.0])
    left = np.array([math.sin(heading), -math.cos(heading), 0.0])
    foot = scene.world_from_target.translation * (1.0, 1.0, 0.0)
    model = scene.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    walls = {side: _wall_m(model, data, foot + 6.0 * out, side * left) for side in (1.0, -1.0)}
    middle = foot + 0.5 * (walls[1.0] - walls[-1.0]) * left
    boards = [scene.world_from_target]
    for number, (along, state) in enumerate(zip(ALONG_M, STATES, strict=True), 1):
        side = 1.0 if number <= 2 else -1.0
        place = _hang(model, data, middle + along * out, side * left, target)
        _add_board(scene.spec, target, number, state, place)
        boards.append(place)
    return FlyBy(scene, target, tuple(boards), _way(middle, out, rate_hz), rate_hz)


def _hang(
    model: mujoco.MjModel, data: mujoco.MjData, middle: Array, outwards: Array, target: Target
) -> Pose:
    """``world_from_target`` of a board before the wall: clear of its roughest stone."""
    along = np.array([-outwards[1], outwards[0], 0.0])
    half = target.board_side_m / 2
    free = min(
        _wall_m(model, data, middle + u * along + v * np.array([0.0, 0.0, 1.0]), outwards)
        for u in np.linspace(-half, half, 5)
        for v in np.linspace(-half, half, 5)
    )
    x, z = -outwards, np.array([0.0, 0.0, 1.0])
    rotation = np.column_stack([x, np.cross(z, x), z])
    place = middle + (free - OFF_M) * outwards + np.array([0.0, 0.0, HEIGHT_M])
    return Pose.from_rotation(rotation, place)


def _wall_m(model: mujoco.MjModel, data: mujoco.MjData, foot: Array, towards: Array) -> float:
    """How far it is from above a place to what is seen there."""
    group = np.zeros(6, np.uint8)
    group[SEEN_GROUP] = 1
    geom = np.zeros(1, np.int32)
    start = foot + np.array([0.0, 0.0, HEIGHT_M])
    distance = float(mujoco.mj_ray(model, data, start, towards, group, 1, -1, geom, None))
    if not 0.5 < distance < 10.0:
        raise FigureError(f"no wall to hang a board on at {np.round(start, 2)} ({distance:.1f} m)")
    return distance


def _add_board(spec: mujoco.MjSpec, target: Target, number: int, state: str, place: Pose) -> None:
    """A print that is seen; nobody will touch it."""
    half = target.board_side_m / 2
    name = f"print {number}"
    chance = stream(SEED, f"{name} {state}")
    shine = {"specular": 0.6, "shine": 0.15} if state == "glossy" else {}
    add_material(spec, name, print_texture(target, state, chance, PRINT_PX), **shine)
    sheet = panel(
        np.array([0.0, -half, half]),
        np.array([0.0, 2 * half, 0.0]),
        np.array([0.0, 0.0, -2 * half]),
        tile_m=2 * half,
        cells=16,
    )
    add_shape(spec, name, moved(sheet, place), name)


def _way(middle: Array, out: Array, rate_hz: float) -> tuple[Pose, ...]:
    """In with the left wall in view, a turn before the end, and out with the other one."""
    back = math.atan2(-out[1], -out[0])
    height = np.array([0.0, 0.0, HEIGHT_M])
    step_m = SPEED_MPS / rate_hz
    inwards = np.arange(FAR_M, NEAR_M, -step_m)
    turn = np.arange(ASIDE_RAD, -ASIDE_RAD, -TURN_RADPS / rate_hz)
    legs = [(along, ASIDE_RAD) for along in inwards]
    legs += [(NEAR_M, aside) for aside in turn]
    legs += [(along, -ASIDE_RAD) for along in inwards[::-1]]
    return tuple(
        camera_at(middle + along * out + height, back + aside, CAMERA_DOWN_RAD)
        for along, aside in legs
    )


class Seeing:
    """What of the boards is truly in a picture."""

    def __init__(self, fly_by: FlyBy, i: CameraIntrinsics) -> None:
        self._fly_by = fly_by
        self._intrinsics = i
        self._model = fly_by.scene.spec.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)

    def whole(self, world_from_camera: Pose) -> int | None:
        """Number of the board that is in view with all its corners; the nearest, or None.

        In view is what lies in the picture, is turned to it, is near enough, and is not hidden at
        its centre or a corner.
        """
        corners = np.vstack([np.zeros((1, 3)), self._corners()])
        return self._nearest(world_from_camera, corners, FARTHEST_M, STEEPEST_RAD)

    def partly(self, world_from_camera: Pose) -> int | None:
        """The same of what is in view at least in part: its centre is, and it may be farther."""
        return self._nearest(world_from_camera, np.zeros((1, 3)), HARDLY_M, HARDLY_RAD)

    def _nearest(
        self, world_from_camera: Pose, points: Array, farthest_m: float, steepest_rad: float
    ) -> int | None:
        camera_from_world = world_from_camera.inverse()
        found = []
        for number, world_from_board in enumerate(self._fly_by.world_from_boards):
            sight = camera_from_world @ world_from_board
            range_m = float(np.linalg.norm(sight.translation))
            towards = -float(sight.rotation[:, 0] @ sight.translation) / range_m
            if range_m > farthest_m or towards < math.cos(steepest_rad):
                continue
            eye = world_from_camera.translation
            if self._is_inside(points, sight) and not self._is_hidden(
                eye, world_from_board, points
            ):
                found.append((range_m, number))
        return min(found)[1] if found else None

    def _is_inside(self, points: Array, camera_from_board: Pose) -> bool:
        i = self._intrinsics
        pixels = project(points, camera_from_board, i)
        if pixels is None:
            return False
        size = i.width - 1, i.height - 1
        return bool((pixels >= 0.0).all() and (pixels <= size).all())

    def _is_hidden(self, eye: Array, world_from_board: Pose, points: Array) -> bool:
        group = np.zeros(6, np.uint8)
        group[SEEN_GROUP] = 1
        for point in 0.9 * points:
            way = world_from_board @ point - eye
            far_m = float(np.linalg.norm(way))
            geom = np.zeros(1, np.int32)
            hit_m = mujoco.mj_ray(
                self._model, self._data, eye, way / far_m, group, 1, -1, geom, None
            )
            if 0.0 <= hit_m < far_m - 0.05:
                return True
        return False

    def _corners(self) -> Array:
        half = self._fly_by.target.board_side_m / 2
        return half * np.array([(0, 1, 1), (0, -1, 1), (0, -1, -1), (0, 1, -1)], float)
