"""Where the camera may see the target from: near and far, tilted, rolled, cut by the border."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector_training.errors import SceneError
from detector_training.scenes.projection import image_from_board, is_in_front, square_box
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose, rotation_from_vector

WIDTH_PX = 640
HEIGHT_PX = 480
MAX_TRIES = 10_000


def random_camera(rng: np.random.Generator) -> CameraIntrinsics:
    """A 640x480 camera with the focal lengths of common RGB-D sensors."""
    f = float(rng.uniform(370, 700))
    cx = (WIDTH_PX - 1) / 2 + float(rng.normal(0, 6))
    cy = (HEIGHT_PX - 1) / 2 + float(rng.normal(0, 6))
    return CameraIntrinsics(WIDTH_PX, HEIGHT_PX, f, f * float(rng.normal(1, 0.003)), cx, cy)


def facing(
    centre_camera: NDArray[np.float64], tilt_rad: float, tilt_about_rad: float, roll_rad: float
) -> Pose:
    """``camera_from_target`` of a board at ``centre_camera`` (3,) [m].

    Args:
        centre_camera: centre of the board.
        tilt_rad: angle between the board's normal and the line of sight.
        tilt_about_rad: direction of the axis, in the picture, about which it is tilted.
        roll_rad: turn in the picture; 0 is upright.
    """
    sight = centre_camera / np.linalg.norm(centre_camera)
    down = np.array([0.0, 1.0, 0.0])
    right = np.cross(down, sight)
    right /= np.linalg.norm(right)
    axis = math.cos(tilt_about_rad) * right + math.sin(tilt_about_rad) * np.cross(sight, right)
    normal = rotation_from_vector(tilt_rad * axis) @ -sight
    up = rotation_from_vector(roll_rad * sight) @ -down
    up -= (up @ normal) * normal
    up /= np.linalg.norm(up)
    rotation = np.column_stack([normal, np.cross(up, normal), up])
    return Pose.from_rotation(rotation, centre_camera)


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a board may be."""

    board_px: tuple[float, float]
    """Apparent side head-on, uniform in its logarithm ..."""
    distance_m: tuple[float, float] | None = None
    """... or the distance, uniform, when given."""
    tilt_deg: tuple[float, float] | None = None
    """Uniform between these; None: about normal with 28 degrees, a quarter uniform to 70."""
    cut: float = 0.0
    """Probability that the border may cut it."""
    any_roll: float = 0.0
    """Probability of any roll; else the camera is about level."""
    whole: bool = False
    """Nothing lies outside the picture; needs boards that fit into it."""


def random_placement(
    rng: np.random.Generator, camera: CameraIntrinsics, side_m: float, where: Placement
) -> Pose:
    """``camera_from_target`` of a board, all of it in front of the camera.

    Args:
        rng: source of chance.
        camera: who looks.
        side_m: side of the board.
        where: what it is drawn from.

    Raises:
        SceneError: the places that are asked for seem to be none.
    """
    for _ in range(MAX_TRIES):
        if where.distance_m is None:
            size = math.exp(rng.uniform(*np.log(where.board_px)))
        else:
            size = camera.fx * side_m / rng.uniform(*where.distance_m)
        centre = _centre_px(rng, camera, size, where.cut)
        distance = camera.fx * side_m / size
        ray = np.array(
            [(centre[0] - camera.cx) / camera.fx, (centre[1] - camera.cy) / camera.fy, 1]
        )
        tilt = _tilt_rad(rng, where)
        # mostly a camera that looks from the side, or from below and above
        level = rng.random() >= where.any_roll
        roll = rng.normal(0, math.radians(9)) if level else rng.uniform(-math.pi, math.pi)
        pose = facing(ray * distance, tilt, rng.uniform(0, 2 * math.pi), roll)
        if is_in_front(pose, side_m) and (not where.whole or _is_whole(camera, pose, side_m)):
            return pose
    raise SceneError(
        f"no place for a board of {side_m:g} m in {MAX_TRIES} tries; give smaller boards, longer "
        "distances or less tilt"
    )


def _is_whole(camera: CameraIntrinsics, pose: Pose, side_m: float) -> bool:
    x0, y0, x1, y1 = square_box(image_from_board(camera, pose), side_m)
    return x0 >= 0 and y0 >= 0 and x1 <= camera.width - 1 and y1 <= camera.height - 1


def _tilt_rad(rng: np.random.Generator, where: Placement) -> float:
    if where.tilt_deg is not None:
        return math.radians(rng.uniform(*where.tilt_deg))
    tilt = abs(rng.normal(0, math.radians(28)))
    if rng.random() < 0.25:
        tilt = rng.uniform(0, math.radians(70))
    return float(min(tilt, math.radians(70)))


def _centre_px(
    rng: np.random.Generator, camera: CameraIntrinsics, board_px: float, cut: float
) -> tuple[float, float]:
    w, h = camera.width, camera.height
    if rng.random() < cut:
        u, v = rng.uniform(0, w), rng.uniform(0, h)
        offset = rng.uniform(-0.45, 0.45) * board_px
        match int(rng.integers(4)):
            case 0:
                u = -offset
            case 1:
                u = w + offset
            case 2:
                v = -offset
            case _:
                v = h + offset
        return u, v
    # whole where it fits, with room for a tilt that brings one side nearer
    margin_u, margin_v = min(0.56 * board_px, 0.45 * w), min(0.56 * board_px, 0.45 * h)
    u = rng.uniform(margin_u, w - margin_u)
    v = rng.uniform(margin_v, h - margin_v)
    return float(u), float(v)
