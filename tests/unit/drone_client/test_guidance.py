"""What the drone wants: towards the target, square to it, and gently."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.guidance import GuidanceSettings, guide, yaw_error_rad
from rgbd_wire.geometry import Pose, rotation_from_vector

SETTINGS = GuidanceSettings()
UP = (0.0, 0.0, 1.0)
coordinates = st.floats(-3, 3)
angles = st.floats(-math.pi, math.pi)


def facing(x: float, y: float, z: float, yaw_error: float = 0.0) -> Pose:
    """A tip at (x, y, z) in frame ``target`` that must still turn by ``yaw_error``."""
    yaw = math.pi - yaw_error
    return Pose.from_rotation(rotation_from_vector(np.array([0.0, 0.0, yaw])), np.array([x, y, z]))


def test_in_line_it_closes_in() -> None:
    """On the axis and square, the wish is -k_x (x + push) along x."""
    nominal = guide(facing(0.3, 0.0, 0.0), SETTINGS, UP)
    assert nominal.velocity_tip_target == pytest.approx((-0.4 * 0.325, 0.0, 0.0))
    assert nominal.yaw_rate_radps == pytest.approx(0.0, abs=1e-12)


def test_across_it_is_twice_as_eager() -> None:
    """The lateral gain is the larger, so that the tip lines up before it arrives."""
    vx, vy, vz = guide(facing(0.1, 0.02, -0.01), SETTINGS, UP).velocity_tip_target
    assert (vx, vy, vz) == pytest.approx((-0.4 * 0.125, -0.8 * 0.02, 0.8 * 0.01))


def test_the_goal_lies_behind_the_board() -> None:
    """At the push depth it wants to rest, deeper it wants out."""
    assert guide(facing(-0.025, 0.0, 0.0), SETTINGS, UP).velocity_tip_target[0] == pytest.approx(
        0.0
    )
    assert guide(facing(-0.035, 0.0, 0.0), SETTINGS, UP).velocity_tip_target[0] > 0.0
    assert guide(facing(0.0, 0.0, 0.0), SETTINGS, UP).velocity_tip_target[0] < 0.0


@given(coordinates, coordinates, coordinates, angles)
def test_every_wish_is_within_its_limits(x, y, z, yaw_error) -> None:
    """Speed, yaw rate, and the closing speed at the touch."""
    nominal = guide(facing(x, y, z, yaw_error), SETTINGS, UP)
    assert math.hypot(*nominal.velocity_tip_target) <= SETTINGS.speed_max_mps + 1e-12
    assert abs(nominal.yaw_rate_radps) <= SETTINGS.yaw_rate_max_radps
    if x <= 0:
        assert nominal.velocity_tip_target[0] >= -SETTINGS.touch_mps - 1e-12


def test_the_touch_is_gentle_for_any_gain() -> None:
    """The closing profile holds where the gain alone would be too eager."""
    eager = GuidanceSettings(k_x=2.0, k_lateral=2.0, push_m=0.05)
    assert guide(facing(0.0, 0.0, 0.0), eager, UP).velocity_tip_target[0] == pytest.approx(-0.08)


@given(angles.filter(lambda a: abs(a) < 3.1))
def test_the_yaw_error_is_the_angle_still_to_turn(error) -> None:
    """Turning by it makes the arm point into the board; the rate has its sign."""
    tip = facing(1.0, 0.0, 0.0, error)
    arm = tuple(tip.rotation[:, 0].tolist())
    assert yaw_error_rad(arm, UP) == pytest.approx(error, abs=1e-9)
    turned = rotation_from_vector(np.array([0.0, 0.0, error])) @ tip.rotation[:, 0]
    np.testing.assert_allclose(turned, [-1, 0, 0], atol=1e-9)
    rate = guide(tip, SETTINGS, UP).yaw_rate_radps
    assert rate == pytest.approx(max(-0.5, min(0.5, 0.8 * error)), abs=1e-9)


def test_the_yaw_error_takes_the_short_way() -> None:
    """From 170 degrees on either side the turn is 170 degrees, not 190."""
    for degrees in (170, -170, 350, -350):
        short = (degrees + 180) % 360 - 180
        error = facing(1.0, 0.0, 0.0, math.radians(degrees)).rotation[:, 0]
        found = math.degrees(yaw_error_rad(tuple(error.tolist()), UP))
        assert found == pytest.approx(short)


def test_a_slanted_board_is_faced_by_heading_alone() -> None:
    """With the board leaning back by 20 degrees, up in its frame is tilted and yaw is about up."""
    lean = math.radians(20)
    up = (math.sin(lean), 0.0, math.cos(lean))
    level_arm = (-math.cos(lean), 0.0, math.sin(lean))
    assert yaw_error_rad(level_arm, up) == pytest.approx(0.0, abs=1e-12)
    turn = rotation_from_vector(-0.3 * np.array(up))
    turned_arm = tuple((turn @ np.array(level_arm)).tolist())
    assert yaw_error_rad(turned_arm, up) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("arm", "up"),
    [
        ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),  # a board on the floor
        ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)),  # an arm straight up
        ((-1.0, 0.0, 0.0), (math.nan, 0.0, 0.0)),
    ],
)
def test_without_a_heading_there_is_no_yaw_error(arm, up) -> None:
    """Where up says nothing about the heading, the drone does not turn."""
    assert yaw_error_rad(arm, up) == 0.0


def test_a_slanted_arm_waits() -> None:
    """The approach slows with the yaw error and stops at half a radian; aligning goes on."""
    square = guide(facing(0.5, 0.1, 0.0), SETTINGS, UP).velocity_tip_target
    slanted = guide(facing(0.5, 0.1, 0.0, 0.4), SETTINGS, UP).velocity_tip_target
    crooked = guide(facing(0.5, 0.1, 0.0, -0.6), SETTINGS, UP).velocity_tip_target
    assert square[0] < slanted[0] < crooked[0] == 0.0
    assert square[1] == slanted[1] == crooked[1] == pytest.approx(-0.08)


def test_a_far_target_is_approached_at_the_speed_limit_in_the_same_direction() -> None:
    """The wish is shortened as a whole, not cut per axis."""
    vx, vy, vz = guide(facing(2.0, 1.5, 0.0), SETTINGS, UP).velocity_tip_target
    assert math.hypot(vx, vy, vz) == pytest.approx(0.4)
    assert vy / vx == pytest.approx(0.8 * 1.5 / (0.4 * 2.025))


@pytest.mark.parametrize("name", list(GuidanceSettings.__dataclass_fields__))
@pytest.mark.parametrize("value", [-1.0, 1e6, math.nan])
def test_every_setting_is_bounded(name, value) -> None:
    """The message names the setting and its range."""
    with pytest.raises(ValueError, match=rf"^GuidanceSettings\.{name} = .* is not in \["):
        GuidanceSettings(**{name: value})


def test_arriving_before_being_in_line_is_refused() -> None:
    """k_x may not exceed k_lateral."""
    with pytest.raises(ValueError, match="before it is in line"):
        GuidanceSettings(k_x=0.9, k_lateral=0.8)
