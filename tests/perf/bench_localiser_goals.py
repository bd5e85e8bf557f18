"""The figures that the localiser has to reach, and whether it does."""

from __future__ import annotations

from typing import Any

GOALS: dict[str, dict[float, tuple[float, float | None]]] = {
    "nominal": {0.6: (0.3, 0.1), 1.2: (0.7, 0.1), 2.5: (2, 0.1), 4.0: (5, 0.15), 6.0: (18, 0.5)},
    "blur": {0.6: (0.3, None), 1.2: (0.9, None), 2.5: (4, 0.4), 4.0: (11, 0.7), 6.0: (45, 3)},
    "low light": {0.6: (0.4, None), 1.2: (1.3, None), 2.5: (5, 0.6), 4.0: (15, 1.5), 6.0: (50, 4)},
}
"""Most median error of position [mm] and normal [deg], by condition and distance [m]."""
TAIL, TAIL_UP_TO_M = 4.0, 4.0
"""The 95th percentile over the median is at most this, up to this distance."""
CALIBRATION_POINTS = 0.05
P50_MS = 6.0
REAL_MM, REAL_DEG = 8.0, 1.5

Row = tuple[str, str, str, str]
"""What, goal, measured, verdict."""


def goals(result: dict[str, Any]) -> list[Row]:
    """Of the parts that were measured."""
    rows: list[Row] = []
    if "accuracy" in result:
        rows += _accuracy(result["accuracy"]) + _calibration(result["accuracy"]["calibration"])
    if "flips" in result:
        flips = result["flips"]
        measured = f"{flips['count']} in {flips['poses']} poses"
        if flips["assumed"]:
            measured += f", and {flips['assumed']} by box, which takes the board to face the camera"
        rows.append(_row("normal over 30 deg off, not said", "none", measured, not flips["count"]))
    if "side_by_side" in result:
        rows += _markers(result["side_by_side"])
    if "occlusion" in result:
        occlusion = result["occlusion"]
        measured = f"{len(occlusion['uncovered'])} of {occlusion['localised']} neither"
        met = not occlusion["uncovered"]
        rows.append(_row("occluded: refused, or covered at 99.9 %", "every pose", measured, met))
    if speed := result.get("speed"):
        p50 = speed[0]["p50_ms"]
        ratios = [f"{r['ratio']:.2f} of {r['name']}'s" for r in speed[1:]]
        measured = (
            f"{p50:.2f} ms ({speed[0]['cpu_p50_ms']:.2f} of the processor's); {', '.join(ratios)}"
        )
        what = "time per frame, one core, p50"
        rows.append(_row(what, f"<= {P50_MS:g} ms", measured, p50 <= P50_MS))
    if real := result.get("real"):
        rows += _real(next(iter(real.values())))
    return rows


def missed_cells(cells: list[dict[str, Any]], figure: str) -> list[str]:
    """Cells whose median is over its goal."""
    missed = []
    for cell in cells:
        goal = GOALS[cell["condition"]][cell["distance_m"]][figure != "position_mm"]
        if goal is not None and (cell[figure] is None or cell[figure]["median"] > goal):
            missed.append(f"{cell['condition']} {cell['distance_m']:g} m")
    return missed


def _accuracy(part: dict[str, Any]) -> list[Row]:
    cells = part["cells"]
    rows = []
    for figure, what in (("position_mm", "position"), ("normal_deg", "normal")):
        wanted = [
            c for c in cells if GOALS[c["condition"]][c["distance_m"]][figure != "position_mm"]
        ]
        missed = missed_cells(wanted, figure)
        measured = f"in {len(wanted) - len(missed)} of {len(wanted)}{_not(missed)}"
        rows.append(_row(f"median {what} error", "in every cell", measured, not missed))
        near = [c for c in cells if c["distance_m"] <= TAIL_UP_TO_M and c[figure]]
        missed = [
            f"{c['condition']} {c['distance_m']:g} m"
            for c in near
            if c[figure]["p95"] > TAIL * c[figure]["median"]
        ]
        measured = f"in {len(near) - len(missed)} of {len(near)}{_not(missed)}"
        what = f"p95 of {what} at most {TAIL:g} x the median"
        rows.append(_row(what, f"every cell to {TAIL_UP_TO_M:g} m", measured, not missed))
    return rows


def _calibration(groups: dict[str, Any]) -> list[Row]:
    rows = []
    for part in ("position", "normal", "roll"):
        drawn = {name: row for name, row in groups.items() if "exactly" not in name}
        beyond = [name for name, row in drawn.items() if not _is_calibrated(row[part])]
        shares = groups["all"][part]["inside"].values()
        measured = " / ".join("-" if s is None else f"{100 * s['value']:.1f}" for s in shares)
        what = f"covariance of the {part}: inside 50 / 95 / 99 %"
        met = "all" not in beyond
        rows.append(_row(what, "+- 5 points, overall", measured + _not(beyond), met))
    return rows


def _is_calibrated(row: dict[str, Any]) -> bool:
    """Each level holds about as many errors as it says."""
    return all(
        share is not None and abs(share["value"] - float(level)) <= CALIBRATION_POINTS
        for level, share in row["inside"].items()
    )


def _markers(rows: list[dict[str, Any]]) -> list[Row]:
    goals_met = []
    for figure, what in (("position_mm", "position"), ("normal_deg", "normal")):
        pairs = [(r, r["apriltag"][figure]) for r in rows if r["apriltag"]["both"]]
        worse = [
            f"{r['condition']} {r['distance_m']:g} m"
            for r, pair in pairs
            if pair["ours"]["median"] > pair["theirs"]["median"]
        ]
        measured = f"in {len(pairs) - len(worse)} of {len(pairs)}{_not(worse)}"
        what = f"median {what} error no worse than AprilTag's"
        goals_met.append(_row(what, "in every cell", measured, not worse))
    fewer = [
        f"{r['condition']} {r['distance_m']:g} m"
        for r in rows
        if r["found"]["ours"] < r["found"]["apriltag"]
    ]
    measured = f"in {len(rows) - len(fewer)} of {len(rows)}{_not(fewer)}"
    goals_met.append(
        _row("found at least as often as AprilTag", "in every cell", measured, not fewer)
    )
    return goals_met


def _real(part: dict[str, Any]) -> list[Row]:
    rows = []
    for figure, unit, limit in (("position_mm", "mm", REAL_MM), ("normal_deg", "deg", REAL_DEG)):
        x = part[figure]
        measured = "-" if x is None else f"{x['median']:.2f} {unit} ({x['count']} frames)"
        met = x is not None and x["median"] < limit
        what = f"real recording, median of {figure.split('_')[0]}"
        rows.append(_row(what, f"< {limit:g} {unit}", measured, met))
    return rows


def _not(names: list[str]) -> str:
    return f" (not: {', '.join(names)})" if names else ""


def _row(what: str, goal: str, measured: str, met: bool) -> Row:
    return what, goal, measured, "met" if met else "missed"
