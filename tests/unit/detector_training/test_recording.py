"""The shipped recording: true to its own description, and the same when rendered again."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from detector_training.errors import DatasetError, SceneError
from detector_training.scenes import stereo
from detector_training.scenes.flight import Sway, random_sway, world_from_camera
from detector_training.scenes.recording import (
    Neighbour,
    d455,
    plan_flight,
    render_frame,
    write_recording,
)
from rgbd_wire.camera import load_camera
from rgbd_wire.geometry import Pose
from target_pose.target import load_target

SHIPPED = Path(__file__).parents[3] / "examples" / "recordings" / "rendered-approach"
SEED = 1
TARGET = load_target()


@pytest.fixture(scope="module")
def camera():
    """The camera file of the recording."""
    return load_camera(SHIPPED / "camera.json")


@pytest.fixture(scope="module")
def truth():
    """The truth of every frame."""
    return json.loads((SHIPPED / "truth.json").read_text())


def listed(name):
    """(time, rest) of every line of a TUM list."""
    lines = (SHIPPED / f"{name}.txt").read_text().splitlines()
    return [line.split(maxsplit=1) for line in lines if not line.startswith("#")]


def shipped_depth(index):
    """Raw depth of a shipped frame."""
    return cv2.imread(str(SHIPPED / listed("depth")[index][1]), cv2.IMREAD_UNCHANGED)


def shipped_color(index):
    """Colour of a shipped frame, RGB."""
    return cv2.imread(str(SHIPPED / listed("rgb")[index][1]))[:, :, ::-1]


def test_the_folder_is_whole_and_small(truth):
    """45 frames at 12 Hz, every listed file is there and nothing else, under 4.5 MB."""
    stamps = [[t for t, _ in listed(name)] for name in ("rgb", "depth", "groundtruth")]
    assert stamps[0] == stamps[1] == stamps[2]
    assert len(stamps[0]) == len(truth) == 45
    times = np.array([float(t) for t in stamps[0]])
    np.testing.assert_allclose(np.diff(times), 1 / 12, atol=2e-6)
    np.testing.assert_allclose(times, [f["t"] for f in truth])
    named = {name for kind in ("rgb", "depth") for _, name in listed(kind)}
    there = {p.relative_to(SHIPPED).as_posix() for p in SHIPPED.rglob("*") if p.is_file()}
    assert there - named == {
        "README.md", "camera.json", "depth.txt", "groundtruth.txt", "rgb.txt", "truth.json",
    }  # fmt: skip
    assert sum(p.stat().st_size for p in SHIPPED.rglob("*") if p.is_file()) < 4_500_000
    text = (SHIPPED / "README.md").read_text()
    assert "rendered, not photographed" in text
    assert "python -m detector_training recording" in text


def test_depth_lies_on_the_lattice_of_the_camera_file(camera):
    """Every value is round(A / n / scale) for a whole n, and at least a share of 80 % is there."""
    n = np.arange(1, 40_000)
    values = np.rint(camera.depth_lattice_m / n / camera.depth_scale_m)
    assert camera.depth_lattice_m == pytest.approx(camera.depth.fx * 0.095 * 32)
    for index in (0, 20, 44):
        depth = shipped_depth(index)
        assert depth.dtype == np.uint16
        assert depth.shape == (camera.depth.height, camera.depth.width)
        assert np.isin(depth[depth > 0], values).all()
        assert 0.8 < (depth > 0).mean() < 0.97


def test_poses_and_truth_describe_one_fixed_target(truth):
    """world_from_camera times camera_from_target is the same in all frames, and upright."""
    places = []
    for (_, text), frame in zip(listed("groundtruth"), truth, strict=True):
        x, y, z, qx, qy, qz, qw = (float(v) for v in text.split())
        pose = Pose(np.array([x, y, z]), np.array([qw, qx, qy, qz]))
        matrix = pose.matrix @ np.array(frame["camera_from_target"])
        places.append(matrix)
    places = np.array(places)
    np.testing.assert_allclose(places, np.broadcast_to(places[0], places.shape), atol=2e-5)
    # x of the target points west, z up: gravity is where the world says
    np.testing.assert_allclose(places[0][:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-5)


def test_the_flight_starts_blind_and_ends_close(truth):
    """Nothing to see at first, cut by the border once, then whole down to 0.8 m."""
    visible = [f["visible"] for f in truth]
    distance = [np.linalg.norm(np.array(f["camera_from_target"])[:3, 3]) for f in truth]
    assert visible[:3] == [0, 0, 0]
    assert any(0 < v < 1 for v in visible)
    assert all(v == 1 for v in visible[15:])
    assert distance[0] == pytest.approx(3.0, abs=0.15)
    assert distance[-1] == pytest.approx(0.8, abs=0.1)
    speed = np.abs(np.diff(distance)) * 12
    assert speed.max() < 1.2


def test_boxes_bound_the_projected_target(camera, truth):
    """Each level's box is that of dense points of its shape under the true pose."""
    angle = np.linspace(0, 2 * math.pi, 3600)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    square = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    k = camera.color
    for frame in truth[::4]:
        pose = Pose.from_matrix(np.array(frame["camera_from_target"]))
        for level, size in TARGET.level_m.items():
            yz = (square if level == "T_good" else circle) * size / 2
            p = pose @ np.column_stack([np.zeros(len(yz)), yz])
            u = k.fx * p[:, 0] / p[:, 2] + k.cx
            v = k.fy * p[:, 1] / p[:, 2] + k.cy
            expected = (u.min(), v.min(), u.max(), v.max())
            assert frame["boxes_px"][level] == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("index", [18, 30, 44])
