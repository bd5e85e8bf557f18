"""What lies on the picture itself: boxes, circles, edge points, axes, folds, covariance."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge_service.drawing.canvas import Canvas, Rgb
from edge_service.pipeline import Found
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.candidate import Box, Detections
from target_pose.fusion import CircleFit
from target_pose.lens import pixels_from_rays, project
from target_pose.localisation import Localisation, RollSource
from target_pose.target import Level, Target

Array: TypeAlias = NDArray[np.float64]

BOX_RGB: dict[Level, Rgb] = {
    Level.GOOD: (80, 220, 80),
    Level.BETTER: (40, 160, 255),
    Level.BEST: (255, 80, 60),
}
CIRCLE_RGB: Rgb = (255, 215, 0)
USED_RGB: Rgb = (0, 255, 225)
OUTLIER_RGB: Rgb = (255, 40, 220)
OTHER_FOLD_RGB: Rgb = (200, 175, 255)
COVARIANCE_RGB: Rgb = (255, 255, 255)
AXES: tuple[tuple[str, Rgb], ...] = (
    ("x", (255, 60, 60)),
    ("y", (60, 210, 60)),
    ("z", (80, 130, 255)),
)
"""Of the target frame: x out of the board, y left along it, z up along it."""
CHI_SQUARE_95 = 5.991
"""Of two degrees of freedom."""
MAX_BOXES = 60
"""Drawn per level, best first; a net that sees ghosts everywhere would paint the picture over."""


def draw_boxes(canvas: Canvas, detections: Detections, chosen: dict[Level, Box]) -> None:
    """Each level's boxes with their scores: the target's own bold, all others thin."""
    for level, boxes in detections.boxes.items():
        for box in boxes[:MAX_BOXES]:
            if box != chosen.get(level):
                canvas.line(_corners(canvas, box), BOX_RGB[level], closed=True)
                _label(canvas, box, f"{box.score:.2f}", BOX_RGB[level], 9.0)
    crowded = min((max(b.size_px) for b in chosen.values()), default=0.0) * canvas.scale < 40
    for n, (level, box) in enumerate(chosen.items()):
        canvas.line(_corners(canvas, box), BOX_RGB[level], width=2, closed=True)
        if n and crowded:
            continue  # the labels would cover the target, and one another
        _label(canvas, box, f"{level.value} {box.score:.2f}", BOX_RGB[level], 11.0)


def draw_circles(
    canvas: Canvas, intrinsics: CameraIntrinsics, target: Target, located: Localisation
) -> None:
    """The printed circles where the pose says they are."""
    for disc in target.discs:
        rim = circle_px(intrinsics, located.camera_from_target, disc.diameter_m / 2)
        canvas.line(canvas.at(rim), CIRCLE_RGB, closed=True)


def draw_edge_points(canvas: Canvas, intrinsics: CameraIntrinsics, located: Localisation) -> None:
    """The measured edge points: used ones as dots, outliers as crosses."""
    fit = edge_fit(located)
    if fit is None:
        return
    xy = canvas.at(pixels_from_rays(fit.edges.xy, intrinsics))
    canvas.dots(xy[fit.inliers], USED_RGB, 1.6)
    canvas.crosses(xy[~fit.inliers], OUTLIER_RGB, 3.5)


def draw_points(canvas: Canvas, intrinsics: CameraIntrinsics, target: Target, found: Found) -> None:
    """Labelled points: a dot where the net saw each, a cross where the pose puts it."""
    seen = found.candidate.points
    if found.localisation.roll_source is not RollSource.POINTS or not seen:
        return
    places = np.array([(0.0, p.y_m, p.z_m) for p in target.points])
    put = project(found.localisation.camera_from_target @ places, intrinsics)
    canvas.dots(canvas.at(np.array([(p.u, p.v) for p in seen.values()])), USED_RGB, 4.0)
    canvas.crosses(canvas.at(put[np.isfinite(put).all(axis=1)]), CIRCLE_RGB, 5.0)


def edge_fit(located: Localisation) -> CircleFit | None:
    """The edge points behind a pose; None where it rests on something else."""
    fit = None if located.evidence is None else located.evidence.circles
    return fit if isinstance(fit, CircleFit) else None


def draw_axes(
    canvas: Canvas, intrinsics: CameraIntrinsics, target: Target, located: Localisation
) -> None:
    """The target frame, half a board long, and the other fold's normal, dashed."""
    reach = target.board_side_m / 2
    other = located.alternative
    if other is not None:
        ends = canvas.at(project(other @ np.array([[0.0, 0, 0], [reach, 0, 0]]), intrinsics))
        canvas.dashes(ends, OTHER_FOLD_RGB, width=2)
    points = np.concatenate([np.zeros((1, 3)), reach * np.eye(3)])
    center, *tips = canvas.at(project(located.camera_from_target @ points, intrinsics))
    # farthest first, so that what comes towards the camera lies on top
    depths = (located.camera_from_target.rotation[2]).tolist()
    for i in sorted(range(3), key=lambda i: -depths[i]):
        name, color = AXES[i]
        canvas.arrow(center, tips[i], color)
        if np.isfinite(tips[i]).all():
            canvas.text(name, (float(tips[i][0]) + 5, float(tips[i][1]) + 4), color, 10.0)


