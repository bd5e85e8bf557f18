"""Poses of AprilTag 36h11 and ArUco, by their own libraries at their best.

A marker's frame is x right, y up along the board, z out of it; its side is that of the black square
that ``bench_detector_prints`` draws. Corners go round from the upper left one, as OpenCV's IPPE for
squares wants them, in pixels that count from the centre of the first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Array, Pose
from target_pose.target import Target
from tests.perf.bench_detector_prints import (
    APRILTAG,
    ARUCO,
    ARUCO_DICTIONARY,
    MARKER_ID,
    PRINTS,
    Marker,
)

Poses: TypeAlias = dict[str, Pose]
"""``camera_from_target`` by the way in which it was reckoned."""
FindPoses: TypeAlias = Callable[[NDArray[np.uint8]], list[tuple[tuple[float, float], Poses]]]
"""Centre [px] and poses of each marker of our id in an RGB picture."""

HALF_PX = 0.5
"""AprilTag counts from the corner of the first pixel, we from its centre."""
TAG_OWN, TAG_IPPE, ARUCO_IPPE = "apriltag, own", "apriltag, IPPE", "aruco, IPPE"
WAYS = {APRILTAG: (TAG_OWN, TAG_IPPE), ARUCO: (ARUCO_IPPE,)}


def black_side_m(printed: str, target: Target) -> float:
    """Side of a marker's black square when its white margin fills the board."""
    marker = PRINTS[printed]
    assert isinstance(marker, Marker)
    modules = len(marker.modules())
    return target.board_side_m * (modules - 2) / modules


def april_tag_poses(
    camera: CameraIntrinsics, side_m: float, quad_decimate: float = 1.0
) -> FindPoses:
    """By pupil-apriltags, one thread: its own pose (orthogonal iteration), and IPPE's.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    from pupil_apriltags import Detector

    class Kept(Detector):  # type: ignore[misc] # ships no types
        def __del__(self) -> None:
            """Leave it to the end of the process: the library frees what it still needs.

            https://github.com/pupil-labs/apriltags/pull/65; what follows may abort otherwise.
            """

    detector = Kept(families="tag36h11", nthreads=1, quad_decimate=quad_decimate)
    own_camera = (camera.fx, camera.fy, camera.cx + HALF_PX, camera.cy + HALF_PX)

    def find(rgb: NDArray[np.uint8]) -> list[tuple[tuple[float, float], Poses]]:
        gray = np.ascontiguousarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        tags = detector.detect(gray, True, own_camera, side_m)
        return [_tag(tag, camera, side_m) for tag in tags if tag.tag_id == MARKER_ID]

    return find


def _tag(tag: Any, camera: CameraIntrinsics, side_m: float) -> tuple[tuple[float, float], Poses]:
    # its frame is x right, y down, z into the tag; its corners go round from the lower left
    r, t = np.asarray(tag.pose_R), np.asarray(tag.pose_t).ravel()
    own = Pose.from_rotation(np.column_stack([-r[:, 2], r[:, 0], -r[:, 1]]), t)
    corners = np.asarray(tag.corners)[::-1] - HALF_PX
    poses = {TAG_OWN: own}
    if (ippe := ippe_pose(corners, camera, side_m)) is not None:
        poses[TAG_IPPE] = ippe
    u, v = np.asarray(tag.center) - HALF_PX
    return (float(u), float(v)), poses


def aruco_poses(camera: CameraIntrinsics, side_m: float) -> FindPoses:
    """By OpenCV, its corners refined to sub-pixels."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(ARUCO_DICTIONARY), parameters
    )

    def find(rgb: NDArray[np.uint8]) -> list[tuple[tuple[float, float], Poses]]:
        found, ids, _ = detector.detectMarkers(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        numbers = [] if ids is None else np.ravel(ids).tolist()
        markers = []
        for raw, number in zip(found, numbers, strict=True):
            if number != MARKER_ID:
                continue
            corners = np.asarray(raw, np.float64).reshape(4, 2)
            pose = ippe_pose(corners, camera, side_m)
            u, v = corners.mean(axis=0)
            markers.append(((float(u), float(v)), {} if pose is None else {ARUCO_IPPE: pose}))
        return markers

    return find


def ippe_pose(corners_px: Array, camera: CameraIntrinsics, side_m: float) -> Pose | None:
    """The better of IPPE's two poses of a square with corners (4, 2), by reprojection."""
    h = side_m / 2
    square = np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
    done, turn, t = cv2.solvePnP(
        square, corners_px, camera.image_from_camera, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    if not done or not (np.isfinite(turn).all() and np.isfinite(t).all()):
        return None
    r = cv2.Rodrigues(turn)[0]
    return Pose.from_rotation(np.column_stack([r[:, 2], r[:, 0], r[:, 1]]), np.ravel(t))


def open_markers(camera: CameraIntrinsics, target: Target) -> dict[str, FindPoses]:
    """Both libraries, by print."""
    return {
        APRILTAG: april_tag_poses(camera, black_side_m(APRILTAG, target)),
        ARUCO: aruco_poses(camera, black_side_m(ARUCO, target)),
    }
