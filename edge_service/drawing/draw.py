"""The whole sheet: the picture with what was found, the target enlarged, how sure it is, a legend.

A sheet has about the same size whatever the picture's: small ones are enlarged and large ones
reduced, so that lines and words stay readable.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from edge_service.drawing.canvas import (
    BACKGROUND,
    FOREGROUND,
    Canvas,
    Rgb,
    wrapped,
)
from edge_service.drawing.findings import Findings
from edge_service.drawing.insets import draw_across, draw_range, draw_tilt
from edge_service.drawing.reasons import in_words
from edge_service.drawing.scene import (
    AXES,
    BOX_RGB,
    CIRCLE_RGB,
    COVARIANCE_RGB,
    OTHER_FOLD_RGB,
    OUTLIER_RGB,
    USED_RGB,
    circle_px,
    draw_axes,
    draw_boxes,
    draw_circles,
    draw_covariance,
    draw_edge_points,
    draw_points,
    edge_fit,
)
from edge_service.pipeline import Output
from rgbd_wire.camera import CameraIntrinsics
from target_pose.candidate import Box
from target_pose.localisation import Localisation, RollSource
from target_pose.residuals import spread, tilt_rad
from target_pose.target import Level, Target

Array: TypeAlias = NDArray[np.float64]

PICTURE_PX = (1600, 960)
"""Width and height into which the picture is fitted on the sheet."""
PANEL_PX = 460
MARGIN_PX = 16
FOOT_PX = 52
ZOOM_BOARDS = 1.5
"""Side of the enlarged part over that of the board's outline."""
MIN_ZOOM_SIDE_PX = 24.0
RANGE_PX, SIDE_PX = 132, 190
LEGEND_LINE_PX = 19
WORDS_PX = 12.0


def draw(
    color_rgb: NDArray[np.uint8], intrinsics: CameraIntrinsics, target: Target, findings: Findings
) -> NDArray[np.uint8]:
    """The sheet of one picture.

    Args:
        color_rgb: (H, W, 3).
        intrinsics: of the colour camera.
        target: what was looked for.
        findings: the boxes, and the pose or why there is none.

    Returns:
        (H', W', 3), of about 1780 x 1010 px for a picture of 4:3.
    """
    found = findings.output.found
    located = None if found is None else found.localisation
    chosen = {} if found is None else dict(found.candidate.boxes)
    height, width = color_rgb.shape[:2]
    scale = min(PICTURE_PX[0] / width, PICTURE_PX[1] / height)
    shown = (max(round(height * scale), 1), max(round(width * scale), 1))
    panel_height = _panel_height(located)
    sheet = np.empty(
        (max(shown[0] + FOOT_PX, panel_height), shown[1] + PANEL_PX + 2 * MARGIN_PX, 3), np.uint8
    )
    sheet[:] = BACKGROUND
    main = Canvas(sheet[: shown[0], : shown[1]], scale=scale)
    main.pixels[:] = _resized(color_rgb, shown, scale)
    _paint(main, intrinsics, target, findings, chosen, points=_is_large(chosen, scale))
    left = shown[1] + MARGIN_PX
    _draw_panel(sheet[:, left : left + PANEL_PX], color_rgb, intrinsics, target, findings, chosen)
    for n, line in enumerate(_foot(located, findings.output, shown[1] - 2 * MARGIN_PX)):
        at = (MARGIN_PX, shown[0] + 20 + 20 * n)
        Canvas(sheet).text(line, at, height=WORDS_PX + 1, halo=False)
    return sheet


def _panel_height(located: Localisation | None) -> int:
    rows = len(_legend(located)) * LEGEND_LINE_PX + 2 * MARGIN_PX
    if located is None:
        return rows + 10 * LEGEND_LINE_PX
    return PANEL_PX + RANGE_PX + SIDE_PX + 3 * MARGIN_PX + rows


