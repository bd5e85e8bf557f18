"""Depth of scenes: true where the picture says, noisy as stated, and no picture changes for it."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from detector_training.backgrounds import Split
from detector_training.scenes import DatasetRequest, Library, generate, write_dataset
from detector_training.scenes.depth import (
    MAX_DISPARITY_PX,
    SCALE_M,
    DepthNoise,
    DepthSensor,
    depth_of,
    measured,
    random_noise,
)
from detector_training.scenes.geometry import Flat, Geometry, true_depth
from detector_training.scenes.placement import facing
from detector_training.scenes.projection import image_from_board
from detector_training.scenes.recipe import Recipe
from detector_training.scenes.relief import GROWTH, random_relief, shifted
from detector_training.scenes.warp import Layer, warp
from rgbd_wire.camera import CameraIntrinsics
from target_pose.target import load_target

TARGET = load_target()
CAMERA = CameraIntrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
EXACT = DepthNoise(sigma_per_m=0.0, hole_share=0.0)


def hung(pose, side_m=TARGET.board_side_m, texture=None):
    """An opaque square as the generator hangs it."""
    texture = np.ones((400, 400, 4), np.float32) if texture is None else texture
    layer = warp(texture, side_m, image_from_board(CAMERA, pose), 640, 480)
    assert layer is not None
    return Flat(pose, layer)


def scene(backdrop_m=5.0, wall=None, lookalikes=(), board=None, relief=None, in_front=()):
    """A scene in front of a wall that is parallel to the picture."""
    backdrop = np.full((480, 640), backdrop_m, np.float32)
    return Geometry(CAMERA, backdrop, False, wall, lookalikes, board, relief, in_front)


def board_coordinates(pose):
    """Depth (480, 640) of the board's plane, and where on the board each pixel looks (.., 2)."""
    v, u = np.mgrid[0:480, 0:640]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], 2)
    normal = pose.rotation[:, 0]
    plane = (normal @ pose.translation) / (rays @ normal)
    return plane, ((rays * plane[..., None] - pose.translation) @ pose.rotation)[..., 1:]


@pytest.mark.parametrize("z", [0.8, 2.0, 4.0])
def test_noise_has_the_stated_sigma_and_scale(z):
    """On a plane at z: sigma 2.5e-3 z^2, the mean scaled, whole millimetres."""
    rng = np.random.default_rng(1)
    flat = np.full((480, 640), z, np.float32)
    units = measured(rng, flat, 400.0, DepthNoise(scale_error=0.004, hole_share=0.2))
    assert units.dtype == np.uint16
    seen = units[units > 0] * SCALE_M
    assert np.median(seen) == pytest.approx(1.004 * z, rel=5e-4)
    expected = np.hypot(2.5e-3 * (1.004 * z) ** 2, SCALE_M / np.sqrt(12))
    assert seen.std() == pytest.approx(expected, rel=0.04)


def test_noise_is_alike_over_two_to_three_pixels():
    """Its autocorrelation falls to 1/e between 2 and 3 pixels, along rows and columns."""
    units = measured(
        np.random.default_rng(2), np.full((480, 640), 2.0, np.float32), 400.0, DepthNoise()
    )
    noise = np.where(units > 0, units - np.median(units[units > 0]), np.nan)
    for turned in (noise, noise.T):
        variance = np.nanmean(turned**2)
        alike = [np.nanmean(turned[:, k:] * turned[:, :-k]) / variance for k in (1, 2, 3, 5)]
        assert alike[0] > alike[1] > 1 / np.e > alike[2]
        assert alike[3] < 0.05


@pytest.mark.parametrize("share", [0.1, 0.3, 0.45])
def test_holes_have_the_share_that_was_drawn(share):
    """Patches fill up what shadows leave of the share; they are patches, not salt."""
    flat = np.full((480, 640), 2.0, np.float32)
    flat[100:300, 300:400] = 1.0
    units = measured(np.random.default_rng(3), flat, 400.0, DepthNoise(hole_share=share))
    holes = units == 0
    assert holes.mean() == pytest.approx(share, abs=2e-3)
    beside = holes[:, 1:] & holes[:, :-1]
    assert beside.sum() > 0.9 * holes.sum()


