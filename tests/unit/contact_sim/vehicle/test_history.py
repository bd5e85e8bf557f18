"""What was believed: found by time, between two states, and never touched again."""

from __future__ import annotations

import pytest

from contact_sim.vehicle.history import KEPT, Believed, History
from rgbd_wire.quaternion import IDENTITY, about_up

ZERO = (0.0, 0.0, 0.0)
MS = 1_000_000


def flown(count: int) -> History:
    """At 1 m/s along x, a state every 4 ms."""
    history = History()
    for k in range(count):
        history.remember(Believed(4 * MS * k, (0.004 * k, 0.0, 0.0), IDENTITY, ZERO, ZERO))
    return history


@pytest.mark.parametrize("t_ms", [0, 1, 4, 50, 99, 123.4, 196])
def test_a_place_is_found_at_any_time_that_is_kept(t_ms):
    """Between two states, in proportion to the time."""
    found = flown(50).at(round(t_ms * MS))
    assert found is not None
    assert found.position[0] == pytest.approx(t_ms / 1000.0)


def test_what_is_yet_to_come_is_the_newest():
    """A stamp that is a little ahead counts as now."""
    found = flown(50).at(10_000 * MS)
    assert found is not None
    assert found.t_ns == 4 * MS * 49


def test_what_is_too_long_ago_is_not_known():
    """Before the oldest that is kept there is nothing."""
    history = flown(KEPT + 50)
    assert history.at(4 * MS * 49) is None
    assert history.at(4 * MS * 50) is not None


def test_a_correction_between_two_states_is_no_motion():
    """The place leaps by 10 cm of correction; what is found between has all of it, or none."""
    history = History()
    history.remember(Believed(0, (1.0, 0.0, 0.0), IDENTITY, ZERO, ZERO))
    moved, turned = (0.1, 0.0, 0.0), (0.0, 0.0, 0.2)
    history.remember(Believed(4 * MS, (1.104, 0.0, 0.0), about_up(0.2), moved, turned))
    early, late = history.at(1 * MS), history.at(3 * MS)
    assert early is not None
    assert late is not None
    assert early.position[0] - early.moved[0] == pytest.approx(1.001)
    assert late.position[0] - late.moved[0] == pytest.approx(1.003)
    assert (early.moved, early.turned, early.q) == (ZERO, ZERO, IDENTITY)
    assert (late.moved, late.turned, late.q) == (moved, turned, about_up(0.2))


def test_after_a_new_beginning_there_is_no_past():
    """A reset makes everything before it worthless."""
    history = flown(50)
    history.begin(Believed(200 * MS, (5.0, 0.0, 0.0), IDENTITY, ZERO, ZERO))
    assert history.at(100 * MS) is None
    found = history.at(200 * MS)
    assert found is not None
    assert found.position == (5.0, 0.0, 0.0)
