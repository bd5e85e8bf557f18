"""Reading a data set: what it holds, and one line for what is wrong with it."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from detector_training.datasets.sample import load_dataset
from detector_training.errors import DatasetError

GOOD = {
    "image": "images/000000.jpg",
    "width": 64,
    "height": 48,
    "kind": "scene",
    "conditions": ["far"],
    "distance_m": 3.0,
    "boxes": [{"level": "T_better", "xyxy": [-4.0, 5.0, 20.5, 30.0], "visible": 0.8}],
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "images").mkdir()
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[..., 2] = 255  # red in OpenCV's order
    cv2.imwrite(str(tmp_path / "images" / "000000.jpg"), picture)
    _write(tmp_path, GOOD)
    return tmp_path


def _write(folder, *rows):
    text = "".join((r if isinstance(r, str) else json.dumps(r)) + "\n" for r in rows)
    (folder / "labels.jsonl").write_text(text)


def test_a_line_becomes_a_sample(folder):
    """Boxes, classes by level, visible share, conditions; the box may leave the picture."""
    (sample,) = load_dataset(folder)
    assert sample.boxes.tolist() == [[-4.0, 5.0, 20.5, 30.0]]
    assert sample.classes.tolist() == [1]
    assert sample.visible.tolist() == pytest.approx([0.8])
    assert sample.conditions == ("far",)
    assert sample.distance_m == 3.0


def test_pictures_come_as_rgb(folder):
    """Red stays red."""
    (sample,) = load_dataset(folder)
    assert sample.read()[0, 0].tolist() == pytest.approx([255, 0, 0], abs=3)


def test_a_picture_without_targets_has_empty_arrays(folder):
    """Negatives are samples too."""
    _write(folder, {**GOOD, "kind": "negative", "boxes": [], "distance_m": None})
    (sample,) = load_dataset(folder)
    assert sample.boxes.shape == (0, 4)
    assert sample.kind == "negative"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"image": "../secret.jpg"}, "leaves"),
        ({"image": "/etc/passwd"}, "leaves"),
        ({"image": ""}, "image"),
        ({"width": 0}, "width"),
        ({"width": float("inf")}, "width"),
        ({"kind": "other"}, "other"),
        ({"boxes": [{"level": "T_worst", "xyxy": [0, 0, 1, 1], "visible": 1}]}, "T_worst"),
        ({"boxes": [{"level": "T_good", "xyxy": [0, 0, 1], "visible": 1}]}, "xyxy"),
        ({"boxes": [{"level": "T_good", "xyxy": [5, 0, 1, 1], "visible": 1}]}, "x0 < x1"),
        ({"boxes": [{"level": "T_good", "xyxy": [0, 0, 1e9, 1], "visible": 1}]}, "finite"),
        ({"boxes": [{"level": "T_good", "xyxy": [0, 0, 1, 1], "visible": 2}]}, "visible"),
        ({"boxes": [{"level": "T_good", "visible": 1}]}, "lacks xyxy"),
        ({"boxes": 3}, "list"),
    ],
)
def test_a_wrong_field_is_named_with_its_line(folder, change, says):
    """The second line is at fault, and the message says so."""
    _write(folder, GOOD, {**GOOD, **change})
    with pytest.raises(DatasetError, match=f"line 2: .*{says}"):
        load_dataset(folder)


@pytest.mark.parametrize("line", ["{", "[" * 50_000, "[]", "null", '{"image": 1}', '"x"'])
def test_a_line_that_is_no_label_is_refused(folder, line):
    """Broken JSON and other JSON alike."""
    _write(folder, line)
    with pytest.raises(DatasetError, match="line 1"):
        load_dataset(folder)


def test_no_data_set_is_said_so(tmp_path):
    """An empty folder and an empty file."""
    with pytest.raises(DatasetError, match="no data set"):
        load_dataset(tmp_path)
    (tmp_path / "labels.jsonl").write_text("")
    with pytest.raises(DatasetError, match="no pictures"):
        load_dataset(tmp_path)


def test_a_missing_damaged_or_resized_picture_is_named(folder):
    """Each says which file, and what is wrong with it."""
    (sample,) = load_dataset(folder)
    cv2.imwrite(str(sample.image), np.zeros((10, 10, 3), np.uint8))
    with pytest.raises(DatasetError, match="10x10"):
        sample.read()
    sample.image.write_bytes(b"no picture")
    with pytest.raises(DatasetError, match="cannot be decoded"):
        sample.read()
    sample.image.unlink()
    with pytest.raises(DatasetError, match=r"000000\.jpg"):
        sample.read()


@pytest.mark.parametrize("distance", [0, -1, 1e9, "far", float("nan")])
def test_a_distance_that_is_none_is_refused(folder, distance):
    """It would end up in a row of its own in every report."""
    _write(folder, {**GOOD, "distance_m": distance})
    with pytest.raises(DatasetError, match="line 1"):
        load_dataset(folder)
