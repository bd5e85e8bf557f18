"""Numbers, plot and card of a data set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from detector_training.datasets.card import card_text, hash_dataset, read_description
from detector_training.datasets.conditions import (
    KNOWN_CONDITIONS,
    PAPER_CONDITIONS,
    paper_conditions,
)
from detector_training.datasets.convert import WRITERS
from detector_training.datasets.load import Format, Found, load_dataset
from detector_training.datasets.sample import LabelBox, make_sample
from detector_training.datasets.stats import dataset_stats, spread
from detector_training.datasets.stats_plot import formats, plot_stats
from detector_training.errors import DatasetError
from detector_training.scenes.recipe import Recipe
from target_pose.target import Level


def samples(folder: Path = Path("x")):
    box = LabelBox(Level.GOOD, (0, 0, 10, 20), 1.0)
    small = LabelBox(Level.BEST, (2, 2, 6, 5), 0.5)
    size = (64, 48)
    return [
        make_sample(folder / "a.png", size, [box, small], ("motion_blur", "far"), distance_m=2.0),
        make_sample(folder / "b.png", size, [box], ("defocus", "blur"), distance_m=4.0),
        make_sample(folder / "c.png", size, [box], ("over_exposed",), split="val"),
        make_sample(folder / "d.png", (32, 32), [], ("low_light",)),
    ]


def written(folder: Path):
    for i, sample in enumerate(found := samples(folder)):
        picture = np.full((sample.height, sample.width, 3), 40 * i, np.uint8)
        cv2.imwrite(str(sample.image), picture)
    return found


def test_conditions_are_counted_once_a_picture_with_a_target():
    """Kinds of blur are blur; what is none of the eight is told apart."""
    stats = dataset_stats(samples())
    assert stats.conditions["blur"] == 2
    assert stats.conditions["far"] == 1
    assert stats.conditions["low_light"] == 0  # of a negative
    assert stats.conditions["none of these"] == 1
    assert stats.noted == {
        "motion_blur": 1, "far": 1, "defocus": 1, "blur": 1, "over_exposed": 1, "low_light": 1,
    }  # fmt: skip
    assert paper_conditions(("tilted", "occluder", "glossy")) == ("obstruction", "orientation")


def test_every_condition_that_scenes_are_made_for_is_known():
    """Else the check would call the generator's own labels slips."""
    assert set(Recipe) <= KNOWN_CONDITIONS
    assert set(PAPER_CONDITIONS) <= set(Recipe)


def test_boxes_sizes_distances_and_splits_are_counted():
    """By level; the longer side."""
    stats = dataset_stats(samples())
    assert (stats.pictures, stats.with_target, stats.negatives) == (4, 3, 1)
    assert stats.boxes == {"T_good": 3, "T_better": 0, "T_best": 1}
    assert (stats.box_side_px["T_good"].median, stats.box_side_px["T_best"].most) == (20, 4)
    assert stats.box_side_px["T_better"] is None
    assert stats.distance_m == spread([2.0, 4.0])
    assert stats.cut == 1
    assert stats.splits == {"not said": 3, "val": 1}
    assert stats.picture_sizes == {"64x48": 3, "32x32": 1}


def test_a_data_set_without_boxes_has_numbers_too():
    """Nothing is divided by nothing."""
    stats = dataset_stats(samples()[3:])
    assert stats.boxes == {"T_good": 0, "T_better": 0, "T_best": 0}
    assert stats.distance_m is None
    assert dataset_stats([]).pictures == 0


@pytest.mark.parametrize("suffix", formats())
def test_the_plot_is_drawn_also_where_there_is_nothing_to_draw(tmp_path, suffix):
    """In each format; without boxes or distances it says so."""
    for name, chosen in (("all", samples()), ("none", samples()[3:])):
        path = tmp_path / f"{name}{suffix}"
        plot_stats(dataset_stats(chosen), chosen, path)
        assert path.stat().st_size > 5000
    assert not list(tmp_path.glob("*.part"))
    with pytest.raises(DatasetError, match="cannot write .*No such file"):
        plot_stats(dataset_stats(samples()), samples(), tmp_path / "no" / f"x{suffix}")


def test_the_card_says_what_it_must(tmp_path):
    """Numbers, licences and hashes; a cell breaks no table."""
    found = written(tmp_path)
    description = {
        "command": "python -m x | y",
        "licences": {"scikit-image": "BSD|MIT", "mine": "my own"},
        "backgrounds": {"scikit-image": ["a", "b"]},
        "split": "train",
    }
    place = Found(Format.LINES, tmp_path / "labels.jsonl", tmp_path)
    text = card_text(place, dataset_stats(found), hash_dataset(found), description)
    assert "4 pictures, 3 of them with a target and 1 without" in text
    assert "| scikit-image | BSD\\|MIT | 2 |" in text
    assert "| mine | my own | - |" in text
    assert "| blur | 2 |" in text
    assert "| train | 3 |\n| val | 1 |" in text
    assert hash_dataset(found)[0] in text
    bare = card_text(place, dataset_stats(found[3:]), ("a", "b"), {})
    assert "Not noted in the data set" in bare


def test_hashes_follow_the_content_and_not_the_format(tmp_path):
    """The same in all formats that hold everything, another when one box moves."""
    found = written(tmp_path)
    hashes = hash_dataset(found)
    for kind in (Format.LINES, Format.LABELME, Format.COCO):
        WRITERS[kind](found[::-1], tmp_path / kind)
        assert hash_dataset(load_dataset(tmp_path / kind)) == hashes
    moved = [replace(found[0], boxes=found[0].boxes + 1), *found[1:]]
    assert hash_dataset(moved)[0] == hashes[0]
    assert hash_dataset(moved)[1] != hashes[1]


def test_a_damaged_description_is_named(tmp_path):
    """None is none; a damaged one is an error."""
    assert read_description(tmp_path) == {}
    for text in ("{", "[]"):
        (tmp_path / "dataset.json").write_text(text)
        with pytest.raises(DatasetError, match=r"dataset\.json"):
            read_description(tmp_path)
