"""Colour and depth find each other by time: never beyond the tolerance, in order, and at best."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from drone_client.source.pairing import CAPACITY, Pairer, Unpaired, best_pairs, pair_lists
from tests.unit.drone_client.builders import MS

TIMES = st.lists(st.integers(0, 200), unique=True, max_size=8).map(sorted)
EVENTS = st.lists(st.tuples(st.booleans(), st.integers(0, 400)), max_size=120)


def worth_of(pairs, colors, depths, tolerance):
    """What a pairing is worth."""
    return sum(tolerance + 1 - abs(colors[i] - depths[j]) for i, j in pairs)


def best_worth(colors, depths, tolerance):
    """The same at best, by SciPy's assignment over all pairings, crossed ones too."""
    if not colors or not depths:
        return 0
    apart = np.abs(np.subtract.outer(colors, depths))
    worth = np.maximum(tolerance + 1 - apart, 0)
    return int(worth[linear_sum_assignment(worth, maximize=True)].sum())


@given(TIMES, TIMES, st.integers(0, 60))
def test_no_pairing_is_better(colors, depths, tolerance):
    """Against an assignment that knows nothing of order; each picture is used once."""
    pairs = best_pairs(colors, depths, tolerance)
    assert worth_of(pairs, colors, depths, tolerance) == best_worth(colors, depths, tolerance)
    assert all(abs(colors[i] - depths[j]) <= tolerance for i, j in pairs)
    assert all(a < c and b < d for (a, b), (c, d) in pairwise(pairs))


@given(st.data(), TIMES, TIMES, st.integers(0, 60))
def test_a_stream_is_paired_as_well_as_a_list(data, colors, depths, tolerance):
    """In whatever way the two streams are shuffled into one another."""
    pairer: Pairer[int, int] = Pairer(tolerance)
    order = data.draw(st.permutations([True] * len(colors) + [False] * len(depths)))
    left, right, out = iter(colors), iter(depths), []
    for is_color in order:
        out += pairer.add_color(t := next(left), t) if is_color else ()
        out += () if is_color else pairer.add_depth(t := next(right), t)
    out += pairer.flush()
    assert [p.color for p in out] == colors
    got = sum(tolerance + 1 - abs(p.color - p.depth) for p in out if p.depth is not None)
    assert got == best_worth(colors, depths, tolerance)
    assert pairer.waiting == 0
    assert pairer.paired + pairer.unpaired_color.total() == len(colors)
    assert pairer.paired + pairer.unpaired_depth.total() == len(depths)


@given(EVENTS, st.integers(0, 60), st.integers(1, 90), st.integers(1, 5))
def test_whatever_comes_the_promises_hold(events, tolerance, spacing, capacity):
    """Stamps that jump, repeat and go back: bounded, in order, each once, all accounted for."""
    pairer: Pairer[int, int] = Pairer(tolerance, spacing, capacity)
    out = []
    for number, (is_color, t) in enumerate(events):
        add = pairer.add_color if is_color else pairer.add_depth
        out += add(t, number)
        assert pairer.waiting <= 2 * capacity
    out += pairer.flush()
    stamps = [p.t_color_ns for p in out]
    assert stamps == sorted(set(stamps))
    depths = [p.depth for p in out if p.depth is not None]
    assert depths == sorted(set(depths))
    for p in out:
        assert events[p.color] == (True, p.t_color_ns)
        if p.depth is not None:
            assert events[p.depth] == (False, p.t_depth_ns)
            assert abs(p.t_color_ns - p.t_depth_ns) <= tolerance
    assert pairer.paired == len(depths)
    assert pairer.paired + pairer.unpaired_color.total() == sum(c for c, _ in events)
    assert pairer.paired + pairer.unpaired_depth.total() == sum(not c for c, _ in events)
    alone = pairer.unpaired_color[Unpaired.NO_PARTNER]
    assert len(out) == pairer.paired + alone


def test_a_pair_goes_out_as_soon_as_both_are_there():
    """At 30 Hz with 15 ms tolerance nothing that comes later can be closer."""
    pairer: Pairer[str, str] = Pairer(15 * MS, 32 * MS)
    assert pairer.add_color(0, "c0") == []
    (pair,) = pairer.add_depth(9 * MS, "d0")
    assert (pair.color, pair.depth, pair.t_depth_ns) == ("c0", "d0", 9 * MS)
    assert pairer.add_depth(42 * MS, "d1") == []
    (pair,) = pairer.add_color(33 * MS, "c1")
    assert (pair.color, pair.depth) == ("c1", "d1")


def test_a_camera_that_is_faster_than_it_says_still_pairs():
    """Said to be at 30 Hz, it gives 200: every colour finds the depth that comes right after it."""
    pairer: Pairer[int, int] = Pairer(15 * MS, 32 * MS)
    out = []
    for n in range(20):
        out += pairer.add_color(5 * MS * n, n)
        out += pairer.add_depth(5 * MS * n, n)
    assert [p.depth for p in out] == [p.color for p in out] == list(range(20))


def test_numbers_mean_nothing():
    """A depth frame is lost: the colours after it still get their own."""
    pairs = pair_lists([0, 33, 66, 99], [2, 68, 101], 10)
    assert pairs == [0, None, 1, 2]


def test_a_colour_waits_for_its_depth_and_then_goes_alone():
    """The depth that comes after it is too old, and the next pair is not disturbed."""
    pairer: Pairer[str, str] = Pairer(15 * MS, 32 * MS)
    pairer.add_color(100 * MS, "c0")
    assert pairer.release(100 * MS) == []
    (alone,) = pairer.release(101 * MS)
    assert (alone.color, alone.depth, alone.t_depth_ns) == ("c0", None, None)
    assert pairer.add_depth(103 * MS, "d0") == []
    pairer.add_color(133 * MS, "c1")
    (pair,) = pairer.add_depth(136 * MS, "d1")
    assert (pair.color, pair.depth) == ("c1", "d1")
    assert pairer.unpaired_depth == {Unpaired.TOO_OLD: 1}
    assert pairer.unpaired_color == {Unpaired.NO_PARTNER: 1}


def test_what_repeats_or_goes_back_is_named():
    """Both streams, each by itself."""
    pairer: Pairer[str, str] = Pairer(5)
    for t in (10, 10, 9):
        pairer.add_color(t, "")
        pairer.add_depth(t + 50, "")
    want = {Unpaired.DUPLICATE: 1, Unpaired.OUT_OF_ORDER: 1}
    assert pairer.unpaired_color == {**want, Unpaired.NO_PARTNER: 1}
    assert pairer.unpaired_depth == want


def test_a_sensor_that_died_does_not_fill_the_memory():
    """Depth alone is dropped; colour alone goes out late but in order."""
    pairer: Pairer[int, int] = Pairer(5)
    for t in range(0, 10_000, 100):
        assert pairer.add_depth(t, t) == []
        assert pairer.waiting <= CAPACITY
    pairer = Pairer(5)
    out = [p.color for t in range(0, 10_000, 100) for p in pairer.add_color(t, t)]
    assert out == list(range(0, 10_000 - CAPACITY * 100, 100))


@pytest.mark.parametrize("bad", [(-1, 1, 1), (0, 0, 1), (0, 1, 0)])
def test_settings_that_cannot_be_are_refused(bad):
    """A negative tolerance, no spacing, no room."""
    with pytest.raises(ValueError, match="tolerance"):
        Pairer(*bad)
