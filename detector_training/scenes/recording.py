"""A rendered approach flight in the TUM RGB-D layout, with the truth beside it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.errors import DatasetError, SceneError
from detector_training.scenes import sensor
from detector_training.scenes.flight import Sway, random_sway, world_from_camera
from detector_training.scenes.image import LinearImage, srgb_from_linear
from detector_training.scenes.labels import label_boxes
from detector_training.scenes.printed import Paint, draw_target, wear, with_alpha
from detector_training.scenes.projection import circle_box, image_from_board, square_box
from detector_training.scenes.raycast import cast, pixel_rays
from detector_training.scenes.room import render
from detector_training.scenes.stereo import StereoNoise, raw_depth
from detector_training.scenes.tunnel import Tunnel, make_tunnel
from detector_training.scenes.warp import paste, texture_side_px, warp
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.target import Level, Target

RATE_HZ = 12.0
FRAMES = 45
MAX_FRAMES = 10_000
START_S = 1_760_000_000.0
"""Unix time of the first frame, as TUM files have it."""
EXPOSURE_S = 0.006
JPEG_QUALITY = 80
README = """# A rendered approach

**These pictures are rendered, not photographed.** A drone with a camera like a RealSense D455 turns
towards a {target} target on the end wall of a tunnel and flies to 0.8 m in front of it: {frames}
frames at {rate:g} Hz. The same command makes the same folder:

    {command}

- `rgb.txt`, `rgb/`: colour, JPEG; each line is `time file`.
- `depth.txt`, `depth/`: raw depth, PNG, 16 bit, 1 mm, 0 = none; not aligned to colour.
- `groundtruth.txt`: `time tx ty tz qx qy qz qw`, the pose `world_from_camera` of the colour camera
  at mid-exposure; the world is ENU, z up.
- `camera.json`: intrinsics of both cameras, `color_from_depth`, depth scale and lattice.
- `truth.json`, per frame: `t`; `camera_from_target`, 4x4 (target frame: x out of the board, z up
  along it); `boxes_px`, x0 y0 x1 y1 around the true shape of each level, not clipped by the
  picture; `visible`, the share of the board's area that is in the picture.

