"""What may hang in the target's place: our target, two kinds of markers, and a blank board.

All are printed on the same board of 0.400 m. A marker is as large as the board lets it be with the
white margin of one module that its makers ask for: AprilTag 36h11 has 8 modules and 2 of margin, so
its black square measures 0.320 m; ArUco 4x4 has 6 and 2, so 0.300 m, as wide as our black disc. Of
ArUco's dictionaries 4x4_50 has the largest modules and so the longest reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.scenes.hang import Board
from detector_training.scenes.printed import Paint

MARKER_ID = 7
APRILTAG_DICTIONARY = cv2.aruco.DICT_APRILTAG_36h11
ARUCO_DICTIONARY = cv2.aruco.DICT_4X4_50


@dataclass(frozen=True)
class Marker:
    """Draws a marker of one of OpenCV's dictionaries with a margin of one module."""

    dictionary: int

    def modules(self) -> NDArray[np.float32]:
        """1 for white, 0 for black; (N, N) with the margin."""
        dictionary = cv2.aruco.getPredefinedDictionary(self.dictionary)
        side = dictionary.markerSize + 2
        bits = cv2.aruco.generateImageMarker(dictionary, MARKER_ID, side, borderBits=1)
        return np.pad(bits.astype(np.float32) / 255, 1, constant_values=1.0)

    def __call__(self, side_px: int, paint: Paint) -> NDArray[np.float32]:
        """Albedo (side_px, side_px, 3); a texel across an edge is the mean of both paints."""
        modules = self.modules()
        white = modules
        if side_px != len(modules):
            fine = -(-4 * side_px // len(modules))  # at least 4 samples a texel and side
            white = np.kron(modules, np.ones((fine, fine), np.float32))
            white = np.asarray(
                cv2.resize(white, (side_px, side_px), interpolation=cv2.INTER_AREA), np.float32
            )
        return np.asarray(paint.black + white[..., None] * (paint.white - paint.black), np.float32)


@dataclass(frozen=True)
class Blank:
    """An empty white board."""

    def __call__(self, side_px: int, paint: Paint) -> NDArray[np.float32]:
        """Albedo (side_px, side_px, 3)."""
        return np.broadcast_to(paint.white, (side_px, side_px, 3)).astype(np.float32)


OURS, APRILTAG, ARUCO, BLANK = "bullseye-400", "apriltag-36h11", "aruco-4x4", "blank"
PRINTS: dict[str, Board | None] = {
    OURS: None,
    APRILTAG: Marker(APRILTAG_DICTIONARY),
    ARUCO: Marker(ARUCO_DICTIONARY),
    BLANK: Blank(),
}
