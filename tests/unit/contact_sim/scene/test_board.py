"""The print: its circles are where the target says, whatever became of its surface."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.scene.board import print_texture
from target_pose.target import Shade, load_target

TARGET = load_target()
SIDE_PX = 1024


def light(board, seed=0):
    """Albedo (N, N) of the print: its levels are roots."""
    texture = print_texture(TARGET, board, stream(seed, "print"), SIDE_PX)
    return np.square(texture[..., 0] / 255.0)


def test_the_share_of_black_is_that_of_the_discs():
    """The mean albedo is that of the discs' areas, worked out by hand."""
    albedo = light("clean")
    white, black = albedo[2, 2], albedo[SIDE_PX // 2, SIDE_PX // 2]
    area = 0.0
    for disc in TARGET.discs:
        sign = 1 if disc.shade is Shade.BLACK else -1
        area += sign * math.pi / 4 * disc.diameter_m**2
    wanted = white + (black - white) * area / TARGET.board_side_m**2
    assert albedo.mean() == pytest.approx(wanted, rel=2e-3)


@pytest.mark.parametrize("angle_deg", range(0, 360, 15))
def test_the_black_disc_is_round(angle_deg):
    """Its edge lies at half its diameter in every direction, to a fifth of a texel."""
    albedo = light("clean")
    middle = (SIDE_PX - 1) / 2
    reach = np.linspace(0.30, 0.42, 6000) * SIDE_PX
    towards = math.radians(angle_deg)
    x, y = middle + reach * math.cos(towards), middle + reach * math.sin(towards)
    x0, y0 = x.astype(int), y.astype(int)
    fx, fy = x - x0, y - y0
    along = (albedo[y0, x0] * (1 - fx) + albedo[y0, x0 + 1] * fx) * (1 - fy)
    along += (albedo[y0 + 1, x0] * (1 - fx) + albedo[y0 + 1, x0 + 1] * fx) * fy
    half = (albedo[2, 2] + along[0]) / 2
    radius = reach[np.argmax(along > half)] * TARGET.board_side_m / SIDE_PX
    assert radius == pytest.approx(TARGET.discs[0].diameter_m / 2, abs=1e-4)


def test_wear_leaves_the_print_readable_and_is_drawn_by_the_stream():
    """Scratches change a share of it, never the order of black and white, and repeat."""
    clean, worn = light("clean"), light("scratched")
    changed = np.abs(clean - worn) > 0.05
    assert 0.01 < changed.mean() < 0.7
    assert worn[clean > 0.5].mean() > 2.5 * worn[clean < 0.1].mean()
    np.testing.assert_array_equal(worn, light("scratched"))
    assert (worn != light("scratched", seed=1)).any()
