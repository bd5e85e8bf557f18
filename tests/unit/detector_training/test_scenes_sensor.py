"""Lens and sensor: kernels keep the light and have the right width, noise the right strength."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from detector_training.scenes import image, sensor


def moments(kernel):
    """Mean and covariance of a kernel seen as a distribution over (x, y)."""
    half = kernel.shape[0] // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    points = np.stack([x.ravel(), y.ravel()])
    weights = kernel.ravel().astype(float)
    mean = points @ weights
    centred = points - mean[:, None]
    return mean, (centred * weights) @ centred.T


@pytest.mark.parametrize("angle", [0.0, 0.6, math.pi / 2])
def test_motion_kernel_spreads_like_a_moving_point(angle):
    """Along the motion the variance is L^2 / 12 plus the softening, across it the softening."""
    kernel = sensor.motion_kernel(9.0, angle)
    mean, covariance = moments(kernel)
    direction = np.array([math.cos(angle), math.sin(angle)])
    np.testing.assert_allclose(mean, 0, atol=0.02)
    assert kernel.sum() == pytest.approx(1)
    along = direction @ covariance @ direction
    assert along == pytest.approx(81 / 12 + 0.25 + 1 / 12, rel=0.08)


def test_disc_kernel_has_the_variance_of_a_disc():
    """A disc of radius r has variance r^2 / 4 along each axis; its centre stays."""
    mean, covariance = moments(sensor.disc_kernel(4.0))
    np.testing.assert_allclose(mean, 0, atol=1e-6)
    np.testing.assert_allclose(np.diag(covariance), 4.0, rtol=0.05)


def test_noise_is_shot_and_read_noise():
    """The spread at a level is sqrt(level / full well + read^2), and the mean stays."""
    rng = np.random.default_rng(1)
    for level in (0.02, 0.5):
        flat = np.full((200, 200, 3), level, dtype=np.float32)
        noisy = sensor.add_noise(rng, flat, 1000.0, 0.01, 0.0)
        assert noisy.mean() == pytest.approx(level, rel=0.01)
        assert noisy.std() == pytest.approx(math.sqrt(level / 1000 + 1e-4), rel=0.02)


def test_linear_light_and_srgb_are_inverse():
    """All 256 bytes survive the way to linear light and back, and middle grey is 0.2140."""
    steps = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, axis=2)
    linear = image.linear_from_srgb(steps)
    np.testing.assert_array_equal(image.srgb_from_linear(linear), steps)
    assert linear[127, 0, 0] == pytest.approx(0.2122, abs=1e-3)


def test_jpeg_keeps_red_red():
    """The bytes decode to the same picture in the same order of channels."""
    rgb = np.zeros((16, 16, 3), dtype=np.uint8)
    rgb[..., 0] = 200
    data = np.frombuffer(sensor.jpeg(rgb, 95), dtype=np.uint8)
    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert bgr[8, 8, 2] > 180
    assert bgr[8, 8, 0] < 20
