"""The engine: pictures in, boxes in their own pixels out; the shipped weights find a target."""

from __future__ import annotations

import hashlib

import cv2
import numpy as np
import pytest
import torch

from edge_service.detector.engine import MAX_BOXES_PER_LEVEL, SCORE_THRESHOLD, TorchDetector
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import DEFAULT_WEIGHTS, save_weights
from edge_service.errors import EdgeError, ImageError, WeightsError
from target_pose.nesting import group
from target_pose.target import Level, load_target

TARGET = load_target()


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    """More threads than free cores make small nets slow."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def shipped():
    return TorchDetector(threads=1, precision="fp32")


@pytest.fixture(scope="module")
def untrained(tmp_path_factory):
    """A tiny net that answers at random, for everything that is not about what it finds."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(path, TargetNet(NetConfig(tuple(Level), 4)), "bullseye-400")
    return TorchDetector(path, threads=1, precision="fp32", score_threshold=1e-6)


def _scene(width=640, height=480, center=(400.0, 220.0), side=120.0, seed=0):
    """A bullseye, a little tilted, on a blotchy wall, and its true boxes by level."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(60, 150, (height // 40 + 1, width // 40 + 1, 3))
    picture = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    squeeze = np.array([0.9, 1.0])
    c, sub = np.array(center), 16
    half = side / 2 * squeeze
    corners = [tuple(np.round(x).astype(int).tolist()) for x in (c - half, c + half)]
    cv2.rectangle(picture, *corners, (205, 205, 200), -1)
    at = tuple(np.round(c * sub).astype(int).tolist())
    for disc, gray in zip(TARGET.discs, (28, 205, 28), strict=True):
        axes = np.round(half * disc.diameter_m / TARGET.board_side_m * sub).astype(int)
        cv2.ellipse(picture, at, axes.tolist(), 0, 0, 360, (gray,) * 3, -1, cv2.LINE_AA, 4)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.7) + rng.normal(0, 2, picture.shape)
    boxes = {}
    for level in Level:
        h = half * TARGET.level_m[level] / TARGET.board_side_m
        boxes[level] = np.concatenate((c - h, c + h))
    return np.clip(picture, 0, 255).astype(np.uint8), boxes


def _overlap(box, truth):
    """Intersection over union with x0, y0, x1, y1."""
    w = min(box.x1, truth[2]) - max(box.x0, truth[0])
    h = min(box.y1, truth[3]) - max(box.y0, truth[1])
    area = (box.x1 - box.x0) * (box.y1 - box.y0) + (truth[2] - truth[0]) * (truth[3] - truth[1])
    return w * h / (area - w * h) if min(w, h) > 0 else 0.0


def test_the_shipped_weights_find_a_drawn_target(shipped):
    """All three levels of one target, each on its true box, and nothing else."""
    picture, truth = _scene()
    (found,) = group(shipped.detect(picture), TARGET, picture)
    assert set(found.boxes) == set(Level)
    for level, box in found.boxes.items():
        assert _overlap(box, truth[level]) > 0.6, level
        assert box.score > SCORE_THRESHOLD


def test_a_large_picture_gives_boxes_in_its_own_pixels(shipped):
    """1280x960 is shrunk inside, the boxes are not."""
    picture, truth = _scene(1280, 960, (800.0, 440.0), 260.0)
    (found,) = group(shipped.detect(picture), TARGET, picture)
    for level, box in found.boxes.items():
        assert _overlap(box, truth[level]) > 0.6, level


def test_an_inverted_target_is_no_target(shipped):
    """Light on dark is what look-alikes are made of."""
    picture, _ = _scene()
    assert group(shipped.detect(255 - picture), TARGET, 255 - picture) == ()


@pytest.mark.parametrize(
    ("height", "width"), [(16, 16), (16, 640), (480, 17), (33, 31), (500, 333), (4096, 16)]
)
def test_odd_sizes_are_fine(untrained, height, width):
    """Any size between the bounds gives an answer: finite boxes, best first, bounded in number."""
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (height, width, 3), dtype=np.uint8)
    detections = untrained.detect(picture)
    assert set(detections.boxes) == set(Level)
    for boxes in detections.boxes.values():
        assert len(boxes) <= MAX_BOXES_PER_LEVEL
        scores = [b.score for b in boxes]
        assert scores == sorted(scores, reverse=True)
        numbers = np.array([(b.x0, b.y0, b.x1, b.y1, b.score) for b in boxes]).reshape(-1, 5)
        assert np.isfinite(numbers).all()
        assert (numbers[:, 0] < numbers[:, 2]).all()


def test_the_same_picture_gives_the_same_boxes(untrained):
    """Inference leaves nothing behind, other sizes in between included."""
    picture, _ = _scene(96, 64, (50.0, 30.0), 30.0)
    first = untrained.detect(picture)
    untrained.detect(np.zeros((40, 200, 3), np.uint8))
    assert untrained.detect(picture) == first


def test_a_view_that_is_not_contiguous_gives_the_same(untrained):
    """A mirrored or cut view of an array is as good as a copy."""
    picture, _ = _scene(96, 64, (50.0, 30.0), 30.0)
    view = picture[:, ::-1]
    assert untrained.detect(view) == untrained.detect(view.copy())


def test_a_batch_finds_what_each_picture_alone_has(untrained):
    """Pictures of several sizes, in any order: the boxes of each, where they belong."""
    scenes = [
        _scene(96, 64, (50.0, 30.0), 30.0, seed=1)[0],
        _scene(320, 240, (150.0, 110.0), 80.0, seed=2)[0],
        _scene(96, 64, (30.0, 40.0), 24.0, seed=3)[0],
    ]
    together = untrained.detect_batch(scenes)
    for got, picture in zip(together, scenes, strict=True):
        want = untrained.detect(picture)
        for level in Level:
            a, b = (
                np.array([(x.x0, x.y0, x.x1, x.y1, x.score) for x in boxes[:1]])
                for boxes in (got.boxes[level], want.boxes[level])
            )
            np.testing.assert_allclose(a, b, atol=1e-2)


def test_a_batch_of_real_pictures_has_the_target_in_each(shipped):
    """The shipped weights, two pictures through the net at once."""
    scenes = [_scene(seed=seed) for seed in (0, 1)]
    pictures = [picture for picture, _ in scenes]
    for detections, (picture, truth) in zip(shipped.detect_batch(pictures), scenes, strict=True):
        (found,) = group(detections, TARGET, picture)
        for level, box in found.boxes.items():
            assert _overlap(box, truth[level]) > 0.6, level


def test_a_batch_with_one_that_is_no_picture_raises(untrained):
    """Before the net has seen any: the caller then asks one by one."""
    with pytest.raises(ImageError, match="px"):
        untrained.detect_batch([np.zeros((64, 64, 3), np.uint8), np.zeros((8, 8, 3), np.uint8)])
    assert untrained.detect_batch([]) == []


def test_what_is_no_picture_raises(untrained):
    """A gray array is refused before the net sees it."""
    with pytest.raises(ImageError, match="shape"):
        untrained.detect(np.zeros((64, 64), np.uint8))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"precision": "int3"}, "int3"),
        ({"threads": 0}, "threads = 0"),
        ({"score_threshold": 1.0}, "score threshold"),
    ],
)
def test_arguments_out_of_bounds_raise(arguments, says):
    """The message states the value."""
    with pytest.raises(EdgeError, match=says):
        TorchDetector(**arguments)


def test_a_missing_weights_file_raises(tmp_path):
    """Said at construction, not at the first frame."""
    with pytest.raises(WeightsError, match=r"none\.safetensors"):
        TorchDetector(tmp_path / "none.safetensors")


def test_describe_names_the_model_that_runs(shipped):
    """Hash, target and precision are those of the file and of the arguments."""
    told = shipped.describe()
    assert told["model_hash"] == shipped.model_hash
    assert shipped.model_hash == hashlib.sha256(DEFAULT_WEIGHTS.read_bytes()).hexdigest()
    assert told["target"] == "bullseye-400"
    assert told["levels"] == ["T_good", "T_better", "T_best"]
    assert told["precision"] == "fp32"
    assert told["threads"] == torch.get_num_threads() == 1
    assert 1_000_000 < told["parameters"] < 2_000_000


def test_bf16_finds_the_same_target(shipped):
    """The faster precision moves the boxes by little."""
    picture, _ = _scene()
    fast = TorchDetector(threads=1, precision="bf16")
    assert fast.describe()["precision"] == "bf16"
    (want,) = group(shipped.detect(picture), TARGET, picture)
    (got,) = group(fast.detect(picture), TARGET, picture)
    for level, box in got.boxes.items():
        w = want.boxes[level]
        assert _overlap(box, (w.x0, w.y0, w.x1, w.y1)) > 0.93
