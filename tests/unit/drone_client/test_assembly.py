"""Pictures with a device's stamps become captures on the drone's clock."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drone_client.source.assembly import Assembler, Assembling
from tests.unit.drone_client.builders import HEIGHT, MS, SECOND, WIDTH

RGB = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
UNITS = np.zeros((HEIGHT, WIDTH), np.uint16)
HOW = Assembling.of_rate(30.0)
PERIOD_NS = 33_333_333
WAY_NS = 4 * MS


def test_at_30_hz_pairs_cannot_be_ambiguous():
    """Two tolerances fit into the least spacing."""
    assert HOW.tolerance_ns == 15 * MS
    assert 2 * HOW.tolerance_ns < HOW.spacing_ns < PERIOD_NS
    assert HOW.wait_ns == 50 * MS
    assert Assembling.of_rate(30.0, 5 * MS).tolerance_ns == 5 * MS


def feed(assembler: Assembler, first_ns: int, zero_ns: int, count: int, depth_too: bool = True):
    """Captures of a camera at 30 Hz with the given zero, and the arrival of the last picture."""
    out = []
    for n in range(count):
        true_ns = first_ns + n * PERIOD_NS
        ticks = (zero_ns + true_ns) // 1000 % (1 << 32)
        out += assembler.color(ticks, 0, true_ns + WAY_NS, RGB)
        if depth_too:
            out += assembler.depth(ticks, 0, true_ns + WAY_NS + MS, UNITS)
    return out


@given(st.integers(0, 1 << 42))
def test_a_steady_camera_gives_all_and_at_their_times(zero_ns):
    """Whatever its clock shows, the wrap included."""
    assembler = Assembler(HOW, "cam")
    out = feed(assembler, SECOND, zero_ns, 60)
    assert [c.name for c in out] == [f"cam-{n}" for n in range(60)]
    assert all(c.depth_units is not None for c in out)
    for n, capture in enumerate(out):
        late_ns = capture.t_source_ns - (SECOND + n * PERIOD_NS)
        assert WAY_NS - MS <= late_ns <= WAY_NS + MS
    assert assembler.counts()["paired"] == 60


def test_a_new_zero_costs_a_second_and_mixes_nothing():
    """What waited on the old clock is gone; time goes forward all along."""
    assembler = Assembler(HOW, "cam")
    before = feed(assembler, 0, 3000 * SECOND, 60)
    assembler.color((3000 * SECOND + 60 * PERIOD_NS) // 1000, 0, 60 * PERIOD_NS + WAY_NS, RGB)
    after = feed(assembler, 61 * PERIOD_NS, 0, 90)
    assert assembler.clock.jumps == 1
    assert len(before) == 60
    assert 55 <= len(after) <= 65  # the colour that waited went alone, then a second of nothing
    assert after[0].depth_units is None
    assert all(c.depth_units is not None for c in after[2:])
    times = [c.t_source_ns for c in (*before, *after)]
    assert all(a < b for a, b in pairwise(times))
    counts = assembler.counts()
    assert counts["odd_stamps"] + 2 * counts["paired"] >= 2 * (60 + 90) - 3


def test_what_waits_goes_out_before_a_new_start():
    """And the counts go on."""
    assembler = Assembler(HOW, "cam")
    feed(assembler, 0, 5 * SECOND, 3)
    assembler.color((5 * SECOND + 3 * PERIOD_NS) // 1000, 0, 3 * PERIOD_NS + WAY_NS, RGB)
    (last,) = assembler.restart()
    assert last.depth_units is None
    assert abs(last.t_source_ns - 3 * PERIOD_NS) < WAY_NS + MS
    feed(assembler, 9 * SECOND, 0, 3)
    assert assembler.counts() == {
        "paired": 6,
        "color_no_partner": 1,
        "backwards": 0,
        "odd_stamps": 0,
        "clock_jumps": 0,
    }


def test_a_dead_depth_sensor_delays_colour_by_two_periods_at_most():
    """It goes alone once its wait is over, seen at the next arrival."""
    assembler = Assembler(HOW, "cam")
    out = feed(assembler, 0, 0, 30, depth_too=False)
    assert len(out) == 28
    assert all(c.depth_units is None for c in out)


def test_times_go_forward_while_the_clock_is_being_learnt():
    """The first pictures took 150 ms, as they do while a camera starts, the next ones 4 ms."""
    assembler = Assembler(HOW, "cam")
    out = []
    for n in range(12):
        true_ns = SECOND + n * PERIOD_NS
        arrival_ns = max(true_ns + WAY_NS, SECOND + 150 * MS)
        out += assembler.color(true_ns // 1000, 0, arrival_ns, RGB)
        out += assembler.depth(true_ns // 1000, 0, arrival_ns, UNITS)
    times = [c.t_source_ns for c in out]
    assert all(a < b for a, b in pairwise(times))
    assert abs(times[-1] - (SECOND + 11 * PERIOD_NS)) < WAY_NS + MS
    assert assembler.counts()["backwards"] + len(out) == 12
    assert assembler.counts()["backwards"] > 0