def test_shadows_lie_to_the_left_of_what_is_near():
    """As wide as the difference of the disparities; what is too near has no depth at all."""
    flat = np.full((480, 640), 2.0, np.float32)
    flat[100:300, 300:400] = 0.5
    units = measured(np.random.default_rng(4), flat, 400.0, EXACT)
    width = 400 * 0.095 * (1 / 0.5 - 1 / 2.0)
    assert (units[200, 200:300] == 0).sum() == pytest.approx(width, abs=1.5)
    assert (units[200, 300:] > 0).all()
    too_near = np.full((480, 640), 0.9 * 400 * 0.095 / MAX_DISPARITY_PX, np.float32)
    assert not measured(np.random.default_rng(4), too_near, 400.0, EXACT).any()


def test_sensors_differ_within_what_is_stated():
    """Scale errors of 0.2 to 0.5 % either way, 10 to 45 % holes, and all of that range is used."""
    rng = np.random.default_rng(5)
    drawn = [random_noise(rng) for _ in range(400)]
    errors = np.array([n.scale_error for n in drawn])
    shares = np.array([n.hole_share for n in drawn])
    assert 0.002 <= np.abs(errors).min() < 0.0022
    assert 0.0048 < np.abs(errors).max() <= 0.005
    assert 0.4 < (errors > 0).mean() < 0.6
    assert 0.10 <= shares.min() < 0.12
    assert 0.43 < shares.max() <= 0.45


def test_the_board_and_its_wall_are_where_the_pose_says():
    """Depth of both is that of the plane through the pose; the rest is behind."""
    pose = facing(np.array([0.1, -0.05, 1.6]), 0.7, 0.4, 0.1)
    depth = true_depth(np.random.default_rng(6), scene(1.0, wall=hung(pose, 0.9), board=hung(pose)))
    plane, yz = board_coordinates(pose)
    on_wall = np.abs(yz).max(-1) < 0.44
    np.testing.assert_allclose(depth[on_wall], plane[on_wall], rtol=1e-4)
    away = np.abs(yz).max(-1) > 0.46
    board = np.abs(yz).max(-1) < 0.2
    # one factor for the whole backdrop, and no more than it needs
    assert np.ptp(depth[away]) == 0
    assert plane[board].max() < depth[away][0] < 1.05 * plane[board].max()


