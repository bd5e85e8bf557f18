"""Streams of random numbers: repeatable, and apart from one another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_sim.chance import MAX_SEED, stream
from contact_sim.errors import SimulatorError, WorldError

seeds = st.integers(0, MAX_SEED)
names = st.text(max_size=20)


@given(seeds, names)
def test_same_seed_and_name_give_the_same_numbers(seed, name):
    """A stream starts anew whenever it is asked for."""
    first, second = stream(seed, name).random(8), stream(seed, name).random(8)
    np.testing.assert_array_equal(first, second)


@given(seeds, st.lists(st.sampled_from(["vio", "wind", "board", "imu", "dust"]), unique=True))
def test_what_else_is_asked_for_changes_nothing(seed, others):
    """Numbers drawn from other streams before leave a stream as it is."""
    alone = stream(seed, "lidar").random(4)
    for name in others:
        stream(seed, name).random(100)
    np.testing.assert_array_equal(stream(seed, "lidar").random(4), alone)


def test_names_and_seeds_give_different_numbers():
    """Neither the name nor the seed is ignored, and their streams do not correlate."""
    drawn = np.array(
        [
            stream(seed, name).standard_normal(4000)
            for seed in (0, 1, 2**40)
            for name in ("vio", "oiv")
        ]
    )
    correlation = np.corrcoef(drawn) - np.eye(len(drawn))
    assert np.abs(correlation).max() < 0.07  # four sigma of 4000 pairs


@pytest.mark.parametrize("seed", [-1, MAX_SEED + 1])
def test_an_impossible_seed_is_refused_with_its_bounds(seed):
    """The error names the value and what it may be."""
    with pytest.raises(WorldError, match=f"from 0 to {MAX_SEED}, not {seed}") as caught:
        stream(seed, "vio")
    assert isinstance(caught.value, SimulatorError)
