"""An evaluation as a folder: numbers for machines, tables and pictures for people."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector_training.datasets.output import new_folder
from detector_training.evaluation.figures import pr_curves, recall_by
from detector_training.evaluation.groups import By
from detector_training.evaluation.intervals import Interval
from detector_training.evaluation.operating_point import OperatingPoint
from detector_training.evaluation.run import Find
from detector_training.evaluation.scores import Report, Scores, outcomes_of
from detector_training.evaluation.worst import Case, draw_case, page, worst_cases
from edge_service.detector.detector import SCORE_THRESHOLD

HEADER = (
    "pictures",
    "truths",
    "AP50",
    "AP50-95",
    "recall",
    "false/picture",
    "pictures with false",
)
TITLES = {
    By.CONDITION: "By condition",
    By.RECIPE: "By recipe",
    By.DISTANCE: "By distance [m]",
    By.SIZE: "By width of the board [px]",
}


def write_report(
    out: Path, report: Report, finds: Sequence[Find], about: Mapping[str, Any]
) -> tuple[Case, ...]:
    """Write report.json, report.md, the figures and the worst cases into a new folder.

    Args:
        out: Folder; must not hold anything.
        report: The scores of ``finds``.
        finds: What the detector said.
        about: Weights, data and command, for the head of the report.

    Returns:
        The worst cases.

    Raises:
        DatasetError: the folder holds something already or cannot be written.
    """
    outcomes = outcomes_of(finds, report.counting)
    cases = worst_cases(finds, report.counting)
    with new_folder(out) as part:
        plain = {"about": dict(about), **report.as_json()}
        (part / "report.json").write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
        (part / "pr_curves.png").write_bytes(pr_curves(outcomes, report))
        (part / "recall_by_distance.png").write_bytes(recall_by(report, By.DISTANCE))
        (part / "recall_by_size.png").write_bytes(recall_by(report, By.SIZE))
        (part / "worst.png").write_bytes(_png(page(cases)))
        (part / "worst").mkdir()
        for k, case in enumerate(cases, 1):
            name = f"{k:02d}-{case.what}-{case.find.sample.image.stem}.png"
            (part / "worst" / name).write_bytes(_png(draw_case(case)))
        (part / "report.md").write_text(report_text(report, cases, about), encoding="utf-8")
    return cases


def report_text(report: Report, cases: Sequence[Case], about: Mapping[str, Any]) -> str:
    """The report as Markdown."""
    counting = report.counting
    lines = ["# Evaluation of a detector", ""]
    lines += [f"- {name}: {value}" for name, value in about.items()]
    lines += [
        "",
        f"{report.pictures} pictures. A target counts when its widest box is at least "
        f"{counting.min_px:g} px wide and a level when at least {counting.min_visible:.0%} of it "
        f"can be seen. Recall and false positives at score {SCORE_THRESHOLD} and IoU 0.5; "
        "`candidate` is what is left after the nesting check. In brackets: 95 % intervals, "
        "Wilson's for shares, the bootstrap's over pictures for AP.",
        "",
        f"**Operating point** (candidates): {operating_point_text(report.operating_point)}.",
        "",
        "![Precision and recall](pr_curves.png)",
        "![Recall by distance](recall_by_distance.png)",
        "![Recall by width](recall_by_size.png)",
    ]
    for by, rows in report.groups.items():
        if rows:
            lines += ["", f"## {TITLES[by]}", "", "| | | " + " | ".join(HEADER) + " |"]
            lines.append("| --- | --- |" + " ---: |" * len(HEADER))
        for name, row in rows.items():
            for what, s in row.items():
                lines.append(f"| {name} | {what} | " + " | ".join(cells(s)) + " |")
    lines += ["", "## Worst cases", "", "![Worst cases](worst.png)", ""]
    lines += [f"{k}. {case.find.sample.image}: {case.caption}" for k, case in enumerate(cases, 1)]
    return "\n".join(lines) + "\n"


def operating_point_text(point: OperatingPoint) -> str:
    """One line: the threshold, the recall, and how sure the rate is."""
    return (
        f"recall {share_text(point.recall)} at {point.allowed_per_1000:g} false positives per "
        f"1000 pictures (candidate score > {point.threshold:.3f}; {point.false_positives} in "
        f"{point.pictures} pictures, the rate is under {point.upper_bound_per_1000:.2g} per 1000 "
        "with 95 % confidence)"
    )


def cells(s: Scores) -> list[str]:
    """The values of one row, in the order of ``HEADER``."""
    return [
        str(s.pictures),
        str(s.truths),
        *(share_text(x) for x in (s.ap50, s.ap50_95, s.recall)),
        f"{s.false_per_picture:.4f}",
        share_text(s.pictures_with_false),
    ]


def share_text(x: Interval | None, form: str = "{:.3f} [{:.3f}, {:.3f}]") -> str:
    """A share with its interval; a dash where there is none."""
    return "-" if x is None else form.format(*x)


def _png(rgb: NDArray[np.uint8]) -> bytes:
    ok, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    assert ok
    return bytes(data)
