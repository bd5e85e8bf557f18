"""The vehicle: heartbeat, pose, heading, height, clock, battery, frames, parameters."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from drone_client.autopilot import VehicleState
from drone_client.autopilot.mavlink import MavlinkAutopilot
from drone_client.autopilot.parameters import PACKAGED, Parameter, packaged_parameters
from drone_client.doctor.finding import Check, Finding, judged, ok, unchecked
from drone_client.odometry import OdometrySample, RangeSample
from drone_client.odometry.feed import MAX_RESETS
from drone_client.odometry.lidar import Lidar
from drone_client.odometry.source import OdometrySource
from rgbd_wire.clock import Clock

AREA = "vehicle"
HEARD_S = 5.0
"""So long a heartbeat and a lidar are waited for, and then so long ..."""
WATCHED_S = 3.0
"""... the rates are looked at."""
PARAMETERS_S = 8.0
MIN_POSE_HZ, GOOD_POSE_HZ = 15.0, 30.0
MAX_POSE_AGE_MS = 100.0
BATTERY_MIN, BATTERY_LOW = 0.2, 0.4
OFFSET_BOUND_MS = 2.0
LEVEL_MIN = 0.8
"""Cosine of the body's z with the world's up: a drone that stands or hovers is level."""
HEADING_GOOD_RAD, HEADING_MAX_RAD = 0.1, 0.5
"""Standard deviation of the heading: at 3 m 0.1 rad are 30 cm; a filter that knows none says 1."""
HEIGHT_GOOD_M, HEIGHT_MAX_M = 0.3, 1.0
"""Between the estimator's height and the lidar's: the lidar's own place on the drone and a floor
that is not flat; and more than these can explain."""


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
    height_m: float | None = None
    """Of the estimate, while the lidar measured; None: there is no lidar, or it measured nothing.
    """
    lidar_m: float | None = None
    """By the lidar that looks down, upright."""
    parameter_file: str = PACKAGED
    """The packaged one that it is compared with."""


def collect_vehicle(
    vehicle: MavlinkAutopilot, clock: Clock, odometry: OdometrySource | None = None
) -> VehicleFacts:
    """Listen for some seconds, and ask for the parameters; commands nothing.

    Args:
        vehicle: its line is open.
        clock: the drone's.
        odometry: has a lidar that looks down; None: there is none.
    """
    give_up = time.monotonic() + HEARD_S
    while vehicle.state() is None:
        if time.monotonic() > give_up:
            return VehicleFacts(None)
        time.sleep(0.02)
    while odometry is not None and odometry.height() is None and time.monotonic() < give_up:
        time.sleep(0.02)
    stamps: list[int] = []
    oldest_ns, resets, first = 0, 0, vehicle.odometry()
    heights = _Heights()
    end = time.monotonic() + WATCHED_S
    while time.monotonic() < end:
        state = vehicle.state()
        if state is not None and state.t_pose_ns is not None:
            if not stamps or state.t_pose_ns != stamps[-1]:
                stamps.append(state.t_pose_ns)
            oldest_ns = max(oldest_ns, clock.now_ns() - state.t_pose_ns)
            if odometry is not None:
                heights.see(odometry.height(), state, clock.now_ns())
        time.sleep(0.004)
    newest = vehicle.odometry()
    if first is not None and newest is not None:
        resets = (newest.resets - first.resets) % MAX_RESETS
    offset = vehicle.clock_offset_ns()
    wanted = packaged_parameters(vehicle.flavour.parameter_file)
    values = vehicle.read_parameters(wanted, PARAMETERS_S)
    return VehicleFacts(
        vehicle.state(),
        max(0, len(stamps) - 1) / WATCHED_S,
        oldest_ns / 1e6 if stamps else None,
        newest,
        resets,
        None if offset is None else offset[1] / 1e6,
        values,
        heights.estimated_m,
        heights.measured_m,
        vehicle.flavour.parameter_file,
    )


class _Heights:
    """Pairs of the estimator's height and the lidar's, of the same moments."""

    def __init__(self) -> None:
        self._lidar = Lidar()
        self._sample: RangeSample | None = None
        self._pairs: list[tuple[float, float]] = []

    @property
    def estimated_m(self) -> float | None:
        return median(z for z, _ in self._pairs) if self._pairs else None

    @property
    def measured_m(self) -> float | None:
        return median(upright for _, upright in self._pairs) if self._pairs else None

    def see(self, sample: RangeSample | None, state: VehicleState, now_ns: int) -> None:
        if sample is None or sample is self._sample or state.world_from_body is None:
            return
        self._sample = sample
        if self._lidar.see(sample) is None:
            return
        upright_m = self._lidar.upright_m(now_ns, state.world_from_body)
        if upright_m is not None:
            self._pairs.append((float(state.world_from_body.translation[2]), upright_m))


def judge_vehicle(facts: VehicleFacts, address: str, *, feeds_vio: bool = False) -> Sequence[Check]:
    """All checks of the vehicle.

    Args:
        facts: what was heard.
        address: where.
        feeds_vio: this client is what passes the VIO on to it, in a flight and not now.
    """
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
        ok(AREA, "heartbeat", state.mode),
        _arming(state),
        *_pose(facts, state, feeds_vio),
        _frames(state),
        _heading(facts),
        _height(facts),
        _clock(facts),
        _battery(state),
        *([_failsafe(state)] if state.failsafe else []),
        *_parameters(facts, packaged_parameters(facts.parameter_file)),
    ]


def _arming(state: VehicleState) -> Check:
    where = {None: "", True: ", on the ground", False: ", in the air"}[state.landed]
    return judged(
        AREA,
        "arming",
        Finding.WARNING if state.armed else Finding.OK,
        f"{'armed' if state.armed else 'disarmed'}{where}",
        "a check is for the ground: disarm, and keep away from the propellers until then",
    )


def _pose(facts: VehicleFacts, state: VehicleState, feeds_vio: bool) -> list[Check]:
    if state.world_from_body is None or facts.pose_age_ms is None:
        if feeds_vio:
            return [
                unchecked(
                    AREA,
                    "pose",
                    "the autopilot says none: only fly passes the VIO of --vio-topic on to it, and "
                    "shows before it asks where the vehicle is",
                )
            ]
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


def _heading(facts: VehicleFacts) -> Check:
    covariance = None if facts.odometry is None else facts.odometry.covariance
    variance = 0.0 if covariance is None else float(covariance[5, 5])
    if not 0.0 < variance < math.inf:
        return unchecked(AREA, "heading", "the autopilot does not say how well it knows it")
    sigma = math.sqrt(variance)
    unsure = Finding.WARNING if sigma <= HEADING_MAX_RAD else Finding.FAULT
    return judged(
        AREA,
        "heading",
        Finding.OK if sigma <= HEADING_GOOD_RAD else unsure,
        f"known to {math.degrees(sigma):.1f} degrees",
        "the estimator has no heading that it trusts: without a compass it needs the vision's "
        "(EKF2_EV_CTRL with 8, --vio-topic)",
    )


def _height(facts: VehicleFacts) -> Check:
    height, lidar = facts.height_m, facts.lidar_m
    if height is None or lidar is None:
        return unchecked(AREA, "height", "there is no pose and lidar that looks down, both at once")
    off = abs(height - lidar)
    far = Finding.WARNING if off <= HEIGHT_MAX_M else Finding.FAULT
    return judged(
        AREA,
        "height",
        Finding.OK if off <= HEIGHT_GOOD_M else far,
        f"{height:.2f} m by the estimate, {lidar:.2f} m by the lidar",
        "the estimator does not go by the lidar, or the floor is not where it began: see "
        "EKF2_HGT_REF and EKF2_RNG_CTRL; --floor-m and --ceiling-m are heights of the estimate",
    )


def _clock(facts: VehicleFacts) -> Check:
    bound = facts.clock_bound_ms
    if bound is None:
        return judged(
            AREA,
            "time sync",
            Finding.WARNING,
            "the autopilot's clock is not known yet",
            "wait a minute; does it answer TIMESYNC? Until then no pose of it can be used, for "
            "nobody knows of when it is",
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
        return [unchecked(AREA, "parameters", "it was not asked for any")]
    wrong = [
        judged(
            AREA,
            name,
            Finding.FAULT,
            f"{values[name]:g}",
            f"set it to {parameter.value:g}: {parameter.why}",
        )
        for name, parameter in wanted.items()
        if name in values and not parameter.matches(values[name])
    ]
    silent = [name for name in wanted if name not in values]
    same = len(wanted) - len(silent) - len(wrong)
    found = f"{same} of {len(wanted)} as packaged"
    if wrong:
        found += f", {len(wrong)} otherwise"
    if silent:
        found += f", no answer for {', '.join(silent)}"
    # A value that nobody has told is none that is well
    unsure = Finding.WARNING if silent else Finding.OK
    return [
        *wrong,
        judged(
            AREA,
            "parameters",
            Finding.FAULT if wrong else unsure,
            found,
            f"load drone_client/autopilot/{facts.parameter_file} (docs/px4.md)"
            if wrong
            else "ask again: a slow line loses answers; a firmware of another version may not have "
            "them, then set what it has instead",
        ),
    ]
