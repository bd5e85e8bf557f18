"""Pictures of the localiser's bench: calibration as a plot, and the worst poses to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from rgbd_wire.geometry import Array, Pose
from target_pose.lens import project
from target_pose.target import Target
from tests.perf.bench_localiser_errors import DEGREES_OF_FREEDOM
from tests.perf.bench_localiser_poses import CAMERA, View
from tests.perf.bench_localiser_summary import squared_errors
from tests.perf.bench_localiser_trial import Trial

SIDE_PX, BAND_PX = 720, 46
WHITE_RGB = (255, 255, 255)
TRUE_RGB, ESTIMATE_RGB = (40, 220, 60), (255, 60, 40)


def plot_calibration(groups: Mapping[str, Sequence[Trial]], out: Path) -> None:
    """Share of errors inside against the level that the covariance claims, by part and group."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, len(DEGREES_OF_FREEDOM), figsize=(15, 4.2), sharey=True)
    for panel, (part, freedom) in zip(panels, DEGREES_OF_FREEDOM.items(), strict=True):
        panel.plot([0, 1], [0, 1], color="0.7", linewidth=1)
        for name, trials in groups.items():
            claimed = np.sort(chi2.cdf(squared_errors(trials, part, drawn=True), freedom))
            if len(claimed):
                inside = np.arange(1, len(claimed) + 1) / len(claimed)
                panel.step(claimed, inside, where="post", label=f"{name} ({len(claimed)})")
        panel.set_title(f"{part}, {freedom} degree{'s' if freedom > 1 else ''} of freedom")
        panel.set_xlabel("level claimed by the covariance")
        panel.set_aspect("equal")
        panel.legend(fontsize=7, loc="lower right")
    panels[0].set_ylabel("share of poses inside\n(under the diagonal: too sure of itself)")
    figure.tight_layout()
    part_file = out.with_name(f"{out.stem}.part{out.suffix}")
    figure.savefig(part_file, dpi=130)
    plt.close(figure)
    part_file.replace(out)


def picture_of(trial: Trial, view: View, target: Target, title: str) -> NDArray[np.uint8]:
    """The board, enlarged, with the circles and the normal of truth and estimate drawn in."""
    x0, y0, x1, y1 = view.board_xyxy
    side = 1.5 * max(x1 - x0, y1 - y0, 24.0)
    scale = SIDE_PX / side
    # pixel (0, 0) counts from its centre, whatever the scale
    shift = np.array([(x0 + x1) / 2, (y0 + y1) / 2]) - side / 2
    into = np.array([[scale, 0, -scale * shift[0]], [0, scale, -scale * shift[1]]])
    seen = cv2.warpAffine(view.color_rgb, into, (SIDE_PX, SIDE_PX), flags=cv2.INTER_CUBIC)
    canvas = np.asarray(seen, np.uint8)
    for pose, colour in _poses(trial, view):
        for disc in target.discs:
            _draw(canvas, pose, _circle(disc.diameter_m / 2), colour, into)
        _draw(canvas, pose, np.array([[0.0, 0, 0], [target.board_side_m / 2, 0, 0]]), colour, into)
    canvas[:BAND_PX] //= 4
    for k, line in enumerate((title, _about(trial))):
        at = (8, 18 + 20 * k)
        cv2.putText(canvas, line, at, cv2.FONT_HERSHEY_SIMPLEX, 0.48, WHITE_RGB, 1, cv2.LINE_AA)
    return canvas


def _poses(trial: Trial, view: View) -> list[tuple[Pose, tuple[int, int, int]]]:
    poses = [(view.camera_from_target, TRUE_RGB)]
    if trial.estimate is not None:
        poses.append(
            (Pose(np.array(trial.estimate[:3]), np.array(trial.estimate[3:])), ESTIMATE_RGB)
        )
    return poses


def _circle(radius_m: float) -> Array:
    angle = np.linspace(0, 2 * np.pi, 121)
    return np.column_stack([np.zeros(121), radius_m * np.cos(angle), radius_m * np.sin(angle)])


def _draw(
    canvas: NDArray[np.uint8], pose: Pose, points: Array, colour: tuple[int, ...], into: Array
) -> None:
    """A line through points (N, 3) of the target's frame."""
    p = pose @ points
    if p[:, 2].min() <= 0.02:
        return
    uv = project(p, CAMERA.color) @ into[:, :2].T + into[:, 2]
    fixed = np.rint(np.clip(uv, -4000, 4000) * 16).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, colour, 1, cv2.LINE_AA, 4)


def _about(trial: Trial) -> str:
    if trial.squared is None:
        return f"refused: {trial.refusal}" if trial.found else "not found"
    return (
        f"{trial.method}{' (ambiguous)' if trial.ambiguous else ''}: {trial.position_mm:.1f} mm, "
        f"{trial.normal_deg:.2f} deg at a tilt of {trial.tilt_deg:.0f}; squared error: "
        f"position {trial.squared['position']:.1f}, normal {trial.squared['normal']:.1f}"
    )
