"""Prints that are not flat: what is drawn is what the labels say, and a flat one stays flat."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from detector_training.scenes.placement import facing
from detector_training.scenes.projection import circle_points, image_from_board, square_points
from detector_training.scenes.relief import GROWTH, Relief, random_relief, shifted
from detector_training.scenes.warp import warp
from rgbd_wire.camera import CameraIntrinsics

SIDE_M = 0.4
CAMERA = CameraIntrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
POSE = facing(np.array([0.1, -0.05, 0.9]), 0.4, 1.0, 0.2)


def _flat(p):
    return np.concatenate([np.zeros((*p.shape[:-1], 1)), p], -1)


def _disc_texture(radius_m, n=400):
    c = (np.arange(n) + 0.5) / n * SIDE_M - SIDE_M / 2
    disc = (np.hypot(c[:, None], c[None, :]) < radius_m).astype(np.float32)
    return np.dstack([disc, disc, disc, np.ones_like(disc)])


def _seen_outline(relief, texture):
    """Outline (N, 2) of the white disc in the rendered picture [px]."""
    layer = warp(
        shifted(texture, SIDE_M, relief, POSE),
        GROWTH * SIDE_M,
        image_from_board(CAMERA, POSE),
        CAMERA.width,
        CAMERA.height,
    )
    picture = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    lit = layer.premultiplied[..., 0] > 0.5 * np.median(layer.premultiplied[..., 0].max())
    picture[layer.window] = 255 * lit
    contours, _ = cv2.findContours(picture, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return max(contours, key=cv2.contourArea)[:, 0].astype(float)


def test_a_flat_sheet_projects_like_the_board():
    """Without relief the outline is that of the homography."""
    relief = Relief(_flat, (1.0, 0.0, 0.0))
    points = square_points(SIDE_M)
    h = image_from_board(CAMERA, POSE)
    q = np.column_stack([points, np.ones(len(points))]) @ h.T
    np.testing.assert_allclose(relief.outline(points, CAMERA, POSE), q[:, :2] / q[:, 2:], atol=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_the_label_lies_where_the_bent_disc_is_drawn(seed):
    """Every point of the projected circle is within 2 px of the drawn edge."""
    relief = random_relief(np.random.default_rng(seed), SIDE_M)
    unshaded = Relief(relief.surface, relief.light)
    drawn = _seen_outline(unshaded, _disc_texture(0.12))
    labelled = relief.outline(circle_points(0.12), CAMERA, POSE)
    apart = np.linalg.norm(labelled[:, None] - drawn[None], axis=-1).min(1)
    assert np.quantile(apart, 0.95) < 2.0


@pytest.mark.parametrize("seed", range(20))
def test_a_sheet_keeps_its_size(seed):
    """Paper bends and does not stretch: neighbours stay about as far apart as they were."""
    relief = random_relief(np.random.default_rng(seed), SIDE_M)
    c = np.linspace(-SIDE_M / 2, SIDE_M / 2, 41)
    sheet = np.stack(np.meshgrid(c, c), -1)
    moved = relief.surface(sheet)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(moved, axis=axis), axis=-1) / (c[1] - c[0])
        assert 0.85 < np.median(step) < 1.25
