"""What a recording says about the rig, in sentences: good, off by how much, or not enough seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from drone_client.calibration.fit import SURE_TILT_RAD, RigErrors, corrected, fit_rig
from drone_client.calibration.sighting import PLAUSIBLE_RATIO, Sighting
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.geometry import Array
from target_pose.fusion import SIZE_SIGMA
from target_pose.plane import SCALE_SIGMA, TILT_SIGMA_RAD
from target_pose.target import Target

MIN_SIGHTINGS: Final = 5
TOLERATED_SHARE: Final = 2 * math.hypot(SCALE_SIGMA, SIZE_SIGMA)
"""Twice what the localiser takes a depth camera's scale and a print's size to be off by."""
TOLERATED_SHIFT_M: Final = 5e-3
"""The part of the safety filter's margin that does not grow with range (docs/cbf.md)."""
TOLERATED_TURN_RAD: Final = 2 * TILT_SIGMA_RAD
"""Twice what the localiser takes a depth picture to be warped by."""
TOLD_SHARE: Final = 6e-3
TOLD_SHIFT_M: Final = 6e-3
TOLD_TURN_RAD: Final = math.radians(0.6)
"""Standard deviations past which a quantity counts as not seen."""
SURE_SIGMAS: Final = 2.0
AGREEMENT: Final = "agreement"
NEAR_UNIT: Final = 0.03
UNITS: Final[dict[float, str]] = {
    0.001: "1 mm: RealSense D400 and Kinect",
    0.0001: "0.1 mm: RealSense D405",
    0.00025: "0.25 mm: RealSense L515",
    0.0002: "1/5000 m: TUM RGB-D data sets",
    0.01: "1 cm",
    0.0003048: "1/1000 ft",
    0.0000254: "1/1000 inch",
}
"""Depth units that are in use, in metres."""


