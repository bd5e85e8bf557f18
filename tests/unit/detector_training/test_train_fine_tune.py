"""Fine-tuning: where it starts, what it keeps, what is mixed in, and which weights are kept."""

from __future__ import annotations

import copy
import dataclasses

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from detector_training.datasets.sample import load_dataset
from detector_training.errors import TrainingError
from detector_training.training.batches import BatchSource
from detector_training.training.gradient import InOnePiece
from detector_training.training.loop import (
    CROPS,
    LAST,
    LOG,
    WEIGHTS,
    Sets,
    TrainSettings,
    train,
)
from detector_training.training.pictures import draw_finds
from detector_training.training.plot import plot_log
from detector_training.training.replicas import Replicas
from detector_training.training.state import fresh_state
from detector_training.training.summary import summarise
from detector_training.training.validation import Validation, ValScore, evenly, val_score
from edge_service.detector.weights import DEFAULT_WEIGHTS, load_weights
from target_pose.candidate import Box, Detections
from target_pose.target import load_target
from tests.unit.detector_training.small_runs import SIZE, TINY, log_rows, use_small_crops
from tests.unit.detector_training.tiny import write_tiny

TUNE = {**TINY, "learning_rate": 1e-6, "warm_up_steps": 1, "keep_norms": True}


@pytest.fixture(autouse=True)
def _small_crops(monkeypatch):
    use_small_crops(monkeypatch.setattr)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Four small pictures with a bullseye each."""
    return load_dataset(write_tiny(tmp_path_factory.mktemp("data")))


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """Four more in another folder."""
    return load_dataset(write_tiny(tmp_path_factory.mktemp("others")))


@pytest.fixture
def one_thread():
    """Other numbers of threads sum in another order, and a fresh net's best cells are near ties."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def start():
    """A net with norm statistics of its own."""
    torch.manual_seed(5)
    net = fresh_state(TrainSettings(epochs=1, **TINY)).net
    for name, buffer in net.named_buffers():
        if buffer.is_floating_point():
            buffer.uniform_(0.5, 2.0, generator=torch.Generator().manual_seed(len(name)))
    return net


def test_fine_tuning_starts_where_the_weights_are(samples, start, tmp_path):
    """At a tiny rate they barely move; the norms' statistics stay to the bit."""
    tuned = load_file(train(samples, tmp_path, TrainSettings(epochs=1, **TUNE), sets=Sets(start)))
    before = start.state_dict()
    statistics = {n for n, b in start.named_buffers() if b.is_floating_point()}
    assert statistics
    for name, tensor in tuned.items():
        torch.testing.assert_close(tensor, before[name], rtol=1e-3, atol=1e-4)
        if name in statistics:
            assert torch.equal(tensor, before[name]), name
    assert any(not torch.equal(t, before[n]) for n, t in tuned.items())


def test_norms_learn_where_they_are_asked_to(samples, start, tmp_path):
    """Without keep_norms the statistics move towards the pictures'."""
    settings = TrainSettings(epochs=1, **{**TUNE, "keep_norms": False})
    tuned = load_file(train(samples, tmp_path, settings, sets=Sets(start)))
    before = start.state_dict()
    assert any(
        not torch.equal(tuned[n], before[n])
        for n, b in start.named_buffers()
        if b.is_floating_point()
    )


def test_kept_statistics_stay_to_the_bit_with_three_workers(samples, start):
    """The mean of three equal numbers may round to another: it is not taken."""
    batch = BatchSource(samples, 4 * SIZE[0] * SIZE[1], 0).make(1)
    net = copy.deepcopy(start).eval()
    with Replicas(net, 3, bfloat16=False) as replicas:
        replicas.backward(batch)
    for mine, theirs in zip(net.buffers(), start.buffers(), strict=True):
        assert torch.equal(mine, theirs)
    assert all(torch.isfinite(p.grad).all() for p in net.parameters())


def test_a_batch_in_one_piece_has_the_gradient_of_one_worker(samples, start, one_thread):
    """What a GPU runs, on the CPU: the same numbers as a single replica."""
    batch = BatchSource(samples, 4 * SIZE[0] * SIZE[1], 0).make(1)
    alone, whole = copy.deepcopy(start).train(), copy.deepcopy(start).train()
    with Replicas(alone, 1, bfloat16=False) as gradient:
        want = gradient.backward(batch)
    with InOnePiece(whole, bfloat16=False) as gradient:
        found = gradient.backward(batch)
    assert found == want
    for a, b in zip(whole.parameters(), alone.parameters(), strict=True):
        assert torch.equal(a.grad, b.grad)


def test_mixing_takes_its_share_from_the_other_set(samples, others):
    """Of 400 crops about a quarter; the pictures are named as they were drawn."""
    source = BatchSource(samples, 4 * SIZE[0] * SIZE[1], 0, others, 0.25)
    names = [p for step in range(100) for p in source.make(step).pictures]
    foreign = sum(p in {s.image for s in others} for p in names)
    assert len(names) == 400
    assert 60 < foreign < 140  # 100 expected, 4.6 standard deviations either way