def test_a_backdrop_that_is_far_enough_stays():
    """Nothing is scaled that is behind the board as it is."""
    pose = facing(np.array([0.0, 0.0, 1.6]), 0.3, 0.0, 0.0)
    depth = true_depth(np.random.default_rng(0), scene(3.0, board=hung(pose)))
    assert depth.max() == pytest.approx(3.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_bent_print_has_the_depth_of_its_points(seed):
    """Points of the sheet, projected one by one, have the depth of the pixel they fall on."""
    relief = random_relief(np.random.default_rng(seed), TARGET.board_side_m)
    pose = facing(np.array([0.0, 0.02, 0.9]), 0.25, 1.0, 0.0)
    side = TARGET.board_side_m
    texture = shifted(np.ones((400, 400, 4), np.float32), side, relief, pose)
    board = hung(pose, GROWTH * side, texture)
    depth = true_depth(np.random.default_rng(0), scene(board=board, relief=relief))
    at = np.linspace(-0.4 * side, 0.4 * side, 25)
    points = pose @ relief.surface(np.stack(np.meshgrid(at, at), -1).reshape(-1, 2))
    u = np.rint(CAMERA.fx * points[:, 0] / points[:, 2] + CAMERA.cx).astype(int)
    v = np.rint(CAMERA.fy * points[:, 1] / points[:, 2] + CAMERA.cy).astype(int)
    error = depth[v, u] - points[:, 2]
    # half a pixel on a steep part; where the sheet hides itself the nearer part is seen
    assert np.median(np.abs(error)) < 5e-4
    assert np.quantile(np.abs(error), 0.9) < 3e-3


def test_what_hangs_in_between_has_its_own_depth_and_the_rest_is_printed():
    """A look-alike before the wall keeps its place; one that would be behind it lies on it."""
    near = facing(np.array([-0.6, 0.0, 2.0]), 0.0, 0.0, 0.0)
    far = facing(np.array([1.0, 0.0, 3.5]), 0.0, 0.0, 0.0)
    rng = np.random.default_rng(0)
    both = true_depth(rng, scene(3.0, lookalikes=(hung(near), hung(far))))
    plane, yz = board_coordinates(near)
    inside = np.abs(yz).max(-1) < 0.19
    np.testing.assert_allclose(both[inside], plane[inside], rtol=1e-4)
    alone = true_depth(rng, scene(3.0, lookalikes=(hung(near),)))
    np.testing.assert_array_equal(both, alone)


def test_things_in_front_are_nearer_than_all_that_they_hide():
    """A cover has one depth, less than the board's; where it is thin the board shows."""
    pose = facing(np.array([0.0, 0.0, 1.5]), 0.4, 0.0, 0.0)
    cover = np.zeros((480, 640), np.float32)
    cover[200:260, 300:500], cover[300:320, 300:500] = 1.0, 0.3
    without = true_depth(np.random.default_rng(0), scene(board=hung(pose)))
    depth = true_depth(np.random.default_rng(0), scene(board=hung(pose), in_front=(cover,)))
    assert np.ptp(depth[cover > 0.5]) == 0
    assert depth[230, 400] < without[cover > 0.5].min()
    np.testing.assert_array_equal(depth[cover < 0.5], without[cover < 0.5])


def test_a_plane_behind_the_camera_is_not_there():
    """Rays that leave a plane behind give no negative depth."""
    away = facing(np.array([0.0, 0.0, -1.0]), 0.0, 0.0, 0.0)
    layer = Layer(0, 0, np.ones((480, 640, 3), np.float32), np.ones((480, 640), np.float32))
    depth = true_depth(np.random.default_rng(0), scene(lookalikes=(Flat(away, layer),)))
    assert (depth == 5.0).all()


def test_depth_of_generated_scenes_is_that_of_the_target():
    """The median over the board is its plane's, but for the scale error and what noise averages to.

    A tenth has no depth at all; true depth is finite and positive everywhere.
    """
    checked, blind = 0, 0
    for index in range(30):
        seed = (21, index)
        made = generate(seed, Library((), ()), TARGET, Recipe.NOMINAL)
        truth = true_depth(np.random.default_rng(index), made.geometry)
        assert np.isfinite(truth).all()
        assert (truth > 0).all()
        units = depth_of(seed, made.geometry)
        np.testing.assert_array_equal(units, depth_of(seed, made.geometry))
        if not units.any():
            blind += 1
            continue
        if not made.boxes or "distortion" in made.conditions or made.boxes[0].visible < 0.99:
            continue
        x0, y0, x1, y1 = (round(v) for v in made.boxes[2].xyxy)
        part = units[y0 : y1 + 1, x0 : x1 + 1]
        z = made.camera_from_target.translation[2]
        if (part > 0).mean() > 0.6 and x1 - x0 > 20:
            slack = 0.0055 * z + 1e-3 * z * z
            assert np.median(part[part > 0]) * SCALE_M == pytest.approx(z, abs=slack)
            checked += 1
    assert checked >= 6
    assert 1 <= blind <= 8


def test_a_data_set_with_depth_has_the_same_pictures(tmp_path):
    """Labels gain three keys, dataset.json the scale; nothing else changes, nor with two jobs."""

    def written(name, depth, jobs=1, overwrite=False):
        request = DatasetRequest(4, 9, Split.TEST, "bullseye-400", (), Recipe.MIXED, depth)
        told = write_dataset(tmp_path / name, request, "", jobs, overwrite)
        lines = (tmp_path / name / "labels.jsonl").read_text().splitlines()
        return told, [json.loads(line) for line in lines]

    plain, without = written("plain", DepthSensor.NONE)
    deep, labels = written("deep", DepthSensor.D455, jobs=2)
    assert plain["depth"] is None
    assert not (tmp_path / "plain" / "depth").exists()
    assert deep["depth"]["scale_m"] == 0.001
    for a, b in zip(without, labels, strict=True):
        depth = cv2.imread(str(tmp_path / "deep" / b.pop("depth")), cv2.IMREAD_UNCHANGED)
        assert (depth.dtype, depth.shape) == (np.uint16, (480, 640))
        assert set(b.pop("camera")) == {"fx", "fy", "cx", "cy"}
        pose = b.pop("camera_from_target")
        if b["boxes"]:
            assert np.linalg.norm(np.array(pose)[:3, 3]) == pytest.approx(b["distance_m"], abs=1e-4)
        else:
            assert pose is None
        assert a == b
        images = [(tmp_path / name / a["image"]).read_bytes() for name in ("plain", "deep")]
        assert images[0] == images[1]
    written("deep", DepthSensor.NONE, overwrite=True)
    assert not list((tmp_path / "deep" / "depth").iterdir())
