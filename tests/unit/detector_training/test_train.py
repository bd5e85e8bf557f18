"""Training: it learns, alone and with several workers, and leaves what it shall."""

from __future__ import annotations

import copy
import dataclasses

import cv2
import numpy as np
import pytest
import torch

from detector_training.datasets.sample import load_dataset
from detector_training.errors import DatasetError, TrainingError
from detector_training.training.batches import BatchSource, prefetched
from detector_training.training.loop import (
    CHECKPOINT,
    LOG,
    WARM_UP_STEPS,
    WEIGHTS,
    TrainSettings,
    schedule,
    train,
    train_step,
    update_average,
)
from detector_training.training.plot import plot_log
from detector_training.training.replicas import Replicas
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import load_weights
from target_pose.target import Level
from tests.unit.detector_training.small_runs import SIZE, TINY, use_small_crops
from tests.unit.detector_training.tiny import write_tiny


@pytest.fixture(autouse=True)
def _small_crops(monkeypatch):
    use_small_crops(monkeypatch.setattr)


def _source(samples, pictures, seed=0):
    return BatchSource(samples, pictures * SIZE[0] * SIZE[1], seed)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Four small pictures with a bullseye each."""
    return load_dataset(write_tiny(tmp_path_factory.mktemp("data")))


def _net_and_optimizer(seed=0):
    torch.manual_seed(seed)
    net = TargetNet(NetConfig(tuple(Level), 4))
    return net, torch.optim.AdamW(net.parameters(), lr=1e-3)


def test_steps_on_one_batch_lower_its_loss(samples):
    """Steps down the gradient of the same pictures: less than two thirds is left."""
    net, optimizer = _net_and_optimizer()
    batch = _source(samples, 4).make(1)
    with Replicas(net, 1, bfloat16=False) as replicas:
        losses = [float(train_step(net, replicas, optimizer, batch, 3e-3).total) for _ in range(25)]
    assert losses[-1] < 0.67 * losses[0]


def test_two_workers_sum_the_gradients_of_their_shares(samples):
    """The gradient is that of two nets that each see half of the batch."""
    net, _ = _net_and_optimizer()
    batch = _source(samples, 4).make(1)
    half = len(batch.truths) - len(batch.truths) // 2
    want: list[torch.Tensor] = []
    for part in (slice(0, half), slice(half, None)):
        alone = copy.deepcopy(net)
        share = batch._replace(images=batch.images[part], truths=batch.truths[part])
        with Replicas(alone, 1, bfloat16=False) as replicas:
            replicas.backward(share)
        weight = len(share.truths) / len(batch.truths)
        gradients = [weight * p.grad for p in alone.parameters()]
        want = [a + b for a, b in zip(want, gradients, strict=True)] if want else gradients
    with Replicas(net, 2, bfloat16=False) as replicas:
        replicas.backward(batch)
    for p, gradient in zip(net.parameters(), want, strict=True):
        torch.testing.assert_close(p.grad, gradient, rtol=1e-3, atol=1e-5)


def test_workers_share_parameters_and_statistics(samples):
    """After a step all replicas are one net again."""
    net, optimizer = _net_and_optimizer()
    source = _source(samples, 4)
    with Replicas(net, 2, bfloat16=False) as replicas:
        for step in range(2):
            train_step(net, replicas, optimizer, source.make(step), 1e-3)
        (other,) = replicas._others
        for name, tensor in net.state_dict().items():
            assert torch.equal(tensor, other.state_dict()[name]), name


def test_a_run_is_not_overwritten(samples, tmp_path):
    """Without --resume a folder with a run is refused, with another seed as well."""
    train(samples, tmp_path, TrainSettings(epochs=1, **TINY))
    with pytest.raises(TrainingError, match="--resume"):
        train(samples, tmp_path, TrainSettings(epochs=1, **TINY))
    with pytest.raises(TrainingError, match="another seed"):
        train(samples, tmp_path, TrainSettings(epochs=1, seed=7, **TINY), resume=True)


def test_a_damaged_checkpoint_is_named(samples, tmp_path):
    """One line with the file, not a stack trace."""
    (tmp_path / CHECKPOINT).write_bytes(b"PK\x03\x04 no checkpoint")
    with pytest.raises(TrainingError, match=CHECKPOINT):
        train(samples, tmp_path, TrainSettings(epochs=1, **TINY), resume=True)


def test_a_run_leaves_weights_a_log_and_a_plot(samples, tmp_path):
    """The weights load as a detector's; the plot is a picture."""
    weights = train(samples, tmp_path, TrainSettings(epochs=1, **TINY))
    assert weights == tmp_path / WEIGHTS
    assert load_weights(weights)[1].config.width == 4
    plot_log(tmp_path / LOG, tmp_path / "loss.png")
    assert cv2.imread(str(tmp_path / "loss.png")) is not None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({}, "either"),
        ({"minutes": 1.0, "epochs": 1}, "either"),
        ({"minutes": 0.0}, "minutes = 0"),
        ({"epochs": 0}, "epochs = 0"),
        ({"epochs": 1, "seed": -1}, "seed = -1"),
        ({"epochs": 1, "learning_rate": 0.0}, "learning rate"),
        ({"epochs": 1, "workers": 0}, "workers = 0"),
    ],
)
def test_settings_out_of_bounds_are_refused(arguments, says):
    """The message states the value."""
    with pytest.raises(TrainingError, match=says):
        TrainSettings(**arguments)


def test_the_schedule_warms_up_and_falls():
    """Small at first, highest after the warm-up, a fiftieth at the end."""
    assert schedule(0.0, 0) == pytest.approx(1 / WARM_UP_STEPS)
    assert schedule(0.0, WARM_UP_STEPS) == pytest.approx(1.0)
    falling = [schedule(s, 10**6) for s in np.linspace(0, 1, 20)]
    assert falling == sorted(falling, reverse=True)
    assert falling[-1] == pytest.approx(0.02)


def test_the_average_follows_fast_first_and_slowly_later():
    """Its first step takes nearly all, a late one almost nothing."""
    net, _ = _net_and_optimizer()
    start = _net_and_optimizer(1)[0]
    early, late = copy.deepcopy(start), copy.deepcopy(start)
    update_average(early, net, 1)
    update_average(late, net, 10**5)
    name = next(n for n, p in net.named_parameters() if p.ndim == 4)
    new, old = net.state_dict()[name], start.state_dict()[name]
    share = [(a.state_dict()[name] - old).norm() / (new - old).norm() for a in (early, late)]
    assert float(share[0]) > 0.99
    assert float(share[1]) == pytest.approx(0.002, rel=0.05)


def test_batches_are_a_function_of_seed_and_step(samples):
    """Made ahead in a thread or at once, the same step gives the same pictures and boxes."""
    stream = prefetched(_source(samples, 2, 3), 5)
    ahead = [next(stream) for _ in range(3)]
    stream.close()
    other = _source(samples, 2, 3)
    for step, batch in enumerate(ahead, 5):
        again = other.make(step)
        assert torch.equal(batch.images, again.images)
        for a, b in zip(batch.truths, again.truths, strict=True):
            assert torch.equal(a.boxes, b.boxes)


def test_a_lost_picture_stops_the_training_with_its_name(samples, tmp_path):
    """What goes wrong in the thread that makes batches reaches the caller."""
    lost = tuple(dataclasses.replace(s, image=tmp_path / "gone.jpg") for s in samples)
    stream = prefetched(_source(lost, 2), 0)
    with pytest.raises(DatasetError, match=r"gone\.jpg"):
        next(stream)
