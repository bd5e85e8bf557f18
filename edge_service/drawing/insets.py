"""Beside the picture: range along the line of sight, tilt from the side, centre across it."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from edge_service.drawing.canvas import FAINT, FOREGROUND, Canvas, Rgb, text_width
from edge_service.drawing.scene import (
    AXES,
    CIRCLE_RGB,
    COVARIANCE_RGB,
    OTHER_FOLD_RGB,
    ellipse,
)
from target_pose.localisation import Localisation, Method
from target_pose.residuals import Residuals, residuals, spread, tilt_rad
from target_pose.vectors import orthogonal_to, unit

Array: TypeAlias = NDArray[np.float64]

PLANE_RGB: Rgb = (120, 200, 255)
LINE_PX = 11.0
TITLE_PX = 12.0
SIGMAS = 2.0


def draw_range(canvas: Canvas, located: Localisation) -> None:
    """Range with +- 2 sigma, of the pose and of each source alone, on one scale."""
    r = residuals(located)
    rows = _range_rows(located, r)
    width = canvas.pixels.shape[1]
    canvas.text(
        "range along the line of sight, +- 2 sigma", (0, TITLE_PX), height=TITLE_PX, halo=False
    )
    low = min(range_m - SIGMAS * sigma for _, _, range_m, sigma in rows)
    high = max(range_m + SIGMAS * sigma for _, _, range_m, sigma in rows)
    left, right = 80.0, width - 96.0
    middle, span = (low + high) / 2, max(high - low, 1e-6) * 1.1

    def x(range_m: float) -> float:
        return float(left + (range_m - middle + span / 2) / span * (right - left))

    top = 40.0
    for n, (name, color, range_m, sigma) in enumerate(rows):
        y = top + n * 24.0
        canvas.text(name, (0, y + 4), color, LINE_PX, halo=False)
        _whisker(
            canvas, (x(range_m - SIGMAS * sigma), x(range_m), x(range_m + SIGMAS * sigma)), y, color
        )
        canvas.text(f"{range_m:.4f} m", (right + 12, y + 4), color, LINE_PX, halo=False)
    y = top + len(rows) * 24.0 + 2
    bar = _round_length(span / 3)
    ends = np.array([[left, y], [left + bar / span * (right - left), y]])
    canvas.line(ends, FAINT, width=2)
    words = f"{_millimetres(bar)}" + _apart(r)
    canvas.text(words, (float(ends[1, 0]) + 8, y + 5), FAINT, LINE_PX, halo=False)


def draw_tilt(canvas: Canvas, located: Localisation) -> None:
    """The board from the side with its normal, within a cone of 2 sigma, and the other fold."""
    canvas.text("tilt, +- 2 sigma", (0, TITLE_PX), height=TITLE_PX, halo=False)
    height, width = canvas.pixels.shape[:2]
    center = np.array([0.62 * width, 0.56 * height])
    reach = 0.42 * min(height - 2 * TITLE_PX, width)
    tilt, sigma = tilt_rad(located), spread(located).normal_rad

    def towards(angle: float) -> Array:
        # the camera is on the left; positive angles lean up
        return np.array([-reach * math.cos(angle), -reach * math.sin(angle)])

    eye = np.array([8.0, center[1]])
    canvas.line(np.stack([eye, center]), FAINT)
    canvas.dots(eye[None], FAINT, 4.0)
    canvas.text("camera", (2, float(center[1]) + 18), FAINT, 10.0, halo=False)
    half = min(SIGMAS * sigma, math.pi / 2)
    fan = np.stack([towards(a) for a in np.linspace(tilt - half, tilt + half, 24)])
    canvas.area(np.concatenate([center[None], center + fan]), AXES[0][1], 0.35)
    along = towards(tilt + math.pi / 2) * 0.8
    canvas.line(np.stack([center - along, center + along]), FOREGROUND, width=3)
    if located.alternative is not None:
        other = _other_tilt(located)
        canvas.dashes(np.stack([center, center + towards(other)]), OTHER_FOLD_RGB, width=2)
        far = towards(other + math.pi / 2) * 0.8
        canvas.dashes(np.stack([center - far, center + far]), OTHER_FOLD_RGB)
    canvas.arrow(center, center + towards(tilt), AXES[0][1])
    words = f"{math.degrees(tilt):.1f} +- {math.degrees(SIGMAS * sigma):.1f} deg"
    canvas.text(words, (0, height - 6), FOREGROUND, LINE_PX, halo=False)


def draw_across(canvas: Canvas, located: Localisation) -> None:
    """The 95 % ellipse of the centre across the line of sight, in millimetres."""
    canvas.text("centre across it, 95 %", (0, TITLE_PX), height=TITLE_PX, halo=False)
    height, width = canvas.pixels.shape[:2]
    center = np.array([0.5 * width, 0.52 * height])
    basis = _right_and_down(located)
    outline = ellipse(basis @ located.covariance[:3, :3] @ basis.T)
    if not np.isfinite(outline).all():
        return
    room = 0.5 * min(height - 4 * TITLE_PX, width)
    px_per_m = 0.85 * room / max(float(np.abs(outline).max()), 1e-9)
    for arm in (np.array([room, 0.0]), np.array([0.0, room])):
        canvas.line(np.stack([center - arm, center + arm]), FAINT)
    canvas.area(center + px_per_m * outline, COVARIANCE_RGB, 0.25)
    canvas.line(center + px_per_m * outline, COVARIANCE_RGB, closed=True)
    bar = _round_length(0.8 * room / px_per_m)
    y = height - 10.0
    canvas.line(np.array([[0.0, y], [bar * px_per_m, y]]), FAINT, width=2)
    words = _millimetres(bar)
    if bar * px_per_m + 8 + text_width(words, LINE_PX) < width:
        canvas.text(words, (bar * px_per_m + 8, y + 5), FAINT, LINE_PX, halo=False)


def _range_rows(located: Localisation, r: Residuals | None) -> list[tuple[str, Rgb, float, float]]:
    """Name, colour, range and sigma (0: not known) of each source, the pose first."""
    position = located.camera_from_target.translation
    range_m = math.sqrt(float(position @ position))
    rows = [("pose", FOREGROUND, range_m, spread(located).range_m)]
    if located.range_ellipse_m is not None:
        sigma = 0.0 if r is None else r.range_ellipse_sigma_m
        name = "points" if located.method is Method.PNP else "circles"
        rows.append((name, CIRCLE_RGB, located.range_ellipse_m, sigma))
    if located.range_plane_m is not None:
        sigma = 0.0 if r is None else r.range_plane_sigma_m or 0.0
        rows.append(("depth", PLANE_RGB, located.range_plane_m, sigma))
    return rows


def _whisker(canvas: Canvas, x: tuple[float, float, float], y: float, color: Rgb) -> None:
    if x[2] > x[0]:
        canvas.line(np.array([[x[0], y], [x[2], y]]), color, width=2)
        for end in (x[0], x[2]):
            canvas.line(np.array([[end, y - 5], [end, y + 5]]), color, width=2)
    canvas.dots(np.array([[x[1], y]]), color, 4.0)


def _apart(r: Residuals | None) -> str:
    if r is None or r.ranges_apart_sigmas is None:
        return ""
    return f"    circles and depth {abs(r.ranges_apart_sigmas):.1f} sigma apart"


def _other_tilt(located: Localisation) -> float:
    """The other fold's tilt in the plane in which the first one leans, signed."""
    assert located.alternative is not None
    pose, other = located.camera_from_target, located.alternative
    line = -unit(pose.translation)
    leaning = pose.rotation[:, 0] - (pose.rotation[:, 0] @ line) * line
    if float(leaning @ leaning) < 1e-12:
        return 0.0
    normal = other.rotation[:, 0]
    return math.atan2(float(normal @ unit(leaning)), float(normal @ line))


def _right_and_down(located: Localisation) -> Array:
    """Unit vectors (2, 3) across the line of sight, as near to the picture's axes as may be."""
    line = unit(located.camera_from_target.translation)
    right = np.array([1.0, 0.0, 0.0]) - line[0] * line
    if float(right @ right) < 1e-6:
        right = orthogonal_to(line)[0]
    right = unit(right)
    return np.stack([right, np.cross(line, right)])


def _round_length(length_m: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is no longer."""
    power = 10.0 ** math.floor(math.log10(max(length_m, 1e-9)))
    return max(m * power for m in (1, 2, 5) if m * power <= length_m * (1 + 1e-9))


def _millimetres(length_m: float) -> str:
    return f"{1000 * length_m:g} mm" if length_m < 1 else f"{length_m:g} m"
