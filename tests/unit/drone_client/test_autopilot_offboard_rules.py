"""The vehicle's side of the mode that takes commands."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drone_client.autopilot import VelocityCommand
from drone_client.autopilot.dead_man import DeadManSettings
from drone_client.autopilot.offboard_rules import HOLD, LOST_AFTER_NS, OFFBOARD, OffboardRules

MS = 1_000_000
NOW_NS = 10**9


def told(rules: OffboardRules, t_ns: int, speed: float = 0.5) -> None:
    rules.command(VelocityCommand(np.array([speed, 0.0, 0.0]), 0.0, t_ns), t_ns)


def test_a_command_is_flown_in_its_mode_alone() -> None:
    """Before it is engaged, and after it is released, the vehicle stands."""
    rules = OffboardRules()
    told(rules, NOW_NS)
    assert rules.wanted(NOW_NS).velocity_world == (0.0, 0.0, 0.0)
    assert (rules.obeying, rules.idle, rules.reason) == (False, True, "in mode POSCTL")
    rules.engage(NOW_NS)
    told(rules, NOW_NS)
    assert (rules.obeying, rules.idle, rules.reason) == (True, False, "")
    assert rules.wanted(NOW_NS).velocity_world == (0.5, 0.0, 0.0)
    rules.release()
    assert rules.mode == HOLD
    assert rules.wanted(NOW_NS).velocity_world == (0.0, 0.0, 0.0)


def test_what_is_not_armed_flies_nothing() -> None:
    """The mode is there, the motors are not."""
    rules = OffboardRules(armed=False)
    rules.engage(NOW_NS)
    told(rules, NOW_NS)
    assert not rules.obeying
    assert rules.wanted(NOW_NS).velocity_world == (0.0, 0.0, 0.0)


@given(age_ms=st.integers(0, 2000))
def test_an_old_command_is_a_stop_and_then_the_failsafe(age_ms: int) -> None:
    """60 ms flown, then zero; after half a second the vehicle's own mode, for good."""
    rules = OffboardRules()
    rules.engage(NOW_NS)
    told(rules, NOW_NS)
    wanted = rules.wanted(NOW_NS + age_ms * MS)
    flown = age_ms <= DeadManSettings().zero_after_ms
    assert (wanted.velocity_world[0] > 0.0) == flown
    lost = age_ms * MS > LOST_AFTER_NS
    assert (rules.mode, rules.failsafe) == ((HOLD, "no setpoints") if lost else (OFFBOARD, ""))
    told(rules, NOW_NS + age_ms * MS)
    assert rules.obeying != lost


def test_a_pilots_switch_and_a_refused_command() -> None:
    """The mode is the pilot's to set; what is no command counts and changes nothing."""
    rules = OffboardRules()
    rules.engage(NOW_NS)
    told(rules, NOW_NS, speed=1e3)
    assert rules.refused == 1
    rules.mode = "ALTCTL"
    assert rules.idle
    assert rules.reason == "in mode ALTCTL"
    rules.release()
    assert rules.mode == "ALTCTL"