def test_colour_shows_the_disc_where_the_truth_says(camera, truth, index):
    """The black ring is dark, the white rings light, at the true pose's pixels."""
    grey = shipped_color(index).mean(-1)
    pose = Pose.from_matrix(np.array(truth[index]["camera_from_target"]))
    k, angle = camera.color, np.linspace(0, 2 * math.pi, 60)
    level = {}
    for radius in (0.0, 0.05, 0.11, 0.175):
        yz = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        p = pose @ np.column_stack([np.zeros(60), yz])
        u = np.rint(k.fx * p[:, 0] / p[:, 2] + k.cx).astype(int)
        v = np.rint(k.fy * p[:, 1] / p[:, 2] + k.cy).astype(int)
        level[radius] = np.median(grey[v, u])
    assert level[0.11] < 0.6 * level[0.05]
    assert level[0.11] < 0.6 * level[0.175]
    assert level[0.0] < 0.6 * level[0.05]


@pytest.mark.parametrize("index", [18, 30, 44])
def test_depth_on_the_board_is_that_of_the_true_plane(camera, truth, index):
    """Median error over the board, seen by the depth camera, is the stated scale error."""
    depth_from_color = camera.color_from_depth.inverse()
    pose = Pose.from_matrix(np.array(truth[index]["camera_from_target"]))
    depth_from_target = depth_from_color @ pose
    normal, centre = depth_from_target.rotation[:, 0], depth_from_target.translation
    k, depth = camera.depth, shipped_depth(index)
    v, u = np.mgrid[0 : k.height, 0 : k.width]
    rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], -1)
    plane = (normal @ centre) / (rays @ normal)
    on_board = depth_from_target.inverse() @ (rays * plane[..., None]).reshape(-1, 3)
    inside = (np.abs(on_board[:, 1:]).max(1) < 0.18).reshape(u.shape) & (depth > 0)
    ratio = depth[inside] * camera.depth_scale_m / plane[inside]
    assert inside.sum() > 80
    # a lattice step at 3 m is 14 mm: the median of many pixels is good to a fraction of it
    assert np.median(ratio) == pytest.approx(1.002, abs=0.002)


def test_rendering_again_gives_the_shipped_frames():
    """The same seed gives the same arrays twice, and what was shipped (another CPU may round)."""
    flight = plan_flight(SEED, TARGET)
    first, again = render_frame(flight, 30), render_frame(flight, 30)
    np.testing.assert_array_equal(first.color, again.color)
    np.testing.assert_array_equal(first.depth, again.depth)
    jpeg_error = np.abs(first.color.astype(float) - shipped_color(30)).mean()
    assert jpeg_error < 3
    assert (first.depth == shipped_depth(30)).mean() > 0.995
    other = render_frame(plan_flight(SEED + 1, TARGET), 30)
    assert (other.depth != first.depth).mean() > 0.5


def test_a_slower_approach_is_where_the_quick_one_is_at_the_same_part_of_the_way():
    """Half the pace takes twice the time; the sway is that of the clock."""
    still = np.zeros((6, 1))
    calm = Sway(still, still, still)
    spot = np.array([0.0, 0.0, 1.5])
    for t_s in (0.0, 0.7, 1.9, 3.6):
        quick, slow = (world_from_camera(t, spot, calm, p) for t, p in ((t_s, 1.0), (2 * t_s, 0.5)))
        np.testing.assert_allclose(slow.matrix, quick.matrix, atol=1e-12)
    swaying = random_sway(np.random.default_rng(0))
    at_end = [world_from_camera(20.0, spot, swaying, pace).matrix for pace in (1.0, 0.5)]
    np.testing.assert_allclose(*at_end, atol=1e-12)


