"""The robot's own VIO and lidars over ROS 2: are they heard, how often, how old, do they jump."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from drone_client.doctor.finding import Check, Finding, judged, ok
from drone_client.odometry.jump import Jump, JumpSettings, JumpWatch, Motion
from drone_client.odometry.lidar import is_measured
from drone_client.odometry.zenoh import RosOdometry
from rgbd_wire.clock import Clock

AREA = "odometry"
HEARD_S = 5.0
"""So long a session and a first sample are waited for, and then so long ..."""
WATCHED_S = 3.0
"""... they are looked at."""
POLL_S = 0.002
MIN_HZ = {"odometry": 10.0, "height": 5.0, "ahead": 5.0}
"""Fewer, and a jump of 10 cm is not seen (docs/odometry.md); a lidar's distance is stale."""
GOOD_HZ = {"odometry": 30.0, "height": 10.0, "ahead": 10.0}
MAX_AGE_MS = 100.0
NAMES = {"odometry": "VIO", "height": "lidar down", "ahead": "lidar ahead"}


@dataclass(frozen=True, slots=True)
class StreamFacts:
    """One topic, watched for some seconds."""

    rate_hz: float = 0.0
    worst_age_ms: float = 0.0
    """From its stamp until we looked."""
    blind: float = 0.0
    """Share of a lidar's distances that it cannot measure."""
    last_m: float | None = None
    """The newest of them; None: no lidar."""


@dataclass(frozen=True, slots=True)
class OdometryFacts:
    """What was heard of the robot's own sensors."""

    connected: bool
    streams: Mapping[str, StreamFacts] = field(default_factory=dict)
    """Of each topic that was asked for: odometry, height, ahead."""
    refused: Mapping[str, int] = field(default_factory=dict)
    """Messages that made no sample, by reason."""
    jump: Jump | None = None
    """The first of the VIO while it was watched."""
    jumps: int = 0


def collect_odometry(
    source: RosOdometry, wanted: Sequence[str], clock: Clock, settings: JumpSettings | None = None
) -> OdometryFacts:
    """Listen for some seconds.

    Args:
        source: its session may still be on its way.
        wanted: which of odometry, height and ahead were asked for.
        clock: the drone's, that of the samples.
        settings: what is a jump of the VIO.
    """
    give_up = time.monotonic() + HEARD_S
    while time.monotonic() < give_up and not all(source.taken[kind] for kind in wanted):
        time.sleep(0.02)
    if not source.connected:
        return OdometryFacts(connected=False)
    read = {"odometry": source.odometry, "height": source.height, "ahead": source.ahead}
    first = {kind: source.taken[kind] for kind in wanted}
    newest: dict[str, Any] = dict.fromkeys(wanted)
    oldest_ns, seen, blind = (dict.fromkeys(wanted, 0) for _ in range(3))
    watch, jump = JumpWatch(settings), None
    start = time.monotonic()
    while time.monotonic() < start + WATCHED_S:
        for kind in wanted:
            sample: Any = read[kind]()
            if sample is None or sample is newest[kind]:
                continue
            newest[kind] = sample
            seen[kind] += 1
            oldest_ns[kind] = max(oldest_ns[kind], clock.now_ns() - sample.t_ns)
            if kind == "odometry":
                seen_jump = watch.see(Motion.of(sample))
                jump = jump or seen_jump
            else:
                blind[kind] += not is_measured(sample)
        time.sleep(POLL_S)
    watched_s = time.monotonic() - start
    streams = {
        kind: StreamFacts(
            (source.taken[kind] - first[kind]) / watched_s,
            oldest_ns[kind] / 1e6,
            blind[kind] / max(1, seen[kind]),
            getattr(newest[kind], "distance_m", None),
        )
        for kind in wanted
    }
    return OdometryFacts(True, streams, dict(source.refused), jump, watch.jumps.total())


def judge_odometry(facts: OdometryFacts, where: str) -> Sequence[Check]:
    """All checks of the robot's own sensors.

    Args:
        facts: what was heard.
        where: ROS 2 is looked for.
    """
    if not facts.connected:
        return [
            judged(
                AREA,
                "ROS 2",
                Finding.FAULT,
                f"nobody answers at {where}",
                "is zenoh-bridge-ros2dds or the router of rmw_zenoh up there (--ros-connect)?",
            )
        ]
    checks = []
    for kind, stream in facts.streams.items():
        checks += [_rate(kind, stream)]
        if stream.rate_hz:
            checks += [_age(kind, stream)]
        if stream.last_m is not None:
            checks += [_range(kind, stream)]
    vio = facts.streams.get("odometry")
    if vio is not None and vio.rate_hz:
        checks += [_jumps(facts)]
    return [*checks, *_refused(facts)]


def _rate(kind: str, stream: StreamFacts) -> Check:
    rate = stream.rate_hz
    slow = Finding.OK if rate >= GOOD_HZ[kind] else Finding.WARNING
    return judged(
        AREA,
        f"{NAMES[kind]} rate",
        slow if rate >= MIN_HZ[kind] else Finding.FAULT,
        f"{rate:.0f} Hz" if rate else "nothing comes",
        f"publish at {GOOD_HZ[kind]:g} Hz or more"
        if rate
        else "are topic, type (nav_msgs/Odometry, sensor_msgs/Range) and --ros-flavour right?",
    )


def _age(kind: str, stream: StreamFacts) -> Check:
    age = stream.worst_age_ms
    return judged(
        AREA,
        f"{NAMES[kind]} age",
        Finding.OK if age <= MAX_AGE_MS else Finding.WARNING,
        f"at most {age:.0f} ms",
        "a slow sensor, a busy machine, or a clock that is not this machine's",
    )


def _range(kind: str, stream: StreamFacts) -> Check:
    return judged(
        AREA,
        f"{NAMES[kind]} distance",
        Finding.WARNING if stream.blind > 0.5 else Finding.OK,
        f"{stream.last_m:.2f} m, {stream.blind:.0%} not to be measured",
        "too near, too far or too dark for it: lift the drone, or hold something before it",
    )


def _jumps(facts: OdometryFacts) -> Check:
    jump = facts.jump
    return judged(
        AREA,
        "VIO jumps",
        Finding.OK if jump is None else Finding.FAULT,
        f"none within {WATCHED_S:g} s"
        if jump is None
        else f"{facts.jumps} within {WATCHED_S:g} s; {jump.sentence}",
        "give it light and texture; a VIO that is noisier than 6 mm needs a larger position_m in "
        "[odometry.vio_jump] of the tuning file (docs/odometry.md)",
    )


def _refused(facts: OdometryFacts) -> list[Check]:
    if not facts.refused:
        heard = any(stream.rate_hz for stream in facts.streams.values())
        return [ok(AREA, "messages", "each made a sample")] if heard else []
    found = ", ".join(f"{n} {reason}" for reason, n in sorted(facts.refused.items()))
    advice = "are the topics of these types, and of the body's pose?"
    if "stamp" in facts.refused:
        advice = "their stamps are not of this machine's clock: synchronise them (chrony, PTP)"
    return [judged(AREA, "messages", Finding.FAULT, f"refused: {found}", advice)]