def test_without_mixing_the_batches_stay_as_they_were(samples, others):
    """A share of 0 draws no other chance."""
    plain, none = (
        BatchSource(samples, 2 * SIZE[0] * SIZE[1], 7, *mixed).make(3)
        for mixed in ((), (others, 0.0))
    )
    assert torch.equal(plain.images, none.images)
    assert plain.pictures == none.pictures


def test_another_width_is_refused(samples, start, tmp_path):
    """The settings must be those of the weights."""
    with pytest.raises(TrainingError, match="width 4, the settings say 8"):
        train(
            samples,
            tmp_path,
            TrainSettings(epochs=1, **{**TUNE, "width": 8}),
            sets=Sets(start),
        )


def test_the_weights_on_the_way_are_scored_and_logged(samples, tmp_path):
    """Three scores in three lines of the log; a plot with their curve."""
    settings = TrainSettings(epochs=3, validations=3, **TINY)
    told = []
    train(samples, tmp_path, settings, sets=Sets(val=samples), report=lambda p: told.append(p.val))
    rows = [r for r in log_rows(tmp_path) if r["val_ap50_95"]]
    assert len(rows) == 3 == sum(v is not None for v in told)
    plot_log(tmp_path / LOG, tmp_path / "loss.png")
    height, width = cv2.imread(str(tmp_path / "loss.png")).shape[:2]
    assert width > 3 * height
    assert cv2.imread(str(tmp_path / CROPS)) is not None


def test_the_best_weights_are_kept_and_patience_ends_the_run(samples, monkeypatch, tmp_path):
    """Scores 0.1, 0.9, 0.5, 0.4: those of the second stay, the run ends after the fourth."""
    scores = iter((0.1, 0.9, 0.5, 0.4))
    seen = []

    def score(self, net):
        seen.append(copy.deepcopy(net.state_dict()))
        return ValScore(next(scores), 0.0, 0.0)

    monkeypatch.setattr(Validation, "score", score)
    settings = TrainSettings(epochs=10, validations=10, patience=2, **TINY)
    train(samples, tmp_path, settings, sets=Sets(val=samples))
    assert len(seen) == 4
    best, last = load_file(tmp_path / WEIGHTS), load_file(tmp_path / LAST)
    assert all(torch.equal(t, seen[1][n]) for n, t in best.items())
    assert all(torch.equal(t, seen[3][n]) for n, t in last.items())


def test_the_shipped_weights_score_high_on_plain_targets(samples):
    """The whole path from a net to a score, with a net that knows the target."""
    net, _ = load_weights(DEFAULT_WEIGHTS)
    validation = Validation(samples, load_target(), 3)
    finds = validation.finds(net)
    assert len(finds) == 3
    assert val_score(finds).recall == 1.0
    assert val_score(finds).ap50_95 > 0.5
    assert draw_finds(finds).shape == (192, 3 * 256, 3)


def test_true_boxes_score_one_and_none_zero(samples):
    """The scale of what the best weights are chosen by."""
    validation = Validation(samples, load_target(), 10)
    nothing = validation.finds(fresh_state(TrainSettings(epochs=1, **TINY)).net.eval())
    perfect = tuple(
        dataclasses.replace(
            f,
            detections=Detections({b.level: (Box(*b.xyxy, 0.9),) for b in f.sample.labels}),
        )
        for f in nothing
    )
    assert val_score(perfect).ap50_95 == pytest.approx(1.0)
    blind = tuple(dataclasses.replace(f, detections=Detections({})) for f in nothing)
    assert val_score(blind).ap50_95 == 0.0


@pytest.mark.parametrize(("count", "most"), [(10, 3), (3, 10), (7, 7), (100, 99)])
def test_an_even_choice_has_no_double(count, most):
    """In the order of the set, from its first on."""
    chosen = evenly(tuple(range(count)), most)
    assert len(chosen) == min(count, most)
    assert sorted(set(chosen)) == list(chosen)
    assert chosen[0] == 0


def test_the_summary_counts_what_is_taught(samples):
    """A negative, a hidden box and a level that nobody labelled."""
    empty = dataclasses.replace(
        samples[0],
        boxes=np.zeros((0, 4), np.float32),
        classes=np.zeros(0, np.int64),
        visible=np.zeros(0, np.float32),
    )
    outer = [dataclasses.replace(s, **_only(s, 0)) for s in samples[1:]]
    hidden = dataclasses.replace(outer[0], visible=np.zeros(1, np.float32))
    summary = summarise([empty, *outer, hidden])
    assert summary.boxes == {"T_good": 3, "T_better": 0, "T_best": 0}
    assert summary.missing == ("T_better", "T_best")
    assert (summary.pictures, summary.negatives, summary.ignored) == (5, 1, 1)
    assert "25.0% of the boxes ignored" in str(summary)


def _only(sample, level):
    keep = sample.classes == level
    return {name: getattr(sample, name)[keep] for name in ("boxes", "classes", "visible")}
