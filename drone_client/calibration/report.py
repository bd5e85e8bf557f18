"""A calibration's outcome: as JSON for scripts, as a table for people, as a picture."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from drone_client.calibration.sighting import Miss, Sighting
from drone_client.calibration.verdicts import AGREEMENT, Finding, Judgement
from drone_client.errors import OutputError
from rgbd_wire.geometry import Pose

STYLES = {Finding.GOOD: "green", Finding.OFF: "bold red", Finding.UNKNOWN: "yellow"}
QUANTITIES = (
    "scale",
    "shift_right_m",
    "shift_down_m",
    "shift_forward_m",
    "turn_right_rad",
    "turn_down_rad",
    "turn_forward_rad",
)
"""Of the rig's errors, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was looked at, and what it says."""

    recording: str
    target: str
    sightings: tuple[Sighting, ...]
    misses: tuple[Miss, ...]
    judgement: Judgement


def as_json(c: Calibration) -> dict[str, Any]:
    """Everything, for scripts."""
    errors = c.judgement.errors
    return {
        "recording": c.recording,
        "target": c.target,
        "finding": c.judgement.finding.value,
        "frames": len(c.sightings) + len(c.misses),
        "sightings": len(c.sightings),
        "misses": dict(Counter(m.reason for m in c.misses)),
        "range_m": _ends([s.circles.range_m for s in c.sightings]),
        "tilt_deg": _ends([math.degrees(s.circles.tilt_rad) for s in c.sightings]),
        "verdicts": [asdict(v) for v in c.judgement.verdicts],
        "rig_errors": None
        if errors is None
        else {
            "frame": "camera",
            "names": list(QUANTITIES),
            "estimate": errors.estimate.tolist(),
            "covariance": errors.covariance.tolist(),
        },
        "per_frame": [
            {
                "name": s.name,
                "range_m": s.circles.range_m,
                "tilt_deg": math.degrees(s.circles.tilt_rad),
                "depth_over_circles": s.ratio,
            }
            for s in c.sightings
        ],
    }


def print_table(c: Calibration, console: Console) -> None:
    """The verdicts, and what the frames were good for."""
    table = Table(show_header=False, box=None, pad_edge=False)
    for v in c.judgement.verdicts:
        words = Text(v.says)
        if v.do:
            words.append(f"\n-> {v.do}")
        table.add_row(Text(v.name, style="bold"), Text(v.finding, style=STYLES[v.finding]), words)
    console.print(table)
    off = [v for v in c.judgement.verdicts if v.finding is Finding.OFF and v.name != AGREEMENT]
    if len(off) > 1:
        console.print(
            Text("several are off: put the surest right, then run again; one may show as another")
        )
    console.print(Text(_frames(c)))


def plot_calibration(path: Path, c: Calibration, color_from_depth: Pose) -> None:
    """Both opinions over range and tilt, as a PNG.

    Raises:
        OutputError: it cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    FigureCanvasAgg(figure)
    gaps, normals = figure.subplots(2, 1)
    ranges = np.array([s.circles.range_m for s in c.sightings])
    ratios = np.array([s.ratio for s in c.sightings])
    gaps.plot(ranges, 100 * (ratios - 1), ".", color="tab:blue", label="one frame")
    gaps.axhline(0.0, color="black", lw=0.8)
    if c.judgement.errors is not None:
        _plot_fit(gaps, c, ranges)
    gaps.set_xlabel("range by the circles [m]")
    gaps.set_ylabel("%")
    gaps.set_title(f"{c.recording}: depth over circles", fontsize=9, loc="left")
    seen = [s for s in c.sightings if s.plane is not None]
    tilts = [math.degrees(s.circles.tilt_rad) for s in seen]
    for axis, name, color in ((0, "right", "tab:orange"), (1, "down", "tab:green")):
        leans = [
            math.degrees(
                float((color_from_depth.rotation @ s.plane.normal - s.circles.normal)[axis])
            )
            for s in seen
            if s.plane is not None
        ]
        normals.plot(tilts, leans, ".", color=color, label=f"leans {name}")
    normals.axhline(0.0, color="black", lw=0.8)
    normals.set_xlabel("tilt by the circles [deg]")
    normals.set_ylabel("deg")
    normals.set_title("normal by depth less normal by circles", fontsize=9, loc="left")
    for axes in (gaps, normals):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    lines = [f"{v.name}: {v.finding.value}: {v.says}" for v in c.judgement.verdicts]
    figure.suptitle("\n".join(lines), fontsize=8, x=0.01, ha="left")
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        figure.savefig(part, dpi=110, format="png")
        os.replace(part, path)
    except OSError as error:
        raise OutputError(f"--plot {path}: {error.strerror or error}") from None
    finally:
        part.unlink(missing_ok=True)


def check_plot_path(path: Path) -> None:
    """Tell before the work starts whether the picture could be written.

    Raises:
        OutputError: it could not.
    """
    if path.suffix.lower() != ".png":
        raise OutputError(f"--plot {path}: must end in .png")
    if path.is_dir():
        raise OutputError(f"--plot {path}: is a folder")
    if not path.parent.is_dir():
        raise OutputError(f"--plot {path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise OutputError(f"--plot {path}: the folder {path.parent} cannot be written to")


def _plot_fit(axes: Any, c: Calibration, ranges: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    """What scale and forward shift make of the ratio, for a target straight ahead."""
    errors = c.judgement.errors
    assert errors is not None
    r = np.linspace(0.9 * ranges.min(), 1.1 * ranges.max(), 100)
    scale, forward = float(errors.estimate[0]), float(errors.estimate[3])
    label = f"fit: {100 * scale:+.2f} % and {1000 * forward:+.1f} mm"
    axes.plot(r, 100 * (scale + forward / r), color="tab:red", lw=1, label=label)


def _frames(c: Calibration) -> str:
    reasons = ", ".join(
        f"{n} {reason}" for reason, n in Counter(m.reason for m in c.misses).items()
    )
    text = f"{len(c.sightings)} of {len(c.sightings) + len(c.misses)} frames used"
    if c.sightings:
        tilts = [math.degrees(s.circles.tilt_rad) for s in c.sightings]
        ranges = [s.circles.range_m for s in c.sightings]
        text += (
            f", {min(ranges):.2f} to {max(ranges):.2f} m, tilts {min(tilts):.0f} to "
            f"{max(tilts):.0f} deg"
        )
    return text + (f"; not used: {reasons}" if reasons else "")


def _ends(values: Sequence[float]) -> list[float] | None:
    return [min(values), max(values)] if values else None
