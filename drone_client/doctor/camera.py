"""The camera: does it run, how often, with depth, and are its stamps of now."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from drone_client.doctor.finding import Check, Finding, judged
from drone_client.errors import SourceError
from drone_client.source import LiveSource
from rgbd_wire.clock import Clock

AREA = "camera"
WATCHED_S = 3.0
WAIT_S = 5.0
MIN_HZ, GOOD_HZ = 5.0, 12.0
MAX_AGE_MS = 100.0
DARK, BRIGHT = 25.0, 235.0
MANY_DROPPED, MANY_UNPAIRED = 0.02, 0.05
"""Of all pictures: more, and the cable or the machine cannot keep up."""
UNPAIRED = ("no_partner", "too_old", "out_of_order", "duplicate")
BROKEN = {
    "unreadable": "not to be read",
    "backwards": "older than the one before",
    "odd_stamps": "with stamps that cannot be",
    "clock_jumps": "jumps of its clock",
    "reconnects": "times lost and found again",
}
"""What never happens, or hardly ever, with a camera that is well; the last two blind the drone."""
BLINDING = ("clock_jumps", "reconnects")


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """What a camera gave for some seconds."""

    error: str = ""
    """Why there is none; empty: there is."""
    rate_hz: float = 0.0
    worst_age_ms: float = 0.0
    """From the middle of the exposure until we had the picture."""
    with_depth: float = 0.0
    """Share of the pictures."""
    holes: float | None = None
    """Share of depth's pixels without depth; None: no depth."""
    grey: float = 0.0
    """Mean of the last picture."""
    counts: dict[str, int] = field(default_factory=dict)
    """What became of its pictures, by reason (``LiveSource.counts``)."""


def collect_camera(source: LiveSource, clock: Clock) -> CameraFacts:
    """Run the camera for some seconds."""
    stamps: list[int] = []
    worst_ns = with_depth = 0
    holes: list[float] = []
    grey = 0.0
    try:
        source.start()
        give_up = time.monotonic() + WAIT_S
        for capture in source.captures(0.2):
            if capture is None:
                if not stamps and time.monotonic() > give_up:
                    return CameraFacts(f"no picture within {WAIT_S:g} s")
                continue
            if not stamps:
                give_up = time.monotonic() + WATCHED_S
            stamps.append(capture.t_source_ns)
            worst_ns = max(worst_ns, clock.now_ns() - capture.t_source_ns)
            grey = float(capture.color_rgb[::8, ::8].mean())
            if capture.depth_units is not None:
                with_depth += 1
                holes.append(float(np.mean(capture.depth_units[::4, ::4] == 0)))
            if time.monotonic() > give_up:
                break
        return CameraFacts(
            rate_hz=(len(stamps) - 1) / max((stamps[-1] - stamps[0]) / 1e9, 1e-9) if stamps else 0,
            worst_age_ms=worst_ns / 1e6,
            with_depth=with_depth / max(1, len(stamps)),
            holes=float(np.median(holes)) if holes else None,
            grey=grey,
            counts=source.counts(),
        )
    except SourceError as error:
        return CameraFacts(" ".join(str(error).split()))
    finally:
        source.stop()


def judge_camera_run(facts: CameraFacts) -> Sequence[Check]:
    """All checks of a running camera."""
    f = facts
    if f.error:
        return [judged(AREA, "pictures", Finding.FAULT, f.error, "see docs/sources.md")]
    slow = Finding.OK if f.rate_hz >= GOOD_HZ else Finding.WARNING
    fine = DARK <= f.grey <= BRIGHT
    checks = [
        judged(
            AREA,
            "rate",
            slow if f.rate_hz >= MIN_HZ else Finding.FAULT,
            f"{f.rate_hz:.1f} Hz",
            "a USB 2 cable, a long exposure or a busy machine",
        ),
        judged(
            AREA,
            "age",
            Finding.OK if f.worst_age_ms <= MAX_AGE_MS else Finding.WARNING,
            f"at most {f.worst_age_ms:.0f} ms when it is here",
            "every millisecond counts into the age of a result: a shorter exposure, a smaller "
            "picture, USB 3",
        ),
        judged(
            AREA,
            "light",
            Finding.OK if fine else Finding.WARNING,
            f"mean grey {f.grey:.0f} of 255",
            "too dark or too bright to find a target well: light, or exposure",
        ),
    ]
    if f.holes is None:
        checks.append(
            judged(
                AREA,
                "depth",
                Finding.WARNING,
                "no depth",
                "it flies on colour alone, with a larger error ball",
            )
        )
    else:
        many = f.holes > 0.6 or f.with_depth < 0.8
        checks.append(
            judged(
                AREA,
                "depth",
                Finding.WARNING if many else Finding.OK,
                f"with {f.with_depth:.0%} of the pictures, {f.holes:.0%} holes",
                "look at a textured wall 1 to 2 m away; is the emitter on?",
            )
        )
    return [*checks, *_losses(f.counts)]


def _losses(counts: Mapping[str, int]) -> list[Check]:
    """What the camera's own counts say; nothing of a source that does not count."""
    checks = []
    pictures = sum(counts.get(f"{stream}_frames", 0) for stream in ("color", "depth"))
    dropped = sum(counts.get(f"{stream}_dropped", 0) for stream in ("color", "depth"))
    if pictures:
        share = dropped / (pictures + dropped)
        checks.append(
            judged(
                AREA,
                "drops",
                Finding.WARNING if share > MANY_DROPPED else Finding.OK,
                f"{dropped} of {pictures + dropped} pictures never came",
                "a USB 3 port and cable of its own, a smaller picture or a lower rate",
            )
        )
    unpaired = sum(counts.get(f"{s}_{why}", 0) for s in ("color", "depth") for why in UNPAIRED)
    if pairs := counts.get("paired", 0):
        share = unpaired / (2 * pairs + unpaired)
        checks.append(
            judged(
                AREA,
                "pairs",
                Finding.WARNING if share > MANY_UNPAIRED else Finding.OK,
                f"{pairs} pairs, {unpaired} pictures without a partner",
                "colour and depth do not run at one rate: fix the exposure, switch priority of "
                "exposure over rate off",
            )
        )
    broken = [f"{counts[key]} {words}" for key, words in BROKEN.items() if counts.get(key)]
    if broken:
        checks.append(
            judged(
                AREA,
                "stream",
                Finding.FAULT if any(counts.get(key) for key in BLINDING) else Finding.WARNING,
                ", ".join(broken),
                "cable, hub, power or firmware: such pictures are dropped, and the drone is blind "
                "meanwhile",
            )
        )
    return checks
