"""Approaches with truth for ``bench_onboard``: recordings from disk, and rendered flights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.lookalikes import DRAWERS
from detector_training.scenes.printed import with_alpha
from detector_training.scenes.recording import Neighbour, plan_flight, render_frame
from drone_client.source.replay import ReplaySource
from drone_client.truth import load_truth
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera, load_camera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose, rotation_from_vector
from target_pose.lens import project
from target_pose.target import Target

ROOT = Path(__file__).parents[2]
PACKAGED = ROOT / "examples/recordings/rendered-approach"
REAL = ROOT.parent / "shared/data/kitchen-bullseye"
REAL_LENS = CameraIntrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
PACE = 0.4
"""A rendered approach takes 9 s at this pace: long enough for an outage of 5 s in its middle."""
RENDERED_HZ = 12.0
DRIFT_MPS, DRIFT_RADPS = 0.007, 0.0015
"""Length of a rendered flight's odometry drift, constant over the flight, in a random direction:
over half of what the drone allows for."""
JITTER_RAD = 0.002
"""Error of the camera's attitude at each exposure."""
BESIDE_M = (0.44, 0.6)
"""Distance of a look-alike's centre from the target's: board beside board, or a hand between."""
TWIN = "twin"
"""The same print once more."""
LOOKALIKES = ("rings_of_wrong_ratios", "inverted", "ring_without_dot", "speaker")


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One exposure: what the drone has of it, and the truth."""

    frame: RgbdFrame
    """Its ``world_from_camera`` is odometry's."""
    camera_from_target: Pose
    """True."""
    visible: float


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """An approach."""

    name: str
    kind: str
    """Row of the table."""
    shots: tuple[Shot, ...]
    others: tuple[Pose, ...] = ()
    """``target_from_other`` of what hangs beside the target."""

    @property
    def period_ns(self) -> int:
        """Between two exposures."""
        stamps = [s.frame.t_capture_ns for s in self.shots]
        return round(float(np.median(np.diff(stamps))))


def recording(folder: Path, truth: Path, camera: RgbdCamera, kind: str) -> Sequence:
    """A recording from disk; its odometry is its ground truth."""
    source = ReplaySource(folder, camera)
    entries = load_truth(truth, len(source))
    shots = []
    for capture, entry in zip(source.captures(), entries, strict=True):
        pose = source.world_from_camera(capture.t_source_ns)
        frame = RgbdFrame(capture.color_rgb, capture.depth_units, camera, capture.t_source_ns, pose)
        shots.append(Shot(frame, entry.camera_from_target, entry.visible))
    return Sequence(folder.name, kind, tuple(shots))


def recordings() -> Iterator[Sequence]:
    """The shipped recording, and the real one where it is."""
    camera = load_camera(PACKAGED / "camera.json")
    yield recording(PACKAGED, PACKAGED / "truth.json", camera, "shipped recording")
    if REAL.is_dir():
        rig = RgbdCamera(REAL_LENS, REAL_LENS, 0.0002, Pose.identity())
        yield recording(REAL, REAL / "targets.json", rig, "real recording")


def rendered(
    seed: int, target: Target, lookalike: str | None = None, tick: Callable[[], None] = lambda: None
) -> Sequence:
    """A slow approach in which odometry drifts; with a look-alike beside the target, or without.

    Args:
        seed: of the place, the sway, the drift and the look-alike.
        target: what is approached.
        lookalike: name of what hangs beside it, or ``twin`` for another print of the same target.
        tick: called after each frame.
    """
    rng = np.random.default_rng((seed, 5))
    flight = replace(plan_flight(seed, target), pace=PACE)
    others: tuple[Pose, ...] = ()
    if lookalike is not None:
        side = target.board_side_m
        angle = rng.uniform(-0.5, 0.5) + math.pi * rng.integers(2)
        away = rng.uniform(*BESIDE_M)
        shift = np.array([0.0, away * math.cos(angle), away * math.sin(angle)])
        pose = Pose(shift, Pose.identity().q_wxyz)
        texture = (
            with_alpha(flight.print_)
            if lookalike == TWIN
            else DRAWERS[lookalike][1](rng, 512, target)
        )
        flight = replace(flight, neighbours=(Neighbour(texture, side, pose),))
        others = (pose,)
    drift = _direction(rng) * DRIFT_MPS
    turn = np.array([0.0, 0.0, rng.choice([-1, 1]) * DRIFT_RADPS])
    shots = []
    for index in range(round(3.75 / PACE * RENDERED_HZ)):
        one = render_frame(flight, index)
        t_s = index / RENDERED_HZ
        drifted = Pose.from_rotation(rotation_from_vector(turn * t_s), drift * t_s)
        jitter = rotation_from_vector(rng.normal(0, JITTER_RAD, 3))
        odometry = drifted @ one.world_from_camera @ Pose.from_rotation(jitter, np.zeros(3))
        # as it comes from a camera's driver, and as the edge would decode it
        ok, jpeg = cv2.imencode(".jpg", one.color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
        assert ok
        color = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB), dtype=np.uint8)
        frame = RgbdFrame(color, one.depth, flight.camera, round(1e9 * t_s), odometry)
        shots.append(Shot(frame, one.camera_from_target, one.visible))
        tick()
    kind = "rendered" if lookalike is None else f"rendered, beside it: {lookalike}"
    return Sequence(f"seed {seed}", kind, tuple(shots), others)


def without_target(shot: Shot, target: Target) -> RgbdFrame:
    """The frame with the target painted over by what is around it, as if it had been taken down."""
    frame, side = shot.frame, target.board_side_m
    corners = np.array([[0, y, z] for y, z in ((-1, -1), (-1, 1), (1, 1), (1, -1))]) * side / 2
    uv = project(shot.camera_from_target @ (corners * 1.04), frame.camera.color)
    mask = np.zeros(frame.color_rgb.shape[:2], np.uint8)
    if np.isfinite(uv).all():
        cv2.fillConvexPoly(mask, np.rint(uv).astype(np.int32), 1)
    ring = cv2.dilate(mask, np.ones((9, 9), np.uint8)) - mask
    color: NDArray[np.uint8] = frame.color_rgb.copy()
    if ring.any():
        color[mask > 0] = np.median(frame.color_rgb[ring > 0], axis=0).astype(np.uint8)
    return replace(frame, color_rgb=color)


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))
