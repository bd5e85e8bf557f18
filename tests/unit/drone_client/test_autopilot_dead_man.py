"""The dead man: what leaves at which age, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.dead_man import (
    ROUNDING,
    DeadManSettings,
    Refused,
    Setpoint,
    checked,
    given_up,
    leaving,
    stand_still,
)

MS = 1_000_000
NOW = 10_000 * MS
SETTINGS = DeadManSettings()


def command(*velocity: float, yaw_rate: float = 0.0, t_ns: int = NOW) -> VelocityCommand:
    return VelocityCommand(np.array(velocity), yaw_rate, t_ns)


@pytest.mark.parametrize(
    ("age_ms", "expected"),
    [(0, "flown"), (60, "flown"), (60.001, "zero"), (300, "zero"), (300.001, None), (1e6, None)],
)
def test_the_three_ages(age_ms: float, expected: str | None) -> None:
    """Flown up to 60 ms, zero up to 300 ms, then nothing."""
    newest = Setpoint((0.3, 0.0, -0.1), 0.2, NOW)
    left = leaving(newest, NOW + round(age_ms * MS), SETTINGS)
    answers = {"flown": newest, "zero": stand_still(NOW), None: None}
    assert left == answers[expected]


def test_after_a_long_silence_the_engagement_is_over() -> None:
    """At 400 ms, before PX4's COM_OF_LOSS_T of 500 ms."""
    assert not given_up(NOW, NOW + 400 * MS, SETTINGS)
    assert given_up(NOW, NOW + 400 * MS + 1, SETTINGS)


def test_without_a_command_nothing_leaves() -> None:
    """There is no setpoint that nobody asked for."""
    assert leaving(None, NOW, SETTINGS) is None


@given(
    st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3),
    st.floats(allow_nan=True, allow_infinity=True),
    st.integers(-(10**12), 10**12),
)
def test_what_passes_is_finite_slow_and_fresh(
    velocity: tuple[float, float, float], yaw_rate: float, ahead_ns: int
) -> None:
    """Whatever comes in: an answer, no exception, and never a number beyond the limits."""
    result = checked(
        command(*velocity, yaw_rate=yaw_rate, t_ns=NOW + ahead_ns), NOW, None, SETTINGS
    )
    if isinstance(result, Setpoint):
        assert math.hypot(*result.velocity_world) <= SETTINGS.speed_max_mps * ROUNDING
        assert abs(result.yaw_rate_radps) <= SETTINGS.yaw_rate_max_radps
        assert -60 * MS <= ahead_ns <= 5 * MS
    else:
        assert isinstance(result, Refused)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (command(math.nan, 0.0, 0.0), Refused.NOT_FINITE),
        (command(0.0, 0.0, 0.0, yaw_rate=math.inf), Refused.NOT_FINITE),
        (command(1.5, 1.5, 0.0), Refused.TOO_FAST),
        (command(0.0, 0.0, 0.0, yaw_rate=-2.1), Refused.TURNS_TOO_FAST),
        (command(0.0, 0.0, 0.0, t_ns=NOW + 6 * MS), Refused.FROM_THE_FUTURE),
        (command(0.0, 0.0, 0.0, t_ns=NOW - 61 * MS), Refused.OLD),
        (command(0.0, 0.0, 0.0, t_ns=NOW - 30 * MS), Refused.OLD),
        (command(0.0, 0.0), Refused.MALFORMED),
        (VelocityCommand(None, 0.0, NOW), Refused.MALFORMED),  # type: ignore[arg-type]
        (VelocityCommand(np.zeros(3), "fast", NOW), Refused.MALFORMED),  # type: ignore[arg-type]
    ],
)
def test_refusals_have_their_reason(bad: VelocityCommand, reason: Refused) -> None:
    """Each kind of bad command is refused under its own name; the newest so far is 20 ms old."""
    assert checked(bad, NOW, NOW - 20 * MS, SETTINGS) is reason


@pytest.mark.parametrize(
    "wrong",
    [
        {"zero_after_ms": 0.0},
        {"zero_after_ms": 400.0},
        {"silent_after_ms": 2000.0},
        {"silence_max_ms": 50.0},
        {"speed_max_mps": math.nan},
        {"yaw_rate_max_radps": 10.0},
        {"future_max_ms": -1.0},
    ],
)
def test_settings_are_bounded(wrong: dict[str, float]) -> None:
    """A dead man that cannot act is no setting."""
    with pytest.raises(ValueError, match="dead man"):
        DeadManSettings(**wrong)
