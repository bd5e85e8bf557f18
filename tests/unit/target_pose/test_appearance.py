"""The predicted picture of a board: against another renderer, and its derivative against steps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics
from target_pose.appearance import (
    BLUR,
    PARAMETERS,
    PEDESTAL,
    STRETCH_X,
    STRETCH_XY,
    TONE,
    Board,
    Look,
    Raster,
    predict,
)
from target_pose.circle_edges import printed_circles
from target_pose.target import load_target
from tests.unit.target_pose import render
from tests.unit.target_pose.render import facing_pose, rays, render_color

TARGET = load_target()
BOARD = Board(TARGET.board_side_m / 2, printed_circles(TARGET), white=True)
FOCAL = (385.0, 380.0)
CAMERA = CameraIntrinsics(96, 72, *FOCAL, 47.0, 36.5)


def raster(x0=8, y0=0, width=80, height=72):
    u, v = np.meshgrid(np.arange(x0, x0 + width), np.arange(y0, y0 + height))
    uv = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    return Raster(rays(uv, CAMERA), x.ravel(), y.ravel(), (height, width))


def look_of(pose, **others):
    return Look(pose.translation, pose.rotation[:, 0], pose.rotation[:, 2], **others)


def light_of(level):
    """What the other renderer's tones are in this one's units, without a tone curve."""
    return level / 255


poses = st.builds(
    lambda z, tilt, azimuth, roll: facing_pose([0.01 * z, -0.01 * z, z], tilt, azimuth, roll),
    z=st.floats(3.6, 6.5),
    tilt=st.floats(0, 1.1),
    azimuth=st.floats(0, 2 * math.pi),
    roll=st.floats(-0.7, 0.7),
)


@settings(max_examples=6, deadline=None)
@given(pose=poses, blur_px=st.floats(0.7, 2.0))
def test_it_is_what_another_renderer_draws(pose, blur_px):
    """That one casts rays at six by six points a pixel and filters; no formula is shared."""
    drawn = render_color(TARGET, CAMERA, pose, render.Look(supersample=6, blur_px=blur_px))
    # the pixel's own width blurs as well
    look = look_of(
        pose,
        blur_px2=blur_px**2 + 1 / 12,
        black=light_of(render.BLACK),
        white=light_of(render.WHITE),
        wall=(light_of(render.WALL), 0.0, 0.0),
    )
    area = raster()
    predicted = predict(area, FOCAL, BOARD, look)
    assert predicted is not None
    seen = drawn[:, 8:88, 0].ravel().astype(float)
    off = np.abs(255 * predicted.light - seen)
    # a fiftieth of the contrast; the corners of the board are round where two steps meet
    assert np.quantile(off, 0.98) < 4.5
    assert off.max() < 18.0


@settings(max_examples=6, deadline=None)
@given(pose=poses, blur_px2=st.floats(0.8, 3.0), seed=st.integers(0, 2**32 - 1))
def test_its_derivative_is_that_of_small_steps(pose, blur_px2, seed):
    """But for what is to first order, and what comes between light and code."""
    rng = np.random.default_rng(seed)
    look = look_of(
        pose,
        size=rng.normal(0, 2e-3),
        margin_m=rng.normal(0, 2e-3),
        blur_px2=blur_px2,
        black=rng.uniform(0, 0.2),
        white=rng.uniform(0.5, 1.2),
        wall=(rng.uniform(0, 1), *rng.normal(0, 0.1, 2)),
        shade=tuple(rng.normal(0, 0.1, 2)),
    )
    area = raster()
    found = predict(area, FOCAL, BOARD, look)
    assert found is not None
    for k in set(range(PARAMETERS)) - {STRETCH_X, STRETCH_XY, TONE, PEDESTAL}:
        step = np.zeros(PARAMETERS)
        # larger for turns: pictures are drawn in single precision
        step[k] = 1e-3 if k < 3 else 3e-3 if k < 6 else 1e-4
        ahead, behind = (predict(area, FOCAL, BOARD, look.moved(s * step)) for s in (1, -1))
        assert ahead is not None
        assert behind is not None
        slope = (ahead.light - behind.light) / (2 * step[k])
        off = np.linalg.norm(found.derivative[:, k] - slope)
        assert (
            off < (0.35 if k == BLUR else 0.1) * np.linalg.norm(slope) + 1e-3 * len(slope) ** 0.5
        ), k


def test_a_stretched_blur_smears_along_its_axis():
    """The first-order term against a wider filter along x: most of the difference is gone."""
    pose = facing_pose([0.0, 0.0, 5.0], 0.4, 1.0)
    more = 0.3
    still = look_of(pose, blur_px2=1.0)
    area = raster()
    plain = predict(area, FOCAL, BOARD, still)
    stretched = predict(
        area, FOCAL, BOARD, replace(still, blur_px2=1.0 + more / 2, stretch_px2=(more / 2, 0.0))
    )
    assert plain is not None
    assert stretched is not None
    taps = np.arange(-8, 9)
    kernel = np.exp(-0.5 * taps**2 / more) / np.exp(-0.5 * taps**2 / more).sum()
    image = np.pad(plain.light.reshape(area.shape), ((0, 0), (8, 8)), mode="edge")
    smeared = sum(
        w * image[:, 8 + t : 8 + t + area.shape[1]] for t, w in zip(taps, kernel, strict=True)
    )
    error = np.abs(stretched.light - smeared.ravel()).max()
    assert error < 0.2 * np.abs(plain.light - smeared.ravel()).max()


@pytest.mark.parametrize(
    "center",
    [[0.0, 0.0, 0.01], [0.0, 0.0, -2.0], [0.0, 0.0, math.nan]],
    ids=["near", "behind", "nan"],
)
def test_what_is_not_in_front_of_the_camera_has_no_picture(center):
    """None, and no warning on the way."""
    pose = facing_pose([0.0, 0.0, 5.0])
    look = replace(look_of(pose), center=np.array(center))
    assert predict(raster(), FOCAL, BOARD, look) is None


def test_a_board_seen_from_behind_has_no_picture():
    """Its normal points away from the camera."""
    pose = facing_pose([0.0, 0.0, 5.0])
    look = replace(look_of(pose), normal=-pose.rotation[:, 0])
    assert predict(raster(), FOCAL, BOARD, look) is None
