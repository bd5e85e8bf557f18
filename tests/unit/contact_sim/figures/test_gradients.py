"""The slopes are those of h, but the printed one."""

from __future__ import annotations

import numpy as np
import pytest

from contact_sim.figures.gradients import STARTS, _settings, difference, slope
from contact_sim.scene import WORLDS
from drone_client.cbf import Variant

RHO = np.geomspace(2e-3, 0.9, 40)


@pytest.mark.parametrize("variant", [Variant.CUSP, Variant.SMOOTH])
def test_the_true_slopes_are_those_of_differences(variant):
    """To a millionth."""
    barrier = _settings(variant).barrier
    np.testing.assert_allclose(slope(barrier, RHO), difference(barrier, RHO), rtol=1e-6)


def test_the_printed_one_is_too_flat_by_the_power_of_three_quarters():
    """Of the distance from the axis: docs/cbf.md, section 1."""
    printed, true = (_settings(v).barrier for v in (Variant.PAPER, Variant.CUSP))
    np.testing.assert_allclose(slope(printed, RHO) / slope(true, RHO), RHO**0.75, rtol=1e-12)
    assert not np.allclose(slope(printed, RHO), difference(printed, RHO), rtol=0.05)


def test_both_worlds_are_flown():
    """No start twice."""
    assert {world for world, _ in STARTS} == set(WORLDS)
    assert len(set(STARTS)) == len(STARTS)
