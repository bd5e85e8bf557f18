"""The vehicle: heartbeat, pose, clock, battery, frames, parameters."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drone_client.autopilot import VehicleState
from drone_client.autopilot.mavlink import MavlinkAutopilot
from drone_client.autopilot.parameters import Parameter, packaged_parameters
from drone_client.doctor.finding import Check, Finding, judged, ok, unchecked
from drone_client.odometry import OdometrySample
from rgbd_wire.clock import Clock

AREA = "vehicle"
HEARD_S = 5.0
"""So long a heartbeat is waited for, and then so long ..."""
WATCHED_S = 3.0
"""... the rates are looked at."""
PARAMETERS_S = 8.0
MIN_POSE_HZ, GOOD_POSE_HZ = 15.0, 30.0
MAX_POSE_AGE_MS = 100.0
BATTERY_MIN, BATTERY_LOW = 0.2, 0.4
OFFSET_BOUND_MS = 2.0
LEVEL_MIN = 0.8
"""Cosine of the body's z with the world's up: a drone that stands or hovers is level."""


@dataclass(frozen=True, slots=True, eq=False)
class VehicleFacts:
    """What was heard of an autopilot."""

    state: VehicleState | None
    """None: no heartbeat."""
    pose_hz: float = 0.0
    pose_age_ms: float | None = None
    """Of the newest pose, at its oldest."""
    odometry: OdometrySample | None = None
    resets: int = 0
    """Jumps of its estimate while it was watched."""
    clock_bound_ms: float | None = None
    """Of the offset between the two clocks; None: not known yet."""
    parameters: Mapping[str, float | int] | None = None
    """None: not asked for, it is no PX4."""


def collect_vehicle(vehicle: MavlinkAutopilot, clock: Clock, is_px4: bool) -> VehicleFacts:
    """Listen for some seconds, and ask for the parameters; commands nothing."""
    give_up = time.monotonic() + HEARD_S
    while vehicle.state() is None:
        if time.monotonic() > give_up:
            return VehicleFacts(None)
        time.sleep(0.02)
    stamps: list[int] = []
    oldest_ns, resets, first = 0, 0, vehicle.odometry()
    end = time.monotonic() + WATCHED_S
    while time.monotonic() < end:
        state = vehicle.state()
        if state is not None and state.t_pose_ns is not None:
            if not stamps or state.t_pose_ns != stamps[-1]:
                stamps.append(state.t_pose_ns)
            oldest_ns = max(oldest_ns, clock.now_ns() - state.t_pose_ns)
        time.sleep(0.004)
    newest = vehicle.odometry()
    if first is not None and newest is not None:
        resets = newest.resets - first.resets
    offset = vehicle.clock_offset_ns()
    values = None
    if is_px4:
        values = vehicle.read_parameters(packaged_parameters(), PARAMETERS_S)
    return VehicleFacts(
        vehicle.state(),
        max(0, len(stamps) - 1) / WATCHED_S,
        oldest_ns / 1e6 if stamps else None,
        newest,
        resets,
        None if offset is None else offset[1] / 1e6,
        values,
    )


def judge_vehicle(facts: VehicleFacts, address: str) -> Sequence[Check]:
    """All checks of the vehicle."""
    state = facts.state
    if state is None:
        return [
            judged(
                AREA,
                "heartbeat",
                Finding.FAULT,
                f"nothing heard at {address} within {HEARD_S:g} s",
                "is the address right (docs/px4.md), does the autopilot send MAVLink there, is it "
                "on? udp/ listens, udpout/ speaks first",
            )
        ]
    return [
        ok(AREA, "heartbeat", f"{state.mode}, {'armed' if state.armed else 'disarmed'}"),
        *_pose(facts, state),
        _frames(state),
        _clock(facts),
        _battery(state),
        *([_failsafe(state)] if state.failsafe else []),
        *_parameters(facts, packaged_parameters()),
    ]


def _pose(facts: VehicleFacts, state: VehicleState) -> list[Check]:
    if state.world_from_body is None or facts.pose_age_ms is None:
        return [
            judged(
                AREA,
                "pose",
                Finding.FAULT,
                "the autopilot does not say where it is",
                "its estimator has no position: give it odometry (--vio-topic), or wait for it; "
                "stream ODOMETRY (docs/px4.md)",
            )
        ]
    rate, age = facts.pose_hz, facts.pose_age_ms
    slow = Finding.OK if rate >= GOOD_POSE_HZ else Finding.WARNING
    checks = [
        judged(
            AREA,
            "pose rate",
            slow if rate >= MIN_POSE_HZ else Finding.FAULT,
            f"{rate:.0f} Hz",
            f"stream ODOMETRY at {GOOD_POSE_HZ:g} Hz or more: poses are carried on by velocity",
        ),
        judged(
            AREA,
            "pose age",
            Finding.OK if age <= MAX_POSE_AGE_MS else Finding.WARNING,
            f"at most {age:.0f} ms",
            "a slow line (baud rate, radio), or a clock that is not known yet: wait a minute",
        ),
    ]
    if facts.resets:
        checks.append(
            judged(
                AREA,
                "estimate",
                Finding.FAULT,
                f"jumped {facts.resets} times in {WATCHED_S:g} s",
                "the estimator does not trust its odometry: see EKF2_EV_* and the VIO itself",
            )
        )
    return checks


def _frames(state: VehicleState) -> Check:
    if state.world_from_body is None:
        return unchecked(AREA, "attitude", "no pose")
    up = float(state.world_from_body.rotation[2, 2])
    return judged(
        AREA,
        "attitude",
        Finding.OK if up >= LEVEL_MIN else Finding.FAULT,
        f"the body's z points {'up' if up > 0 else 'down'} (cosine {up:.2f})",
        "a drone that stands or hovers is level: is the autopilot mounted as it was told "
        "(SENS_BOARD_ROT), is the odometry in the frame that it says?",
    )


def _clock(facts: VehicleFacts) -> Check:
    bound = facts.clock_bound_ms
    if bound is None:
        return judged(
            AREA,
            "time sync",
            Finding.WARNING,
            "the autopilot's clock is not known yet",
            "wait a minute; does it answer TIMESYNC? Poses are stamped on arrival until then",
        )
    return judged(
        AREA,
        "time sync",
        Finding.OK if bound <= OFFSET_BOUND_MS else Finding.WARNING,
        f"known within {bound:.2f} ms",
        "a slow or jittery line: at 0.3 m/s 10 ms are 3 mm",
    )


def _battery(state: VehicleState) -> Check:
    left = state.battery_fraction
    if left is None:
        return unchecked(AREA, "battery", "the autopilot does not say")
    low = Finding.WARNING if left < BATTERY_LOW else Finding.OK
    return judged(
        AREA,
        "battery",
        Finding.FAULT if left < BATTERY_MIN else low,
        f"{left:.0%}",
        "charge it: the mission ends below its battery_min",
    )


def _failsafe(state: VehicleState) -> Check:
    return judged(AREA, "failsafe", Finding.FAULT, state.failsafe, "find out why, and clear it")


def _parameters(facts: VehicleFacts, wanted: Mapping[str, Parameter]) -> list[Check]:
    values = facts.parameters
    if values is None:
        return [unchecked(AREA, "parameters", "only PX4's are compared")]
    checks = []
    for name, parameter in wanted.items():
        if name not in values:
            continue
        if not parameter.matches(values[name]):
            checks.append(
                judged(
                    AREA,
                    name,
                    Finding.FAULT,
                    f"{values[name]:g}",
                    f"set it to {parameter.value:g}: {parameter.why}",
                )
            )
    missing = [name for name in wanted if name not in values]
    if len(missing) == len(wanted):
        return [unchecked(AREA, "parameters", "the autopilot did not answer")]
    if missing:
        checks.append(unchecked(AREA, "parameters", f"no answer for {', '.join(missing)}"))
    same = len(wanted) - len(missing) - sum(c.finding is Finding.FAULT for c in checks)
    return [*checks, ok(AREA, "parameters", f"{same} of {len(wanted)} as packaged")]
