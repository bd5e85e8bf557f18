"""Held-out pictures: nothing that looks alike ends up on both sides."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector_training.datasets.sample import make_sample
from detector_training.datasets.split import group_alike, looks_of, split_groups
from detector_training.errors import DatasetError

PLACE = cv2.resize(
    np.random.default_rng(5).integers(0, 255, (12, 40, 3), dtype=np.uint8),
    (1600, 480),
    interpolation=cv2.INTER_CUBIC,
)


def sample(name: str):
    return make_sample(Path(name), (64, 48), [])


def noise_looks(count: int, seed: int = 0):
    return list(np.random.default_rng(seed).integers(0, 2**63, (count, 4), dtype=np.uint64))


@given(
    st.lists(st.integers(1, 12), min_size=2, max_size=30),
    st.floats(0.01, 0.99),
    st.integers(0, 2**31),
)
def test_groups_are_never_parted(sizes, val, seed):
    """Every picture is on one side, groups stay whole, neither side is empty."""
    numbers = np.arange(sum(sizes))
    groups = [list(g) for g in np.split(numbers, np.cumsum(sizes)[:-1])]
    samples = [sample(f"{i}.png") for i in numbers]
    halves = split_groups(samples, groups, val, seed)
    train, held = ({int(s.image.stem) for s in side} for side in (halves.train, halves.val))
    assert train
    assert held
    assert not train & held
    assert len(train) + len(held) == len(samples)
    if not halves.cut:
        assert all(set(g) <= train or set(g) <= held for g in groups)
    assert {s.split for s in halves.val} == {"val"}
    again = split_groups(samples, groups, val, seed)
    assert [s.image for s in again.val] == [s.image for s in halves.val]


def test_the_share_is_met_where_pictures_stand_alone():
    """And another seed holds out others."""
    samples = [sample(f"{i}.png") for i in range(100)]
    groups = [[i] for i in range(100)]
    halves = [split_groups(samples, groups, 0.2, seed) for seed in (1, 2)]
    assert [len(h.val) for h in halves] == [20, 20]
    assert [s.image for s in halves[0].val] != [s.image for s in halves[1].val]


def test_one_recording_alone_is_cut_in_its_order(tmp_path):
    """A camera that turns slowly: its frames are one group, its end is held out, and said so."""
    samples = []
    for i in range(20):  # frame 2 comes before frame 10
        path = tmp_path / f"frame{i}.png"
        cv2.imwrite(str(path), PLACE[:, i * 12 : i * 12 + 640])
        samples.append(make_sample(path, (640, 480), []))
    groups = group_alike(samples, looks_of(samples))
    assert len(groups) == 1
    halves = split_groups(samples, groups, 0.25, 0)
    assert halves.cut
    assert [s.image.name for s in halves.val] == [f"frame{i}.png" for i in range(15, 20)]


def test_pictures_of_different_places_stand_alone():
    """Although their numbers follow each other; but copies far apart go together."""
    looks = noise_looks(6)
    looks[5] = looks[1] ^ np.uint64(1)
    samples = [sample(f"{name}/{i}.png") for i, name in enumerate("aaaaab")]
    assert group_alike(samples, looks) == [[0], [1, 5], [2], [3], [4]]


def test_folders_can_be_kept_together():
    """Whatever their pictures look like."""
    samples = [sample(name) for name in ("a/1.png", "b/1.png", "a/2.png", "b/c/1.png")]
    assert group_alike(samples, noise_looks(4), by_folder=True) == [[0, 2], [1], [3]]


def test_dark_frames_that_follow_each_other_go_together():
    """They have no look to be told apart by."""
    samples = [sample(f"{i}.png") for i in range(3)]
    assert group_alike(samples, [None, None, noise_looks(1)[0]]) == [[0, 1], [2]]


@pytest.mark.parametrize(
    ("count", "val", "seed", "says"),
    [(5, 0.0, 1, "--val 0"), (5, 1.0, 1, "--val 1"), (1, 0.5, 1, "two"), (5, 0.5, -1, "--seed")],
)
def test_impossible_splits_are_refused(count, val, seed, says):
    """One line that names the option."""
    samples = [sample(f"{i}.png") for i in range(count)]
    with pytest.raises(DatasetError, match=says):
        split_groups(samples, [[i] for i in range(count)], val, seed)
