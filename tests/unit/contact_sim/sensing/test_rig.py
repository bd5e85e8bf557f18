"""The rig that flies by default, and how far the true one may be from it."""

from __future__ import annotations

import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.sensing import BASELINE_M, as_built, d455

FIELDS = ("fx", "fy", "cx", "cy")


def test_the_lattice_is_that_of_the_pair():
    """A = f x baseline x 32 sub-pixels, of the depth camera's own focal length."""
    rig = d455()
    assert rig.depth_lattice_m == pytest.approx(rig.depth.fx * BASELINE_M * 32)
    assert not rig.aligned


def test_a_true_rig_is_near_its_calibration_and_drawn_by_the_stream():
    """Deviations of a tenth of a percent and 0.3 px over many; sizes and places are kept."""
    rig = d455()
    for which in ("color", "depth"):
        told = getattr(rig, which)
        true = [getattr(as_built(rig, stream(seed, "rig")), which) for seed in range(400)]
        off = np.array([[getattr(i, f) - getattr(told, f) for f in FIELDS] for i in true])
        assert off[:, 0].std() / told.fx == pytest.approx(1e-3, rel=0.15)
        assert off[:, 2:].std(axis=0) == pytest.approx(np.array([0.3, 0.3]), rel=0.15)
        assert np.abs(off[:, 0] / told.fx - off[:, 1] / told.fy).max() < 1.5e-3
        assert {(i.width, i.height) for i in true} == {(told.width, told.height)}
    again = as_built(rig, stream(3, "rig"))
    assert again.color == as_built(rig, stream(3, "rig")).color
    assert again.color_from_depth is rig.color_from_depth
