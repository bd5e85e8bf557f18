"""A camera for flights that have none: the board from where the vehicle is, at 15 Hz."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import cv2
import numpy as np

from drone_client.source import Capture
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.clock import Clock
from rgbd_wire.geometry import Pose
from target_pose.target import Shade, Target, load_target
from tests.unit.target_pose.render import Look, render_depth

INTRINSICS = CameraIntrinsics(640, 480, 385.0, 385.0, 319.5, 239.5)
DEPTH = CameraIntrinsics(160, 120, 96.25, 96.25, 79.5, 59.5)
CAMERA = RgbdCamera(INTRINSICS, DEPTH, 0.001, Pose.identity())
TARGET = load_target()
WALL, BLACK, WHITE = 120, 25, 225
SOFT_PX, GRAIN = 0.7, 1.5


def printed(target: Target, side_px: int) -> np.ndarray:
    """The board as it is printed, (side_px, side_px), seen from the front."""
    board = np.full((side_px, side_px), WHITE, np.uint8)
    middle, shift = (side_px - 1) / 2, 4
    for disc in sorted(target.discs, key=lambda d: -d.diameter_m):
        radius = disc.diameter_m / 2 / target.board_side_m * side_px
        shade = BLACK if disc.shade is Shade.BLACK else WHITE
        place = (round(middle * 2**shift),) * 2
        cv2.circle(board, place, round(radius * 2**shift), shade, -1, cv2.LINE_AA, shift)
    return board


class RenderedCamera:
    """A ``LiveSource`` of a board on a wall; frames have the time at which the pose was asked."""

    camera = CAMERA

    def __init__(
        self,
        clock: Clock,
        world_from_target: Pose,
        world_from_camera: Callable[[int], Pose | None],
        period_s: float = 1 / 15,
    ) -> None:
        self._clock = clock
        self._world_from_target = world_from_target
        self._world_from_camera = world_from_camera
        self._period_s = period_s
        self._prints = {side: printed(TARGET, side) for side in (128, 256, 512, 1024)}
        self._rng = np.random.default_rng(5)
        self._stop = threading.Event()
        self._given = 0

    def start(self) -> None:
        """Nothing to open."""

    def captures(self, timeout_s: float) -> Iterator[Capture | None]:
        """A picture as often as the machine lets it, at most one a period."""
        due_ns = self._clock.now_ns()
        while True:
            due_ns = max(due_ns + round(self._period_s * 1e9), self._clock.now_ns())
            if self._stop.wait((due_ns - self._clock.now_ns()) / 1e9):
                return
            t_ns = self._clock.now_ns()
            world_from_camera = self._world_from_camera(t_ns)
            if world_from_camera is None:
                yield None
                continue
            seen = world_from_camera.inverse() @ self._world_from_target
            self._given += 1
            yield Capture(t_ns, self._color(seen), self._depth(seen), str(self._given))

    def counts(self) -> dict[str, int]:
        """How many were given."""
        return {"given": self._given}

    def stop(self) -> None:
        """End ``captures``."""
        self._stop.set()

    def _color(self, camera_from_target: Pose) -> np.ndarray:
        """Colour (480, 640, 3) of the board before a plain wall."""
        near = max(camera_from_target.translation[2], 0.1)
        wide_px = 2 * INTRINSICS.fx * TARGET.board_side_m / near
        side = next((s for s in self._prints if s >= wide_px), max(self._prints))
        # pixel (i, j) of the print lies at y = (i + 1/2) / side - 1/2 to the right, z upwards
        metres = TARGET.board_side_m / side
        half = (side - 1) / 2
        from_print = np.array([[metres, 0, -half * metres], [0, -metres, half * metres], [0, 0, 1]])
        turn = camera_from_target.rotation
        k = np.array(
            [[INTRINSICS.fx, 0, INTRINSICS.cx], [0, INTRINSICS.fy, INTRINSICS.cy], [0, 0, 1.0]]
        )
        onto = k @ np.column_stack([turn[:, 1], turn[:, 2], camera_from_target.translation])
        picture = np.full((INTRINSICS.height, INTRINSICS.width), WALL, np.uint8)
        if near > 0.1:
            cv2.warpPerspective(
                self._prints[side],
                onto @ from_print,
                (INTRINSICS.width, INTRINSICS.height),
                dst=picture,
                flags=cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_TRANSPARENT,
            )
        soft = cv2.GaussianBlur(picture, (0, 0), SOFT_PX).astype(np.int16)
        noisy = soft + self._rng.integers(-3, 4, soft.shape, np.int16)
        gray = np.clip(noisy, 0, 255).astype(np.uint8)
        return np.repeat(gray[..., None], 3, axis=2)

    def _depth(self, camera_from_target: Pose) -> np.ndarray:
        """Raw depth (120, 160), with a stereo camera's errors."""
        return render_depth(
            TARGET, CAMERA, camera_from_target, Look(), self._rng, noise=2.5e-3, smooth_px=1.2
        )
