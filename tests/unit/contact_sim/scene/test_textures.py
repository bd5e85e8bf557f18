"""Textures: seamless, in range, and drawn by their stream alone."""

from __future__ import annotations

import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.scene import textures

SEAMLESS = [textures.rock, textures.concrete, textures.gravel, textures.cladding]
ALL = [*SEAMLESS, textures.grating, textures.dial, textures.sign]


@pytest.mark.parametrize("fade", [0.5, 1.3, 2.0])
def test_noise_is_normal_and_has_no_seam(fade):
    """Mean 0, deviation 1, and no larger step over the edge than within."""
    noise = textures.cloud(stream(1, "cloud"), 256, fade)
    assert noise.mean() == pytest.approx(0, abs=1e-4)
    assert noise.std() == pytest.approx(1, abs=1e-4)
    inside = np.abs(np.diff(noise, axis=0)).mean()
    assert np.abs(noise[0] - noise[-1]).mean() < 1.5 * inside


@pytest.mark.parametrize("draw", SEAMLESS)
def test_a_surface_has_no_seam(draw):
    """Laid side by side, the step from one to the next is as small as those within."""
    level = draw(stream(2, "look"))()[..., 1].astype(float)
    for axis in (0, 1):
        within = np.abs(np.diff(level, axis=axis)).mean(axis=1 - axis)
        over = np.abs(np.take(level, 0, axis) - np.take(level, -1, axis)).mean()
        assert over <= max(within.max(), 2 * within.mean())


@pytest.mark.parametrize("draw", ALL)
def test_a_stream_draws_one_picture(draw):
    """The same numbers give the same picture, which has light and dark in it."""
    one, again = draw(stream(3, "look"))(), draw(stream(3, "look"))()
    np.testing.assert_array_equal(one, again)
    assert one.dtype == np.uint8
    assert one.shape[2] == 3
    assert 10 < one.mean() < 220
    assert one.std() > 4


@pytest.mark.parametrize("draw", ALL)
def test_painting_moves_no_chance(draw):
    """What comes after in a stream is the same painted or not; painted twice, so is the picture."""
    unpainted, painted = stream(3, "look"), stream(3, "look")
    draw(unpainted)
    paint = draw(painted)
    np.testing.assert_array_equal(paint(), paint())
    assert painted.random() == unpainted.random()


def test_paint_keeps_its_colour():
    """Painted red is red where no rust comes through."""
    red = textures.painted_steel(stream(4, "paint"), (0.4, 0.04, 0.03))()
    middle = np.median(red.reshape(-1, 3), axis=0)
    np.testing.assert_allclose(np.square(middle / 255), (0.4, 0.04, 0.03), rtol=0.15, atol=0.01)