def test_a_neighbour_hangs_beside_the_target_and_changes_nothing_else():
    """A white sheet 0.5 m to the right: brighter there, and the same picture outside of it."""
    flight = plan_flight(SEED, TARGET)
    sheet = np.ones((64, 64, 4), np.float32)
    aside = Pose(np.array([0.0, 0.5, 0.0]), Pose.identity().q_wxyz)
    bare, hung = (
        render_frame(f, 30)
        for f in (flight, replace(flight, neighbours=(Neighbour(sheet, 0.3, aside),)))
    )
    lens = d455().color
    corners = np.array([[0, y, z] for y in (-0.15, 0.15) for z in (-0.15, 0.15)])
    seen = bare.camera_from_target @ aside @ corners
    uv = seen[:, :2] / seen[:, 2:] * (lens.fx, lens.fy) + (lens.cx, lens.cy)
    (u0, v0), (u1, v1) = np.rint(uv.min(0)).astype(int), np.rint(uv.max(0)).astype(int)
    assert hung.color[v0 + 4 : v1 - 4, u0 + 4 : u1 - 4].mean() > 1.3 * (
        bare.color[v0 + 4 : v1 - 4, u0 + 4 : u1 - 4].mean()
    )
    differs = np.abs(hung.color.astype(int) - bare.color).max(2) > 12
    differs[max(v0 - 12, 0) : v1 + 12, max(u0 - 12, 0) : u1 + 12] = False
    assert differs.mean() < 1e-3


def test_writing_refuses_what_it_cannot_do(tmp_path):
    """No frames, a bad seed, a folder in use: one error each; overwriting leaves nothing old."""
    with pytest.raises(SceneError, match="--frames 0"):
        write_recording(tmp_path, SEED, TARGET, "", frames=0)
    with pytest.raises(SceneError, match="--seed -1"):
        write_recording(tmp_path, -1, TARGET, "", frames=1)
    write_recording(tmp_path, SEED, TARGET, "again", frames=1)
    assert load_camera(tmp_path / "camera.json").depth_lattice_m == d455().depth_lattice_m
    with pytest.raises(DatasetError, match="holds a recording already"):
        write_recording(tmp_path, SEED, TARGET, "", frames=1)
    (tmp_path / "rgb" / "old.jpg").write_bytes(b"")
    write_recording(tmp_path, SEED, TARGET, "", frames=1, overwrite=True)
    assert len(list((tmp_path / "rgb").iterdir())) == 1


def test_stereo_shadow_agrees_with_looking_for_every_pair():
    """A pixel is unseen when a pixel to its right lands at or left of it on the other picture."""
    rng = np.random.default_rng(4)
    disparity = np.where(rng.random((6, 50)) < 0.3, 9.0, 3.0) + rng.uniform(0, 1, (6, 50))
    hidden = stereo.unseen_by_other_eye(disparity)
    for row in range(6):
        landing = np.arange(50) - disparity[row]
        for u in range(50):
            covered = any(landing[w] <= landing[u] for w in range(u + 1, 50))
            assert hidden[row, u] == (covered or landing[u] < 0)


def test_stereo_noise_is_constant_in_disparity():
    """At 1 and 3 m the spread of depth is z^2 / (f B) times the noise, the mean is scaled."""
    camera = d455()
    noise = stereo.StereoNoise(0.2, 1.0, 0.002, 0.1)
    rng = np.random.default_rng(2)
    for z in (1.0, 3.0):
        flat = np.full((camera.depth.height, camera.depth.width), z, dtype=np.float32)
        units = stereo.raw_depth(rng, flat, camera, noise)
        seen = units[units > 0] * camera.depth_scale_m
        assert np.median(seen) == pytest.approx(1.002 * z, rel=0.004)
        sigma = z * z / (camera.depth_lattice_m / 32) * 0.2
        assert seen.std() == pytest.approx(sigma, rel=0.1)
        steps = np.rint(camera.depth_lattice_m / np.arange(1, 2000) / camera.depth_scale_m)
        assert np.isin(units[units > 0], steps).all()
        away_from_border = units[:, 80:]
        assert (away_from_border == 0).mean() == pytest.approx(0.1, abs=0.06)


def test_the_flight_is_smooth():
    """From one tick of 4 ms to the next neither place nor direction jumps."""
    sway = random_sway(np.random.default_rng(1))
    spot = np.array([-0.012, 0.0, 1.45])
    poses = [world_from_camera(t / 1000, spot, sway) for t in range(0, 3700, 4)]
    places = np.array([p.translation for p in poses])
    ahead = np.array([p.rotation[:, 2] for p in poses])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 5e-3
    assert np.linalg.norm(np.diff(ahead, axis=0), axis=1).max() < 6e-3
