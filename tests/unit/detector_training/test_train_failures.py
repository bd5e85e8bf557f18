"""What goes wrong in the middle: said in one line, and what was learned is kept."""

from __future__ import annotations

import dataclasses
import resource
from contextlib import closing

import numpy as np
import pytest
import torch

from detector_training.datasets.sample import load_dataset
from detector_training.errors import DatasetError, NotFiniteError, TrainingError
from detector_training.training import loop
from detector_training.training.loop import (
    CHECKPOINT,
    LAST,
    LOG,
    Sets,
    TrainSettings,
    train,
)
from detector_training.training.state import fresh_state
from edge_service.detector.weights import load_weights
from tests.unit.detector_training.small_runs import TINY, log_rows, use_small_crops
from tests.unit.detector_training.tiny import write_tiny


@pytest.fixture(autouse=True)
def _small_crops(monkeypatch):
    use_small_crops(monkeypatch.setattr)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Four small pictures with a bullseye each."""
    return load_dataset(write_tiny(tmp_path_factory.mktemp("data")))


def _from_step(patch, first, change):
    """Batches are changed on their way to the loop, from a step on."""
    plain = loop.prefetched

    def changed(source, begin):
        with closing(plain(source, begin)) as batches:
            for step, batch in enumerate(batches, begin):
                yield batch if step < first else change(batch)

    patch.setattr(loop, "prefetched", changed)


def test_a_loss_that_is_no_number_names_the_step_and_the_pictures(samples, monkeypatch, tmp_path):
    """The weights before it are kept, and the message says how to go on from them."""

    def poison(batch):
        truths = [t._replace(boxes=torch.full_like(t.boxes, 3e38)) for t in batch.truths]
        truths = [t._replace(boxes=t.boxes * torch.tensor([-1, -1, 1, 1])) for t in truths]
        return batch._replace(truths=truths)

    _from_step(monkeypatch, 3, poison)
    with pytest.raises(NotFiniteError, match=r"at step 3, of .*\.jpg") as error:
        train(samples, tmp_path, TrainSettings(epochs=4, **TINY))
    assert f"--from {tmp_path / LAST}" in str(error.value)
    assert "--learning-rate" in str(error.value)
    assert "\n" not in str(error.value)
    load_weights(tmp_path / LAST)
    assert len(log_rows(tmp_path)) == 3


def test_weights_that_run_away_at_once_say_to_start_anew(samples, tmp_path):
    """No checkpoint yet: nothing to go on from."""
    net = fresh_state(TrainSettings(epochs=1, **TINY)).net
    with torch.no_grad():
        next(net.parameters()).fill_(float("nan"))
    with pytest.raises(NotFiniteError, match="at step 0.*start anew"):
        train(samples, tmp_path, TrainSettings(epochs=1, **TINY), sets=Sets(start=net))
    assert not (tmp_path / CHECKPOINT).exists()


def test_a_picture_that_breaks_in_the_middle_is_named_and_the_run_kept(
    samples, monkeypatch, tmp_path
):
    """Damaged on disk while the run goes on; mended, the run goes on."""
    settings = TrainSettings(epochs=4, **{**TINY, "checkpoint_steps": 1000})

    def lose(batch):
        raise DatasetError("picture site/017.jpg cannot be decoded: damaged or cut off")

    with monkeypatch.context() as patch:
        _from_step(patch, 3, lose)
        with pytest.raises(DatasetError, match=r"017\.jpg.*step 3 is kept.*--resume"):
            train(samples, tmp_path, settings)
    train(samples, tmp_path, settings, resume=True)
    assert len(log_rows(tmp_path)) >= 8


def test_a_data_set_that_teaches_nothing_is_refused(samples, tmp_path):
    """Boxes too small or hidden; said before anything is written but the folder."""
    hidden = tuple(dataclasses.replace(s, visible=np.zeros_like(s.visible)) for s in samples)
    with pytest.raises(TrainingError, match="no box to learn from in 4 pictures"):
        train(hidden, tmp_path, TrainSettings(epochs=1, **TINY))
    assert not list(tmp_path.iterdir())


def test_a_validation_set_without_a_box_that_counts_is_refused(samples, tmp_path):
    """Nothing could be scored."""
    hidden = tuple(dataclasses.replace(s, visible=np.zeros_like(s.visible)) for s in samples)
    with pytest.raises(TrainingError, match="--val: none of the boxes in 4 pictures"):
        train(samples, tmp_path, TrainSettings(epochs=1, **TINY), sets=Sets(val=hidden))


def test_a_folder_that_cannot_be_written_is_named(samples, tmp_path):
    """A file stands where the folder shall be."""
    (tmp_path / "file").write_text("")
    with pytest.raises(TrainingError, match=r"cannot write to .*file"):
        train(samples, tmp_path / "file" / "run", TrainSettings(epochs=1, **TINY))


def test_a_full_disk_is_one_line_and_leaves_no_part(samples, tmp_path):
    """Files may not grow beyond 20 kB: the weights do not fit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(TrainingError, match="cannot write .*: File too large"):
            train(samples, tmp_path, TrainSettings(epochs=1, **TINY))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.glob("*.part"))


def test_a_log_of_something_else_is_named(samples, tmp_path):
    """It is not trimmed to nothing."""
    (tmp_path / LOG).write_text("time,value\n1,2\n")
    with pytest.raises(TrainingError, match=r"log\.csv"):
        train(samples, tmp_path, TrainSettings(epochs=1, **TINY))
    assert (tmp_path / LOG).read_text() == "time,value\n1,2\n"
