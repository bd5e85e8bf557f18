"""AprilTag 36h11 and ArUco in the same poses, light and conditions as our target.

A marker is found when a detection with its id has its centre within a quarter of the board's
projected side of the truth; ours when a candidate's has. Both libraries look at full resolution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.sample import Sample
from detector_training.evaluation.matching import Counting, candidate_outcome
from detector_training.evaluation.run import Find
from tests.perf.bench_detector_prints import APRILTAG, ARUCO, ARUCO_DICTIONARY, MARKER_ID

Centres: TypeAlias = NDArray[np.float64]  # (K, 2) [px]
FindMarker: TypeAlias = Callable[[NDArray[np.uint8]], Centres]

TOLERANCE = 0.25
"""Of the board's projected side."""


def april_tag() -> FindMarker:
    """Centres of our tag in an RGB picture, by pupil-apriltags.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    from pupil_apriltags import Detector

    class Kept(Detector):  # type: ignore[misc] # ships no types
        def __del__(self) -> None:
            """Leave it to the end of the process: the library frees what it still needs.

            https://github.com/pupil-labs/apriltags/pull/65; what follows may abort otherwise.
            """

    # 2, the default, halves the reach for speed; the comparison is about what can be found
    detector = Kept(families="tag36h11", quad_decimate=1.0)

    def find(rgb: NDArray[np.uint8]) -> Centres:
        gray = np.ascontiguousarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        found = [tag.center for tag in detector.detect(gray) if tag.tag_id == MARKER_ID]
        return np.array(found, np.float64).reshape(-1, 2)

    return find


def aruco() -> FindMarker:
    """Centres of our ArUco marker in an RGB picture, by OpenCV with its own defaults."""
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(ARUCO_DICTIONARY), cv2.aruco.DetectorParameters()
    )

    def find(rgb: NDArray[np.uint8]) -> Centres:
        corners, ids, _ = detector.detectMarkers(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        numbers = [] if ids is None else np.ravel(ids).tolist()
        found = [
            c.reshape(4, 2).mean(0)
            for c, number in zip(corners, numbers, strict=True)
            if number == MARKER_ID
        ]
        return np.array(found, np.float64).reshape(-1, 2)

    return find


FINDERS: dict[str, Callable[[], FindMarker]] = {APRILTAG: april_tag, ARUCO: aruco}


def centres_of_candidates(find: Find) -> Centres:
    """Centres of a picture's candidates, by their innermost box: it is nearest to the true one."""
    boxes = [list(c.boxes.values())[-1] for c in find.candidates]
    return np.array([b.center_px for b in boxes], np.float64).reshape(-1, 2)


def is_found(sample: Sample, centres: Centres) -> bool:
    """Whether one of the centres is that of the picture's board; it shall have one."""
    board, inner = sample.boxes[0], sample.boxes[-1]
    side = float(np.sqrt(np.prod(board[2:] - board[:2])))
    away = np.linalg.norm(centres - (inner[:2] + inner[2:]) / 2, axis=1)
    return bool((away <= TOLERANCE * side).any())


def counted(samples: Sequence[Sample], counting: Counting) -> list[int]:
    """Indices of the pictures whose board has to be found."""
    return [
        k for k, s in enumerate(samples) if bool(candidate_outcome(s, (), counting).counts.any())
    ]
