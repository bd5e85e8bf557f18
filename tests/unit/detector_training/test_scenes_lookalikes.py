"""Hard negatives: valid textures that are not the target."""

from __future__ import annotations

import numpy as np
import pytest

from detector_training.scenes import lookalikes
from target_pose.target import load_target

TARGET = load_target()
TRUE_RATIOS = np.array([1.0, 0.14 / 0.3, 0.06 / 0.3])


@pytest.mark.parametrize("name", sorted(lookalikes.DRAWERS))
def test_every_drawer_gives_premultiplied_colour(name):
    """Shape (N, N, 4), alpha in [0, 1], no colour where there is nothing, at sizes small to big."""
    drawer = lookalikes.DRAWERS[name][1]
    for seed, n in ((1, 24), (2, 90), (3, 160)):
        texture = drawer(np.random.default_rng(seed), n, TARGET)
        assert texture.shape == (n, n, 4)
        assert texture.dtype == np.float32
        alpha = texture[..., 3]
        assert alpha.min() >= 0
        assert alpha.max() <= 1 + 1e-6
        assert alpha.max() > 0.5
        assert np.all(texture[..., :3] <= 2 * alpha[..., None] + 1e-5)


def test_the_targets_own_rings_are_no_lookalike():
    """Ratios near the target's are refused as a look-alike, far ones and other counts are taken."""
    far = lookalikes.is_far_from
    assert not far(TRUE_RATIOS, TRUE_RATIOS)
    assert not far(TRUE_RATIOS * (1, 1.2, 1), TRUE_RATIOS)
    assert not far(TRUE_RATIOS * (1, 1, 1.5), TRUE_RATIOS)
    assert far(TRUE_RATIOS * (1, 1.5, 1), TRUE_RATIOS)
    assert far(TRUE_RATIOS * (1, 1, 0.4), TRUE_RATIOS)
    assert far(TRUE_RATIOS[:2], TRUE_RATIOS)


def test_inverted_is_light_where_the_target_is_dark():
    """The disc is light, the inner disc dark, the dot light."""
    n = 200
    for seed in range(6):
        texture = lookalikes.inverted(np.random.default_rng(seed), n, TARGET)
        row = texture[n // 2, :, :3].mean(-1)
        at = {r: row[n // 2 + round(r / 0.4 * n)] for r in (0.01, 0.05, 0.11)}
        assert at[0.11] > 2 * at[0.05]
        assert at[0.01] > 2 * at[0.05]


def test_rings_drawn_never_have_the_targets_ratios():
    """Ratios measured in the texture, where there are three discs, are far from the target's."""
    n, three = 300, 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        texture = lookalikes.rings_of_wrong_ratios(rng, n, TARGET)
        row = texture[n // 2, n // 2 :, :3].sum(-1)
        board = row[-1]
        inside = row[: int(0.49 * n)]
        edges = np.flatnonzero(np.abs(np.diff(inside)) > 0.15)
        groups = np.split(edges, np.flatnonzero(np.diff(edges) > 2) + 1)
        radii = np.array([g.mean() + 1 for g in groups if len(g)])[::-1]
        if len(radii) == 3 and board > 0.5:
            three += 1
            assert lookalikes.is_far_from(radii / radii[0] * (1, 1.02, 1.05), TRUE_RATIOS)
    assert three > 3