class Finding(StrEnum):
    """What can be said of one quantity."""

    GOOD = "good"
    OFF = "off"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Verdict:
    """One quantity."""

    name: str
    finding: Finding
    says: str
    """With numbers."""
    do: str = ""
    """What to do about it; empty when it is good."""
    value: float | None = None
    sigma: float | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Everything that a recording says."""

    verdicts: tuple[Verdict, ...]
    errors: RigErrors | None
    """None where depth and circles have nothing to do with each other, or too little was seen."""

    @property
    def finding(self) -> Finding:
        """OFF if anything is; GOOD if at least circles and depth agree; else UNKNOWN."""
        findings = {v.finding for v in self.verdicts}
        return next((f for f in (Finding.OFF, Finding.GOOD) if f in findings), Finding.UNKNOWN)


def judge(sightings: Sequence[Sighting], camera: RgbdCamera, target: Target) -> Judgement:
    """The verdicts, the gravest first."""
    if len(sightings) < MIN_SIGHTINGS:
        return Judgement((_too_few(len(sightings)),), None)
    ratio = float(np.median([s.ratio for s in sightings]))
    planes = [s for s in sightings if s.plane is not None]
    if not 1 / PLAUSIBLE_RATIO < ratio < PLAUSIBLE_RATIO:
        return Judgement((_unit(ratio, len(sightings), camera, target),), None)
    if len(planes) < MIN_SIGHTINGS:
        return Judgement((_too_few(len(planes)),), None)
    errors = fit_rig(planes, camera.color_from_depth)
    agreement = _agreement(planes, errors)
    scale = _scale(errors, camera, target)
    parts = (scale, *_shifts(errors, camera), *_turns(errors, camera))
    if agreement.finding is Finding.OFF and not any(v.finding is Finding.OFF for v in parts):
        agreement = _unexplained(agreement, planes, camera, target)
    return Judgement((agreement, *parts), errors)


def _too_few(count: int) -> Verdict:
    return Verdict(
        "sightings",
        Finding.UNKNOWN,
        f"the target was seen in colour and in depth in {count} frames; it takes {MIN_SIGHTINGS}",
        "hold the camera still 1 to 2 m in front of the target for a second, then move slowly to "
        "0.7 m and to 3 m, and around it",
    )


def _unit(ratio: float, count: int, camera: RgbdCamera, target: Target) -> Verdict:
    """A ratio that no miscalibration explains: said, and never taken out."""
    fits_m = camera.depth_scale_m / ratio
    known = [f"{unit:g} ({name})" for unit, name in UNITS.items() if _near(unit, fits_m)]
    disc_m = target.discs[0].diameter_m
    do = (
        f"depth_scale_m is {camera.depth_scale_m:g} in the camera file; {fits_m:.3g} would fit the "
        f"circles" + (f", and {known[0]} is near that" if known else "") + ". If it is right, "
        f"measure the print: its outer disc would have to be {disc_m * ratio:.3g} m wide and not "
        f"{disc_m:g} m, or look at fx and fy"
    )
    return Verdict(
        "depth unit",
        Finding.OFF,
        f"depth is {ratio:.4g} times what the circles say (median of {count} frames): no "
        "calibration is off by that much, so it is a wrong unit, print or focal length",
        do,
        ratio,
        None,
        "times",
    )


def _near(unit: float, fits: float) -> bool:
    return abs(math.log(unit / fits)) < NEAR_UNIT


def _agreement(sightings: Sequence[Sighting], errors: RigErrors) -> Verdict:
    """Range by depth over range by circles, over the recording as it was flown."""
    share = errors.gap_share
    middle = float(np.median(share))
    # from frame to frame, since over the range it may well change
    scatter = 1.4826 * float(np.median(np.abs(np.diff(share)))) / math.sqrt(2)
    # neighbours err together: one in ten is taken to be apart
    sigma = 1.25 * scatter / math.sqrt(max(len(share) / 10, 1))
    off = abs(middle) > TOLERATED_SHARE + SURE_SIGMAS * sigma
    return Verdict(
        AGREEMENT,
        Finding.OFF if off else Finding.GOOD,
        f"range by depth is {_percent(middle, sigma)} longer than by circles, {_over(sightings)}"
        + ("" if off else f" (up to {100 * TOLERATED_SHARE:.1f} % is allowed for)"),
        "see what is off below" if off else "",
        100 * middle,
        100 * sigma,
        "%",
    )


def _unexplained(
    agreement: Verdict, sightings: Sequence[Sighting], camera: RgbdCamera, target: Target
) -> Verdict:
    """Off, but this recording cannot tell a factor from a shift."""
    assert agreement.value is not None
    share = agreement.value / 100
    range_m = float(np.median([s.circles.range_m for s in sightings]))
    tilt = float(np.median([s.circles.tilt_rad for s in sightings]))
    across = ""
    if tilt > SURE_TILT_RAD:
        slope = share / math.tan(tilt)
        across = (
            f", or, since it is seen {math.degrees(tilt):.0f} deg off its normal, a shift across "
            f"of {1000 * abs(slope) * range_m:.0f} mm, or a turn of "
            f"{math.degrees(abs(slope)):.1f} deg"
        )
    do = (
        "one range cannot tell a factor from a shift: record again from 0.7 m to 3 m. It is "
        f"either a shift of {1000 * share * range_m:.0f} mm along the line of sight in "
        f"color_from_depth{across}; or a factor: {_factor(share, camera, target)}"
    )
    return Verdict(
        agreement.name,
        agreement.finding,
        agreement.says,
        do,
        agreement.value,
        agreement.sigma,
        agreement.unit,
    )


def _scale(errors: RigErrors, camera: RgbdCamera, target: Target) -> Verdict:
    value, sigma = float(errors.estimate[0]), float(errors.sigma[0])
    name = "scale"
    if sigma > TOLD_SHARE:
        return _unseen(
            name,
            "a factor in depth cannot be told from a shift: the ranges are too much alike",
            "record from 0.7 m to 3 m",
        )
    finding = _found(value, sigma, TOLERATED_SHARE)
    return Verdict(
        name,
        finding,
        f"depth grows with range by {_percent(value, sigma)} too much",
        "" if finding is Finding.GOOD else _factor(value, camera, target),
        100 * value,
        100 * sigma,
        "%",
    )


def _factor(share: float, camera: RgbdCamera, target: Target) -> str:
    """What a constant ratio may mean; the circles' range is print size times focal length."""
    disc_m, fx = target.discs[0].diameter_m, camera.color.fx
    return (
        f"depth_scale_m = {camera.depth_scale_m / (1 + share):.4g} (is "
        f"{camera.depth_scale_m:g}), a print of {1000 * disc_m * (1 + share):.1f} mm (is "
        f"{1000 * disc_m:g} mm across the outer disc: measure it), or a focal length of "
        f"{fx * (1 + share):.1f} px (is {fx:g}). All three look alike from here; a ruler on the "
        "print leaves two"
    )


