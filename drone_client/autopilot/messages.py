"""MAVLink messages that we send, built from values in ENU and FLU. Pure.

MAVLink 2 through pymavlink's classes of the common dialect.
"""

from __future__ import annotations

import math

import numpy as np
from pymavlink.dialects.v20 import common as mav

from drone_client.autopilot.dead_man import Setpoint
from drone_client.autopilot.ned import (
    swap_body,
    swap_pose,
    swap_world,
    swap_yaw_rate,
    triangle_from_covariance,
)
from drone_client.odometry import OdometrySample, RangeSample

VELOCITY_AND_YAW_RATE_MASK = 1479
"""Ignore position, acceleration and yaw: only the velocity and the yaw rate count."""
PLACE_MAX_M = 1e5
"""A place or speed beyond it is no odometry of a drone that touches things."""
UNKNOWN = math.nan
QUALITY_GOOD = 100
QUALITY_UNKNOWN = 0
SIGNAL_INVALID = 1
"""DISTANCE_SENSOR's signal quality: 0 unknown, 1 invalid, 100 perfect."""


def heartbeat() -> mav.MAVLink_message:
    """An onboard computer is here and well."""
    return mav.MAVLink_heartbeat_message(
        mav.MAV_TYPE_ONBOARD_CONTROLLER,
        mav.MAV_AUTOPILOT_INVALID,
        0,
        0,
        mav.MAV_STATE_ACTIVE,
        3,  # MAVLink's own number of its version
    )


def velocity_setpoint(
    setpoint: Setpoint, now_ns: int, system: int, component: int
) -> mav.MAVLink_message:
    """SET_POSITION_TARGET_LOCAL_NED with a velocity and a yaw rate."""
    north, east, down = (float(c) for c in swap_world(np.array(setpoint.velocity_world)))
    return mav.MAVLink_set_position_target_local_ned_message(
        _boot_ms(now_ns),
        system,
        component,
        mav.MAV_FRAME_LOCAL_NED,
        VELOCITY_AND_YAW_RATE_MASK,
        0.0,
        0.0,
        0.0,
        north,
        east,
        down,
        0.0,
        0.0,
        0.0,
        0.0,
        swap_yaw_rate(setpoint.yaw_rate_radps),
    )


def set_mode(main_mode: int, sub_mode: int, system: int, component: int) -> mav.MAVLink_message:
    """COMMAND_LONG DO_SET_MODE: PX4 takes a main and a sub mode, ArduPilot the main one alone."""
    return _command(
        mav.MAV_CMD_DO_SET_MODE,
        system,
        component,
        float(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED),
        float(main_mode),
        float(sub_mode),
    )


def message_interval(
    message_id: int, rate_hz: float, system: int, component: int
) -> mav.MAVLink_message:
    """COMMAND_LONG SET_MESSAGE_INTERVAL."""
    interval_us = round(1e6 / rate_hz)
    return _command(
        mav.MAV_CMD_SET_MESSAGE_INTERVAL, system, component, float(message_id), float(interval_us)
    )


def timesync(tc1_ns: int, ts1_ns: int) -> mav.MAVLink_message:
    """TIMESYNC: a question (``tc1_ns`` = 0) or an answer."""
    return mav.MAVLink_timesync_message(tc1_ns, ts1_ns)


def parameter_request(name: str, system: int, component: int) -> mav.MAVLink_message:
    """PARAM_REQUEST_READ of a parameter by its name, at most 16 letters."""
    return mav.MAVLink_param_request_read_message(system, component, name.encode("ascii"), -1)


def odometry(sample: OdometrySample) -> mav.MAVLink_message | None:
    """ODOMETRY of the robot's own odometry; None: it is not finite or far away.

    Its world is called LOCAL_FRD: level, with a heading of its own, so that the autopilot takes the
    heading from it instead of the compass's. The velocity is in the body's frame, which every
    version of PX4 takes. ``time_usec`` is the drone's clock (see ``timesync``).
    """
    velocity = np.asarray(sample.velocity_world, dtype=np.float64)
    if velocity.shape != (3,) or not _near(velocity):
        return None
    if not _near(sample.world_from_body.translation):
        return None
    ned = swap_pose(sample.world_from_body)
    x, y, z = (float(c) for c in ned.translation)
    body = swap_body(sample.world_from_body.rotation.T @ velocity)
    vx, vy, vz = (float(c) for c in body)
    pose_covariance = [UNKNOWN] * 21
    quality = QUALITY_UNKNOWN
    if sample.covariance is not None and sample.covariance.shape == (6, 6):
        triangle = triangle_from_covariance(sample.covariance)
        if _near(np.array(triangle)):
            pose_covariance, quality = triangle, QUALITY_GOOD
    return mav.MAVLink_odometry_message(
        (sample.t_ns // 1000) & 0xFFFF_FFFF_FFFF_FFFF,
        mav.MAV_FRAME_LOCAL_FRD,
        mav.MAV_FRAME_BODY_FRD,
        x,
        y,
        z,
        [float(c) for c in ned.q_wxyz],
        vx,
        vy,
        vz,
        UNKNOWN,
        UNKNOWN,
        UNKNOWN,
        pose_covariance,
        [UNKNOWN] * 21,
        sample.resets % 256,
        mav.MAV_ESTIMATOR_TYPE_VIO,
        quality,
    )


def distance_sensor(sample: RangeSample) -> mav.MAVLink_message | None:
    """DISTANCE_SENSOR of a distance; None: it is no number.

    MAVLink counts centimetres here. A distance that the sensor cannot measure goes out as such.
    """
    if not all(math.isfinite(d) for d in (sample.distance_m, sample.min_m, sample.max_m)):
        return None
    looks_down = mav.MAV_SENSOR_ROTATION_PITCH_270
    return mav.MAVLink_distance_sensor_message(
        _boot_ms(sample.t_ns),
        _centimetres(sample.min_m),
        _centimetres(sample.max_m),
        _centimetres(sample.distance_m),
        mav.MAV_DISTANCE_SENSOR_LASER,
        0,
        looks_down if sample.looks_down else mav.MAV_SENSOR_ROTATION_NONE,
        255,  # variance: not known
        0.0,
        0.0,
        [0.0] * 4,
        QUALITY_GOOD if sample.valid else SIGNAL_INVALID,
    )


def _command(command: int, system: int, component: int, *parameters: float) -> mav.MAVLink_message:
    p = [*parameters, *[0.0] * (7 - len(parameters))]
    return mav.MAVLink_command_long_message(
        system, component, command, 0, p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    )


def _near(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).all() and (np.abs(values) <= PLACE_MAX_M).all())


def _centimetres(distance_m: float) -> int:
    return min(max(round(distance_m * 100.0), 0), 0xFFFF)


def _boot_ms(t_ns: int) -> int:
    return (t_ns // 1_000_000) & 0xFFFF_FFFF
