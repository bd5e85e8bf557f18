"""Clocks: integer nanoseconds that do not go back."""

from __future__ import annotations

import pytest

from rgbd_wire.clock import Clock, ManualClock, MonotonicClock


def test_monotonic_clock_does_not_go_back():
    """It gives whole nanoseconds, never fewer than before."""
    clock: Clock = MonotonicClock()
    stamps = [clock.now_ns() for _ in range(1000)]
    assert all(isinstance(stamp, int) for stamp in stamps)
    assert stamps == sorted(stamps)


def test_manual_clock_stands_until_it_is_moved():
    """Time passes only when a test says so."""
    clock = ManualClock(start_ns=5)
    assert (clock.now_ns(), clock.now_ns()) == (5, 5)
    clock.advance(7)
    clock.advance(0)
    assert clock.now_ns() == 12


def test_manual_clock_refuses_to_go_back():
    """A step back is a mistake of the caller, and changes nothing."""
    clock = ManualClock(start_ns=5)
    with pytest.raises(ValueError, match="-1 ns"):
        clock.advance(-1)
    assert clock.now_ns() == 5