Noise: disparity {noise.sigma_px:g} px (1 sigma, correlated), depths {noise.scale_error:.1%} too
long, {noise.hole_share:.0%} holes in patches and the shadows that a stereo pair has beside edges;
motion blur of {exposure_ms:g} ms, shot and read noise.
"""


def d455() -> RgbdCamera:
    """A camera like a D455: 640x480 colour, and depth at 424x240, which keeps the folder small."""
    f = 214.2
    return RgbdCamera(
        CameraIntrinsics(640, 480, 385.4, 384.9, 321.3, 238.6),
        CameraIntrinsics(424, 240, f, f, 211.7, 119.2),
        0.001,
        Pose.from_rotation(_small_turn(), np.array([-0.059, 0.0002, -0.0001])),
        f * 0.095 * 32,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Neighbour:
    """Something flat that hangs on the wall beside the target."""

    texture: NDArray[np.float32]  # (N, N, 4), premultiplied RGBA
    side_m: float
    target_from_neighbour: Pose


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Everything that does not change from frame to frame."""

    target: Target
    camera: RgbdCamera
    tunnel: Tunnel
    sway: Sway
    print_: NDArray[np.float32]  # (N, N, 3) albedo
    noise: StereoNoise
    seed: int
    pace: float = 1.0
    """Speed of the approach."""
    neighbours: tuple[Neighbour, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame and the truth about it."""

    t_s: float
    color: NDArray[np.uint8]  # (480, 640, 3) RGB
    depth: NDArray[np.uint16]  # (240, 424)
    world_from_camera: Pose
    camera_from_target: Pose
    boxes_px: dict[Level, tuple[float, float, float, float]]
    visible: float


def plan_flight(seed: int, target: Target) -> Flight:
    """The flight of a seed: the place, the sway and the print's wear.

    Raises:
        SceneError: the seed is out of bounds.
    """
    if not 0 <= seed < 2**63:
        raise SceneError(f"--seed {seed}: give a whole number from 0 to 2^63 - 1")
    rng = np.random.default_rng((seed, 3))
    paint = Paint(
        np.array([0.78, 0.77, 0.74], dtype=np.float32), np.array([0.04] * 3, dtype=np.float32)
    )
    albedo = draw_target(target, 1024, paint)
    wear(rng, albedo, 0.15)
    return Flight(
        target,
        d455(),
        make_tunnel(rng, target),
        random_sway(rng),
        np.clip(albedo, 0, 1),
        StereoNoise(),
        seed,
    )


def render_frame(flight: Flight, index: int) -> Frame:
    """Frame ``index`` of a flight; the same arrays for the same seed."""
    rng = np.random.default_rng((flight.seed, 4, index))
    t_s = index / RATE_HZ
    spot = flight.tunnel.world_from_target.translation
    pose = world_from_camera(t_s, spot, flight.sway, flight.pace)
    camera_from_target = pose.inverse() @ flight.tunnel.world_from_target
    camera = flight.camera
    image = _color_light(flight, pose, camera_from_target)
    later = world_from_camera(t_s + EXPOSURE_S / 2, spot, flight.sway, flight.pace)
    earlier = world_from_camera(t_s - EXPOSURE_S / 2, spot, flight.sway, flight.pace)
    image = _moved(image, camera.color, earlier, later)
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.6)) * np.float32(0.8)
    noisy = sensor.add_noise(rng, image, 6000.0, 0.002, 0.5)
    world_from_depth = pose @ camera.color_from_depth
    room = flight.tunnel.room
    hits = cast(pixel_rays(camera.depth), world_from_depth, room.walls, room.furniture)
    hidden = np.zeros((camera.color.height, camera.color.width), dtype=np.float32)
    labels = label_boxes(flight.target, camera.color, camera_from_target, hidden)
    h = image_from_board(camera.color, camera_from_target)
    boxes = {
        level: square_box(h, size) if level is Level.GOOD else circle_box(h, size / 2)
        for level, size in flight.target.level_m.items()
    }
    return Frame(
        START_S + t_s,
        srgb_from_linear(noisy),
        raw_depth(rng, hits.depth_m, camera, flight.noise),
        pose,
        camera_from_target,
        boxes,
        labels[0].visible if labels else 0.0,
    )


def write_recording(
    out: Path,
    seed: int,
    target: Target,
    command: str,
    frames: int = FRAMES,
    overwrite: bool = False,
    on_progress: Callable[[int], None] = lambda done: None,
) -> None:
    """Render a flight into the folder ``out``.

    Args:
        out: folder, made when missing.
        seed: of the place and the sway.
        target: what hangs on the wall.
        command: the command line, for the README.
        frames: how many.
        overwrite: replace a recording that is there.
        on_progress: called with the number of frames done.

    Raises:
        DatasetError: ``out`` holds a recording already, or cannot be written.
        SceneError: a number is out of bounds.
    """
    if not 1 <= frames <= MAX_FRAMES:
        raise SceneError(f"--frames {frames}: give 1 to {MAX_FRAMES}")
    flight = plan_flight(seed, target)
    if (out / "rgb.txt").exists() and not overwrite:
        raise DatasetError(f"{out} holds a recording already; name another folder or --overwrite")
    try:
        for folder in (out / "rgb", out / "depth"):
            folder.mkdir(parents=True, exist_ok=True)
            for old in folder.iterdir():
                old.unlink()
    except OSError as error:
        raise DatasetError(f"cannot write to {out}: {error.strerror}") from None
    lists: dict[str, list[str]] = {
        "rgb": ["# timestamp filename"],
        "depth": ["# timestamp filename"],
        "groundtruth": ["# timestamp tx ty tz qx qy qz qw   (world_from_camera)"],
    }
    truth = []
    for index in range(frames):
        frame = render_frame(flight, index)
        stamp = f"{frame.t_s:.6f}"
        (out / "rgb" / f"{stamp}.jpg").write_bytes(sensor.jpeg(frame.color, JPEG_QUALITY))
        cv2.imwrite(
            str(out / "depth" / f"{stamp}.png"), frame.depth, [cv2.IMWRITE_PNG_COMPRESSION, 9]
        )
        lists["rgb"].append(f"{stamp} rgb/{stamp}.jpg")
        lists["depth"].append(f"{stamp} depth/{stamp}.png")
        lists["groundtruth"].append(f"{stamp} {_tum(frame.world_from_camera)}")
        truth.append(_truth(frame))
        on_progress(index + 1)
    for name, lines in lists.items():
        (out / f"{name}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    camera = json.dumps(flight.camera.to_json(), indent=2)
    (out / "camera.json").write_text(camera + "\n", encoding="utf-8")
    text = ",\n".join(json.dumps(t) for t in truth)
    (out / "truth.json").write_text(f"[\n{text}\n]\n", encoding="utf-8")
    readme = README.format(
        target=target.name,
        frames=frames,
        rate=RATE_HZ,
        command=command,
        noise=flight.noise,
        exposure_ms=EXPOSURE_S * 1e3,
    )
    (out / "README.md").write_text(readme, encoding="utf-8")


def _color_light(flight: Flight, pose: Pose, camera_from_target: Pose) -> LinearImage:
    """What the colour camera would see without blur and noise."""
    camera = flight.camera.color
    image, light, _ = render(flight.tunnel.room, camera, pose, supersampling=2)
    for neighbour in flight.neighbours:
        camera_from_neighbour = camera_from_target @ neighbour.target_from_neighbour
        _paste(image, light, camera, camera_from_neighbour, neighbour.texture, neighbour.side_m)
    albedo = with_alpha(flight.print_)
    _paste(image, light, camera, camera_from_target, albedo, flight.target.board_side_m)
    return image


def _paste(
    image: LinearImage,
    light: NDArray[np.float32],
    camera: CameraIntrinsics,
    camera_from_board: Pose,
    texture: NDArray[np.float32],
    side_m: float,
) -> None:
    """Lay a texture (N, N, 4) on the wall, in place, lit as the wall is."""
    h = image_from_board(camera, camera_from_board)
    wanted = min(texture_side_px(h, side_m), texture.shape[0])
    fine = np.asarray(cv2.resize(texture, (wanted, wanted), interpolation=cv2.INTER_AREA))
    layer = warp(fine, side_m, h, camera.width, camera.height)
    if layer is not None:
        paste(image, layer, light[layer.window][..., None])


def _moved(image: LinearImage, camera: CameraIntrinsics, earlier: Pose, later: Pose) -> LinearImage:
    """Blur of the turn made during the exposure, taken in the middle of the picture."""
    ray = (earlier.inverse() @ later).rotation @ np.array([0.0, 0.0, 1.0])
    dx, dy = camera.fx * ray[0] / ray[2], camera.fy * ray[1] / ray[2]
    length = math.hypot(dx, dy)
    if length < 0.3:
        return image
    return sensor.blurred(image, sensor.motion_kernel(length, math.atan2(dy, dx)))


def _small_turn() -> NDArray[np.float64]:
    """Two imagers are never quite parallel: 0.2 degrees."""
    a = math.radians(0.2)
    c, s = math.cos(a), math.sin(a)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _tum(pose: Pose) -> str:
    w, x, y, z = pose.q_wxyz
    return " ".join(f"{v:.6f}" for v in (*pose.translation, x, y, z, w))


def _truth(frame: Frame) -> dict[str, Any]:
    return {
        "t": round(frame.t_s, 6),
        "camera_from_target": np.round(frame.camera_from_target.matrix, 6).tolist(),
        "boxes_px": {str(k): [round(v, 2) for v in box] for k, box in frame.boxes_px.items()},
        "visible": round(frame.visible, 4),
    }