def _draw_panel(
    panel: NDArray[np.uint8],
    color_rgb: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    target: Target,
    findings: Findings,
    chosen: dict[Level, Box],
) -> None:
    """Beside the picture, from the top down."""
    top = MARGIN_PX
    found = findings.output.found
    located = None if found is None else found.localisation
    if located is not None:
        zoom = _zoom(color_rgb, intrinsics, target, located, PANEL_PX)
        _paint(zoom, intrinsics, target, findings, chosen, points=True)
        panel[:PANEL_PX] = zoom.pixels
        top += PANEL_PX
        draw_range(Canvas(panel[top : top + RANGE_PX]), located)
        top += RANGE_PX + MARGIN_PX
        half = (PANEL_PX - MARGIN_PX) // 2
        draw_tilt(Canvas(panel[top : top + SIDE_PX, :half]), located)
        draw_across(Canvas(panel[top : top + SIDE_PX, half + MARGIN_PX :]), located)
        top += SIDE_PX + MARGIN_PX
    else:
        top = _draw_reason(Canvas(panel), top, findings.output)
    _draw_legend(Canvas(panel), top, located)


def _paint(
    canvas: Canvas,
    intrinsics: CameraIntrinsics,
    target: Target,
    findings: Findings,
    chosen: dict[Level, Box],
    *,
    points: bool,
) -> None:
    draw_boxes(canvas, findings.detections, chosen)
    found = findings.output.found
    if found is None:
        return
    draw_circles(canvas, intrinsics, target, found.localisation)
    if points:
        draw_edge_points(canvas, intrinsics, found.localisation)
    draw_points(canvas, intrinsics, target, found)
    draw_axes(canvas, intrinsics, target, found.localisation)
    draw_covariance(canvas, intrinsics, found.localisation)


def _is_large(chosen: dict[Level, Box], scale: float) -> bool:
    """Edge points on the picture itself are worth it, and do not cover the target."""
    return any(max(box.size_px) * scale > 300 for box in chosen.values())


def _zoom(
    color_rgb: NDArray[np.uint8],
    intrinsics: CameraIntrinsics,
    target: Target,
    located: Localisation,
    side: int,
) -> Canvas:
    """The target enlarged (or reduced) to a square of ``side``; grey where the picture ends."""
    # as large a circle as the board's corners lie on
    rim = circle_px(intrinsics, located.camera_from_target, target.board_side_m / math.sqrt(2))
    height, width = color_rgb.shape[:2]
    rim = rim[np.isfinite(rim).all(axis=1)]
    if not len(rim):
        rim = np.array([[0.0, 0.0], [width - 1.0, height - 1.0]])
    rim = np.clip(rim, (-width, -height), (2 * width, 2 * height))
    low, high = rim.min(axis=0), rim.max(axis=0)
    reach = max(float((high - low).max()), MIN_ZOOM_SIDE_PX) * ZOOM_BOARDS / math.sqrt(2) / 2
    center = (low + high) / 2
    scale = side / (2 * reach)
    # pixel centres: canvas 0 shows origin - 0.5 + 0.5 / scale
    origin = center - reach + 0.5
    to_picture = np.array(
        [
            [1 / scale, 0.0, origin[0] + 0.5 / scale - 0.5],
            [0.0, 1 / scale, origin[1] + 0.5 / scale - 0.5],
        ]
    )
    source = color_rgb
    if scale < 1:
        # averaged first: taking every so-manieth pixel would draw patterns that are not there
        source = cv2.blur(color_rgb, (max(round(1 / scale), 1),) * 2)
    pixels = cv2.warpAffine(
        source,
        to_picture,
        (side, side),
        flags=(cv2.INTER_CUBIC if scale < 4 else cv2.INTER_NEAREST) | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(60, 60, 64),
    )
    return Canvas(np.asarray(pixels, np.uint8), (float(origin[0]), float(origin[1])), scale)


def _resized(
    color_rgb: NDArray[np.uint8], shape: tuple[int, int], scale: float
) -> NDArray[np.uint8]:
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(color_rgb, shape[::-1], interpolation=way), np.uint8)


def _draw_reason(canvas: Canvas, top: int, output: Output) -> int:
    """Why there is no target; returns where the next thing may begin."""
    words = f"no target: {output.outcome.value}"
    canvas.text(words, (0, top + 14), (255, 190, 90), 15.0, halo=False)
    top += 2 * LEGEND_LINE_PX
    for line in wrapped(in_words(output), WORDS_PX, PANEL_PX)[:6]:
        canvas.text(line, (0, top + 12), FOREGROUND, WORDS_PX, halo=False)
        top += LEGEND_LINE_PX
    return top + LEGEND_LINE_PX


