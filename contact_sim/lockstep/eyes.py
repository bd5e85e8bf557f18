"""Who looks at a frame in lockstep: a real service, or a model of what one answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from drone_client.encoding_choice import ChosenEncoding
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Array, Pose, rotation_from_vector
from rgbd_wire.messages import Outcome, TargetPose, pack_covariance, pose_numbers
from target_pose.lens import project

BOARD_M = 0.4
HEADER_BYTES = 600
"""Of a frame: stamps, calibration, poses."""


class Sizes(NamedTuple):
    """Of a frame [bytes]."""

    message: int
    """On the wire."""
    color: int
    depth: int

    @classmethod
    def of_pictures(cls, color: int, depth: int) -> Sizes:
        """By the pictures alone: what else a frame carries weighs the same in every flight."""
        return cls(HEADER_BYTES + color + depth, color, depth)


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What a worker says of a frame."""

    outcome: Outcome
    target: TargetPose | None
    sizes: Sizes


class Eyes(Protocol):
    """Looks at a frame. Takes no simulated time: how long a worker takes is the flight's to say."""

    needs_pictures: bool
    """Whether the frame must have been drawn."""

    def look(
        self, frame: RgbdFrame, camera_from_target: Pose, chosen: ChosenEncoding | None = None
    ) -> Look:
        """Look at a frame.

        Args:
            frame: of black pictures, where no pictures are needed.
            camera_from_target: the truth; a service does not look at it.
            chosen: how it is coded; None: as well as can be.
        """
        ...


@dataclass(frozen=True, slots=True)
class EyesSettings:
    """A localiser as it was measured; docs/results/localiser.md, *nominal* and *low light*."""

    along_m: float = 0.0005
    """Standard deviation of the distance at 1 m; it grows with its square."""
    across_m: float = 0.0003
    """Of the place across at 1 m; it grows in proportion."""
    turned_rad: float = 0.002
    """Of the attitude at 1 m."""
    scale: float = 0.0015
    """Standard deviation of the focal length's error, drawn once a flight: all distances are off
    by it."""
    sight_rad: float = 0.0005
    """The same of the line of sight."""
    found: float = 0.95
    """Share of the frames in which a target that is in view is found."""
    farthest_m: float = 5.0
    nearest_m: float = 0.28
    """Nearer, the board's markings do not fit into the picture."""
    tilt_max_rad: float = 1.2
    color_bytes: int = 36_000
    """Of a picture in JPEG of quality 80, and"""
    depth_bytes: int = 26_000
    """of all its depth: means of drawn pictures of four flights."""


class ModelEyes:
    """A worker's answers without pictures: in view or not, found or not, and how wrong."""

    needs_pictures = False

    def __init__(
        self,
        color: CameraIntrinsics,
        rng: np.random.Generator,
        settings: EyesSettings | None = None,
    ) -> None:
        self.occluded = False
        """Somebody stands before the board."""
        self.dark = False
        """The lamp is out: less is found, and less well."""
        self._color = color
        self._rng = rng
        self._settings = settings or EyesSettings()
        s = self._settings
        self._scale = 1.0 + s.scale * rng.standard_normal()
        self._sight: Array = s.sight_rad * rng.standard_normal(2)

    def look(
        self, frame: RgbdFrame, camera_from_target: Pose, chosen: ChosenEncoding | None = None
    ) -> Look:
        """An answer; draws the same chances whatever it comes to."""
        s = self._settings
        noise, luck = self._rng.standard_normal(6), self._rng.uniform()
        found = s.found * (0.6 if self.dark else 1.0)
        if self.occluded or luck > found or not self._in_view(camera_from_target):
            return Look(Outcome.NOTHING_FOUND, None, self._sizes(chosen))
        worse = 2.0 if self.dark else 1.0
        range_m = float(np.linalg.norm(camera_from_target.translation))
        across, along = worse * s.across_m * range_m, worse * s.along_m * range_m**2
        turned = worse * s.turned_rad * max(range_m, 0.5)
        off = np.array([self._sight[0] * range_m, self._sight[1] * range_m, 0.0])
        place = self._scale * camera_from_target.translation + off
        place = place + noise[:3] * (across, across, along)
        turn = rotation_from_vector(turned * noise[3:]) @ camera_from_target.rotation
        # It knows its noise, and allows for calibration as the real one does
        covariance = np.diag(
            [
                across**2 + (s.sight_rad * range_m) ** 2,
                across**2 + (s.sight_rad * range_m) ** 2,
                along**2 + (s.scale * range_m) ** 2,
                *[turned**2] * 3,
            ]
        )
        seen = Pose.from_rotation(turn, place)
        target = TargetPose(
            camera_from_target=pose_numbers(seen),
            world_from_target=None,
            covariance=pack_covariance(covariance),
            method="fused",
            ambiguous=False,
            alternative=None,
            score=0.9,
            boxes=(),
        )
        return Look(Outcome.TARGET, target, self._sizes(chosen))

    def _sizes(self, chosen: ChosenEncoding | None) -> Sizes:
        """As the ladder of encodings weighs its rungs."""
        color, depth = float(self._settings.color_bytes), float(self._settings.depth_bytes)
        if chosen is not None:
            rung = chosen.choice.rung
            color *= rung.color_weight
            depth *= rung.depth_weight(chosen.choice.region_share)
        return Sizes.of_pictures(round(color), round(depth))

    def _in_view(self, camera_from_target: Pose) -> bool:
        """The inner half of the board is in the picture, near enough, and not from behind."""
        s, i = self._settings, self._color
        towards = camera_from_target.rotation[:, 0]
        sight = camera_from_target.translation
        range_m = float(np.linalg.norm(sight))
        if not s.nearest_m <= range_m <= s.farthest_m or sight[2] <= 0.1:
            return False
        if -float(towards @ sight) / range_m < math.cos(s.tilt_max_rad):
            return False
        half = BOARD_M / 4
        corners = np.array([[0.0, y, z] for y in (-half, half) for z in (-half, half)])
        points = corners @ camera_from_target.rotation.T + sight
        if points[:, 2].min() <= 0.05:
            return False
        pixels = project(points, i)
        inside = (pixels >= 0.0).all() and (pixels <= (i.width - 1, i.height - 1)).all()
        return bool(inside)