def _shifts(errors: RigErrors, camera: RgbdCamera) -> list[Verdict]:
    ways = (
        ("shift right", "look at the target from the left and from the right, 20 degrees or more"),
        ("shift down", "look at the target from above and from below, 20 degrees or more"),
        ("shift forward", "record from 0.7 m to 3 m"),
    )
    verdicts = []
    for i, (name, advice) in enumerate(ways, 1):
        value, sigma = float(errors.estimate[i]), float(errors.sigma[i])
        if sigma > TOLD_SHIFT_M:
            says = f"not to be told to better than {1000 * sigma:.0f} mm from this recording"
            verdicts.append(_unseen(name, says, advice))
            continue
        finding = _found(value, sigma, TOLERATED_SHIFT_M)
        do = "" if finding is Finding.GOOD else _set_pose(errors, camera, i)
        says = f"color_from_depth is off by {1000 * value:+.1f} +- {1000 * sigma:.1f} mm"
        verdicts.append(Verdict(name, finding, says, do, 1000 * value, 1000 * sigma, "mm"))
    return verdicts


def _turns(errors: RigErrors, camera: RgbdCamera) -> list[Verdict]:
    lean = "tilt the target or move around it, 15 to 45 degrees off its normal"
    ways = (
        ("turn about right", lean),
        ("turn about down", lean),
        ("turn about forward", f"{lean}, to all four sides"),
    )
    verdicts = []
    for i, (name, advice) in enumerate(ways, 4):
        value, sigma = math.degrees(errors.estimate[i]), math.degrees(errors.sigma[i])
        if sigma > math.degrees(TOLD_TURN_RAD):
            says = f"not to be told to better than {sigma:.1f} deg from this recording"
            verdicts.append(_unseen(name, says, advice))
            continue
        finding = _found(value, sigma, math.degrees(TOLERATED_TURN_RAD))
        do = "" if finding is Finding.GOOD else _set_pose(errors, camera, i)
        says = f"color_from_depth is off by {value:+.2f} +- {sigma:.2f} deg"
        verdicts.append(Verdict(name, finding, says, do, value, sigma, "deg"))
    return verdicts


def _set_pose(errors: RigErrors, camera: RgbdCamera, part: int) -> str:
    """The camera file's entry with this one error taken out."""
    alone = np.zeros(7)
    alone[part] = errors.estimate[part]
    pose = corrected(camera.color_from_depth, alone)
    if part < 4:
        return f"color_from_depth.translation_m = {_numbers(pose.translation)}"
    return f"color_from_depth.q_wxyz = {_numbers(pose.q_wxyz)}"


def _found(value: float, sigma: float, tolerated: float) -> Finding:
    return Finding.OFF if abs(value) > tolerated + SURE_SIGMAS * sigma else Finding.GOOD


def _unseen(name: str, says: str, do: str) -> Verdict:
    return Verdict(name, Finding.UNKNOWN, says, do)


def _percent(share: float, sigma: float) -> str:
    return f"{100 * share:+.2f} +- {100 * sigma:.2f} %"


def _over(sightings: Sequence[Sighting]) -> str:
    ranges = [s.circles.range_m for s in sightings]
    return f"from {min(ranges):.2f} to {max(ranges):.2f} m"


def _numbers(values: Array) -> str:
    return "[" + ", ".join(f"{v:.5g}" for v in values) + "]"