def _legend(located: Localisation | None) -> list[tuple[str, Rgb, str]]:
    """Kind of mark, colour and meaning."""
    rows: list[tuple[str, Rgb, str]] = [
        ("box", color, f"box of {level.value}, with its score") for level, color in BOX_RGB.items()
    ]
    if located is None:
        return rows
    if located.roll_source is RollSource.POINTS:
        rows.append(("dot", USED_RGB, "labelled points, where the net saw them"))
        rows.append(("cross", CIRCLE_RGB, "where the pose puts them"))
    else:
        rows.append(("line", CIRCLE_RGB, "printed circles, projected with the pose"))
    fit = edge_fit(located)
    if fit is not None:
        used = int(np.count_nonzero(fit.inliers))
        left_out = len(fit.inliers) - used
        rows.append(("dot", USED_RGB, f"edge points used: {used}"))
        rows.append(("cross", OUTLIER_RGB, f"edge points left out: {left_out}"))
    if located.picture_points:
        rows.append(("none", FOREGROUND, f"small: {located.picture_points} pixels were fitted"))
    rows.append(("line", AXES[0][1], "x of the target, out of the board (the normal)"))
    rows.append(("line", AXES[1][1], "y, to the viewer's right"))
    rows.append(("line", AXES[2][1], "z, up along the board"))
    if located.alternative is not None:
        words = "AMBIGUOUS: this fold fits as well" if located.ambiguous else "normal, other fold"
        rows.append(("dashes", OTHER_FOLD_RGB, words))
    rows.append(("ring", COVARIANCE_RGB, "centre, 95 %"))
    return rows


def _draw_legend(canvas: Canvas, top: int, located: Localisation | None) -> None:
    for kind, color, words in _legend(located):
        y = top + LEGEND_LINE_PX / 2
        ends = np.array([[2.0, y], [30.0, y]])
        match kind:
            case "box":
                box = np.array([[6.0, y - 6], [26.0, y - 6], [26.0, y + 6], [6.0, y + 6]])
                canvas.line(box, color, width=2, closed=True)
            case "dot":
                canvas.dots(np.array([[16.0, y]]), color, 2.5)
            case "cross":
                canvas.crosses(np.array([[16.0, y]]), color, 4.0)
            case "ring":
                angle = np.linspace(0, 2 * math.pi, 40)
                ring = np.stack([16 + 10 * np.cos(angle), y + 5 * np.sin(angle)], axis=1)
                canvas.line(ring, color, closed=True)
            case "none":
                pass
            case "dashes":
                canvas.dashes(ends, color, width=2)
            case _:
                canvas.line(ends, color, width=2)
        canvas.text(words, (42, y + 5), FOREGROUND, WORDS_PX, halo=False)
        top += LEGEND_LINE_PX


def _foot(located: Localisation | None, output: Output, width: int) -> list[str]:
    """One line that says it all; broken in two on a narrow sheet."""
    if located is None:
        words = f"{output.outcome.value}: {in_words(output)}"
    else:
        s = spread(located)
        position = located.camera_from_target.translation
        range_m = math.sqrt(float(position @ position))
        words = (
            f"range {range_m:.4f} m +- {1000 * s.range_m:.1f} mm, "
            f"across +- {1000 * s.across_m:.1f} mm, "
            f"tilt {math.degrees(tilt_rad(located)):.1f} deg, "
            f"normal +- {math.degrees(s.normal_rad):.2f} deg, "
            f"roll +- {math.degrees(s.roll_rad):.1f} deg by {located.roll_source.value}, "
            f"method {located.method.value}"
            + (", AMBIGUOUS" if located.ambiguous else "")
            + (", DEPTH CONTRADICTS" if located.depth_contradicts else "")
            + " (each 1 sigma)"
        )
    return wrapped(words, WORDS_PX + 1, width)[:2]