def draw_covariance(canvas: Canvas, intrinsics: CameraIntrinsics, located: Localisation) -> None:
    """Where the target's centre is with 95 %."""
    outline = canvas.at(covariance_px(intrinsics, located))
    canvas.line(outline, COVARIANCE_RGB, width=1, closed=True, halo=True)


def circle_px(intrinsics: CameraIntrinsics, pose: Pose, radius_m: float) -> Array:
    """The pixels (N, 2) of a circle on the board."""
    angle = np.linspace(0, 2 * math.pi, 180, endpoint=False)
    rim = np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)
    return project(pose @ (radius_m * rim), intrinsics)


def covariance_px(intrinsics: CameraIntrinsics, located: Localisation) -> Array:
    """Pixels (N, 2) around the target's centre within which it lies with 95 %; to first order."""
    center = located.camera_from_target.translation
    step = 1e-4 * float(center[2])
    ahead, behind = (project(center + s * step * np.eye(3), intrinsics) for s in (1.0, -1.0))
    jacobian = ((ahead - behind) / (2 * step)).T  # (2, 3)
    return project(center[None], intrinsics) + ellipse(
        jacobian @ located.covariance[:3, :3] @ jacobian.T
    )


def ellipse(covariance: Array) -> Array:
    """Outline (N, 2) of 95 % of a two-dimensional Gaussian about zero."""
    if not np.isfinite(covariance).all():
        return np.full((1, 2), np.nan)
    values, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    angle = np.linspace(0, 2 * math.pi, 72, endpoint=False)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(unit * np.sqrt(CHI_SQUARE_95 * np.maximum(values, 0.0)) @ axes.T)


def _corners(canvas: Canvas, box: Box) -> Array:
    x0, y0, x1, y1 = box.x0, box.y0, box.x1, box.y1
    return canvas.at(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))


def _label(canvas: Canvas, box: Box, words: str, color: Rgb, height: float) -> None:
    """Above the box, or inside it where the picture ends."""
    x, y = canvas.at(np.array([box.x0, box.y0])).tolist()
    height_px, width_px = canvas.pixels.shape[:2]
    end = canvas.at(np.array([box.x1, box.y1]))
    # false for NaN, too
    if not (x < width_px and y < height_px and end[0] > 0 and end[1] > 0):
        return
    above = y - 4 if y - 4 - height > 0 else y + height + 4
    canvas.text(words, (max(x, 2.0), min(max(above, height), height_px - 2)), color, height)
