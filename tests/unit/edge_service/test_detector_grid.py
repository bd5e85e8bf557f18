"""Cells in numpy: the same that the training has in torch."""

from __future__ import annotations

import numpy as np
import pytest

from edge_service.detector import boxes, grid, net


def test_the_two_grids_are_one():
    """Whatever the net answers, both readings put it in the same place."""
    assert grid.STRIDES == net.STRIDES
    for height, width in ((480, 640), (32, 96), (64, 32)):
        want = boxes.cell_centers(height, width)[0].numpy()
        np.testing.assert_array_equal(grid.cell_centers(height, width), want)


def test_the_centres_are_shared_and_cannot_be_written():
    """They are made once for a size, so nobody may change them."""
    centers = grid.cell_centers(64, 64)
    assert grid.cell_centers(64, 64) is centers
    with pytest.raises(ValueError, match="read-only"):
        centers[0] = 0


@pytest.mark.parametrize(("side", "padded"), [(1, 32), (32, 32), (33, 64), (480, 480), (623, 640)])
def test_padded_side_is_the_next_multiple(side, padded):
    """Padding never cuts and never adds a whole cell too many."""
    assert grid.padded_side(side) == padded
