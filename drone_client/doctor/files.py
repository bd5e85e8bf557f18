"""The files that a flight is set up by: camera, airframe, tuning, certificates, key."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drone_client.airframe import Airframe, load_airframe
from drone_client.doctor.finding import Check, Finding, judged, ok, unchecked
from drone_client.errors import ClientError
from drone_client.flight_settings import flight_settings
from drone_client.settings import ClientSettings
from drone_client.tuning import load_tuning
from rgbd_wire.camera import CameraIntrinsics, load_camera
from rgbd_wire.errors import WireError
from rgbd_wire.tls_files import tls_files
from rgbd_wire.tunnel.keys import load_key
from target_pose.errors import TargetError
from target_pose.target import load_round_target

AREA = "files"
VIEW_DEG = (30.0, 130.0)
"""Width of view of a camera that one finds a target with."""


def check_files(
    settings: ClientSettings, airframe: Path | None, camera: Path | None, tuning: Path | None
) -> list[Check]:
    """All checks of files; quick, no network."""
    checks = [
        _checked("airframe", airframe, "--airframe", lambda p: judge_airframe(load_airframe(p))),
        _checked(
            "tuning",
            tuning,
            "--tuning",
            lambda p: _tuned(p, settings),
        ),
        _checked("certificates", settings.tls, "--tls", _certificates),
        _target(settings),
        _checked(
            "tunnel key",
            settings.key_file,
            "--key-file",
            lambda p: _key(p, settings.name),
        ),
    ]
    if camera is None:
        return [*checks, unchecked(AREA, "camera file", "none given: the camera's own is used")]
    try:
        rig = load_camera(camera)
    except WireError as error:
        return [*checks, _wrong("camera file", error)]
    return [*checks, judge_camera(rig.color, "colour"), judge_camera(rig.depth, "depth")]


def judge_camera(intrinsics: CameraIntrinsics, which: str) -> Check:
    """Whether intrinsics are those of a camera that looks straight ahead."""
    i = intrinsics
    view = math.degrees(2 * math.atan2(i.width / 2, i.fx))
    off = max(abs(i.cx - (i.width - 1) / 2) / i.width, abs(i.cy - (i.height - 1) / 2) / i.height)
    squeezed = abs(i.fx / i.fy - 1)
    found = f"{which}: {i.width}x{i.height}, {view:.0f} degrees wide, centre {100 * off:.1f} % off"
    if not VIEW_DEG[0] <= view <= VIEW_DEG[1]:
        finding, advice = Finding.FAULT, "fx does not fit the picture: is it of another resolution?"
    elif off > 0.1:
        finding, advice = Finding.FAULT, "cx, cy do not fit the picture: of another resolution?"
    elif squeezed > 0.02:
        finding, advice = Finding.WARNING, f"fx and fy are {100 * squeezed:.1f} % apart: check both"
    else:
        finding, advice = Finding.OK, ""
    return judged(AREA, f"{which} intrinsics", finding, found, advice)


def judge_airframe(airframe: Airframe) -> Check:
    """Whether the camera looks ahead and the arm reaches past the propellers."""
    ahead = float(airframe.body_from_camera.rotation[:, 2] @ np.array([1.0, 0.0, 0.0]))
    tip = airframe.body_from_tip.translation
    parts = [part for plane in airframe.keep_outs for part in plane.parts]
    reach = max((p.center_body[0] + p.reach_m((-1.0, 0.0, 0.0)) for p in parts), default=0.0)
    found = f"tip {tip[0]:.2f} m ahead, propellers and body reach {reach:.2f} m"
    if ahead < 0.5:
        angle = math.degrees(math.acos(max(-1.0, min(1.0, ahead))))
        return judged(
            AREA,
            "airframe",
            Finding.FAULT,
            f"the camera looks {angle:.0f} degrees away from the body's x",
            "body_from_camera: the camera's z is its line of sight (docs/frames.md)",
        )
    room = float(tip[0]) - reach
    clearance = max((p.clearance_m for p in airframe.keep_outs), default=0.0)
    short = room < clearance + 0.03
    if airframe.assumed and not short:
        return judged(
            AREA,
            "airframe",
            Finding.WARNING,
            f"{found}; {', '.join(airframe.assumed)} of the default drone: its file has none",
            "measure yours and write it down (docs/frames.md): larger propellers than those would "
            "be flown into what they stay clear of",
        )
    return judged(
        AREA,
        "airframe",
        Finding.FAULT if room <= 0 else Finding.WARNING if short else Finding.OK,
        found,
        "the arm must reach past the propellers by the wall's clearance and some centimetres, or "
        "the keep-out stops the drone before the tip touches",
    )


def _target(settings: ClientSettings) -> Check:
    """Of the drone's own eyes; without them the client knows no target."""
    if not settings.onboard_fallback:
        return unchecked(AREA, "target", "no --onboard-fallback: the drone has no eyes of its own")
    try:
        target = load_round_target(settings.onboard_target)
    except TargetError as error:
        return _wrong("target", error)
    return ok(AREA, "target", f"{target.name}, {1e3 * target.board_side_m:.0f} mm")


def _tuned(path: Path, settings: ClientSettings) -> Check:
    load_tuning(path, flight_settings(settings))
    return ok(AREA, "tuning", f"{path}: every number is within its bounds")


def _key(path: Path, drone: str) -> Check:
    load_key(path, drone)
    return ok(AREA, "tunnel key", f"{path} has the key of {drone}")


def _certificates(folder: Path) -> Check:
    files = tls_files(folder)
    return judged(
        AREA,
        "certificates",
        Finding.WARNING if files.warnings else Finding.OK,
        f"of {files.common_name}" + "".join(f"; {w}" for w in files.warnings),
        "make new ones with scripts/certificates",
    )


def _checked(name: str, path: Path | None, option: str, check: Callable[[Path], Check]) -> Check:
    if path is None:
        return unchecked(AREA, name, f"no {option} given")
    try:
        return check(path)
    except (ClientError, WireError, TargetError) as error:
        return _wrong(name, error)


def _wrong(name: str, error: Exception) -> Check:
    return judged(
        AREA, name, Finding.FAULT, " ".join(str(error).split()), "correct it as the line says"
    )
