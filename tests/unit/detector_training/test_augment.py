"""Augmentation: boxes follow the pixels, and what can no longer be seen is ignored."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector_training.training.augment import (
    MAX_SCALE,
    MIN_SCALE,
    augment,
    choose_window,
    crop,
    inside_share,
    map_boxes,
    random_blur,
    random_light,
    random_noise,
)


@given(
    left=st.floats(-100, 500),
    top=st.floats(-100, 400),
    scale=st.floats(MIN_SCALE, MAX_SCALE),
    mirror=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_a_mark_lands_where_its_box_says(left, top, scale, mirror):
    """A white square in the picture is found in the crop at its mapped box, mirrored or not."""
    picture = np.zeros((480, 640, 3), np.uint8)
    picture[200:241, 300:361] = 255
    box = np.array([[299.5, 199.5, 360.5, 240.5]], np.float32)
    out, picture_to_crop = crop(picture, (left, top, scale), (320, 256), mirror)
    assert out.shape == (256, 320, 3)
    want = map_boxes(box, picture_to_crop)
    if inside_share(want, 320, 256)[0] < 0.999:
        return
    white = (out[..., 0] != 114) & (out[..., 0] > 127)
    v, u = np.argwhere(white).T
    got = [u.min() - 0.5, v.min() - 0.5, u.max() + 0.5, v.max() + 0.5]
    np.testing.assert_allclose(got, want[0], atol=0.75)


def test_a_crop_of_the_whole_picture_is_the_picture():
    """Scale one, no shift: nothing changes, nor do the boxes."""
    picture = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    out, picture_to_crop = crop(picture, (0.0, 0.0, 1.0), (64, 48), mirror=False)
    assert np.array_equal(out, picture)
    np.testing.assert_allclose(picture_to_crop, [1, 1, 0, 0])


@given(seed=st.integers(0, 10**6), side=st.floats(8, 900))
@settings(max_examples=60, deadline=None)
def test_windows_have_a_bounded_scale(seed, side):
    """Whatever the target's size."""
    rng = np.random.default_rng(seed)
    boxes = np.array([[100, 100, 100 + side, 100 + side]], np.float32)
    _, _, scale = choose_window(boxes, (640, 480), (320, 256), rng)
    assert MIN_SCALE * 0.999 <= scale <= MAX_SCALE * 1.001


def test_most_windows_show_the_target():
    """Three of four are aimed at it; a far one is not shrunk to nothing then."""
    box = np.array([[500, 100, 530, 130]], np.float32)
    shown = 0
    for seed in range(200):
        left, top, scale = choose_window(box, (640, 480), (320, 256), np.random.default_rng(seed))
        u, v = (515 - left) * scale, (115 - top) * scale
        shown += 0 <= u < 320 and 0 <= v < 256
    assert shown > 140


@pytest.mark.parametrize("change", [random_light, random_blur, random_noise])
def test_light_never_turns_dark_into_light(change):
    """The order of two far shades survives every change: dark on light stays so."""
    picture = np.full((40, 40, 3), 200, np.uint8)
    picture[10:30, 10:30] = 30
    for seed in range(30):
        out = change(picture, np.random.default_rng(seed))
        assert out.dtype == np.uint8
        assert out[15:25, 15:25].mean() < out[:5].mean()


def test_the_same_seed_gives_the_same_crop():
    """Chance comes from the generator alone, OpenCV's noise included."""
    picture = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    box = np.array([[100, 80, 160, 140]], np.float32)
    arguments = (picture, box, np.array([0]), np.array([1.0], np.float32), (128, 96))
    for seed in range(10):
        a, b = (augment(*arguments, np.random.default_rng(seed)) for _ in range(2))
        assert np.array_equal(a.image, b.image)
        assert np.array_equal(a.boxes, b.boxes)


def test_a_cut_box_is_ignored_and_a_lost_one_gone():
    """Of the visible share, what the crop leaves decides."""
    picture = np.zeros((480, 640, 3), np.uint8)
    whole = np.array([[300, 200, 400, 300]], np.float32)
    for seed in range(60):
        made = augment(
            picture,
            whole,
            np.array([0]),
            np.array([1.0], np.float32),
            (320, 256),
            np.random.default_rng(seed),
        )
        share = inside_share(made.boxes, 320, 256)
        assert (share > 0).all()
        assert ((share < 0.35) <= made.ignore).all()
        assert len(made.boxes) == len(made.classes) == len(made.ignore)
