"""A run goes on after a kill as if nothing had happened; nothing foreign is gone on with."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import torch
from safetensors.torch import load_file, save_file

from detector_training.datasets.sample import load_dataset
from detector_training.errors import TrainingError
from detector_training.training.loop import CHECKPOINT, LAST, WEIGHTS, Sets, TrainSettings, train
from detector_training.training.state import fresh_state
from tests.unit.detector_training.small_runs import TINY, log_rows, use_small_crops
from tests.unit.detector_training.tiny import write_tiny

WAITS_TO_BE_KILLED = """
import sys
from pathlib import Path
from detector_training.datasets.sample import load_dataset
from detector_training.training.loop import Sets, TrainSettings, train
from tests.unit.detector_training.small_runs import TINY, use_small_crops

def wait(progress):
    if progress.step == 5:
        print("killable", flush=True)
        sys.stdin.read()

use_small_crops()
samples = load_dataset(Path(sys.argv[1]))
settings = TrainSettings(epochs=4, validations=3, **TINY)
train(samples, Path(sys.argv[2]), settings, sets=Sets(val=samples), report=wait)
"""


@pytest.fixture(autouse=True)
def _small_crops(monkeypatch):
    use_small_crops(monkeypatch.setattr)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def samples(data):
    """Four small pictures with a bullseye each."""
    return load_dataset(data)


def test_a_process_killed_at_once_resumes_to_the_same_bytes(samples, data, tmp_path):
    """SIGKILL after step 5, one step past the checkpoint; weights and log as of an unbroken run."""
    settings = TrainSettings(epochs=4, validations=3, **TINY)
    sets = Sets(val=samples)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train(samples, whole, settings, sets=sets)
    child = subprocess.Popen(
        [sys.executable, "-c", WAITS_TO_BE_KILLED, data, cut],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with child:
        assert child.stdout.readline() == "killable\n"
        child.kill()
    assert child.returncode == -9
    train(samples, cut, settings, sets=sets, resume=True)
    for name in (WEIGHTS, LAST):
        assert (cut / name).read_bytes() == (whole / name).read_bytes()
    timeless = [[{**r, "elapsed_s": 0} for r in log_rows(run)] for run in (cut, whole)]
    assert timeless[0] == timeless[1]
    assert not list(cut.glob("*.part"))


def test_the_same_seed_gives_the_same_bytes(samples, tmp_path):
    """Twice with two workers; another seed gives others."""
    runs = {}
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        settings = TrainSettings(epochs=1, seed=seed, workers=2, **TINY)
        runs[name] = train(samples, tmp_path / name, settings).read_bytes()
    assert runs["a"] == runs["b"] != runs["c"]


def test_a_checkpoint_holds_the_whole_state(samples, tmp_path):
    """Net, average, both moments of every parameter, step and settings; and it is no pickle."""
    train(samples, tmp_path, TrainSettings(epochs=1, **TINY))
    tensors = load_file(tmp_path / CHECKPOINT)
    net = fresh_state(TrainSettings(epochs=1, **TINY)).net
    n = len(list(net.parameters()))
    assert sum(name.startswith("optimizer.") for name in tensors) == 3 * n
    for part in ("net", "average"):
        assert {f"{part}.{k}" for k in net.state_dict()} <= set(tensors)


@pytest.fixture(scope="module")
def finished(samples, tmp_path_factory):
    """A checkpoint of a short run."""
    run = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        use_small_crops(patch.setattr)
        train(samples, run, TrainSettings(epochs=1, **TINY))
    return (run / CHECKPOINT).read_bytes()


def _changed(tmp_path, content, change):
    """The checkpoint with one thing changed."""
    (tmp_path / CHECKPOINT).write_bytes(content)
    tensors = load_file(tmp_path / CHECKPOINT)
    end = 8 + int.from_bytes(content[:8], "little")
    metadata = json.loads(content[8:end])["__metadata__"]
    facts = json.loads(metadata["state"])
    change(tensors, facts, metadata)
    if "state" in metadata:
        metadata["state"] = json.dumps(facts)
    save_file(tensors, tmp_path / CHECKPOINT, metadata)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t, f, m: m.update(format="other"), "'other'"),
        (lambda t, f, m: m.pop("state"), "no JSON object"),
        (lambda t, f, m: f.update(step="many"), "step is many"),
        (lambda t, f, m: f.update(step=-1), "negative"),
        (lambda t, f, m: f.update(best=float("nan")), "best is nan"),
        (lambda t, f, m: f["settings"].update(learning_rate=0.5), "another learning_rate"),
        (lambda t, f, m: f.update(origin="0"), "other pictures"),
        (lambda t, f, m: t.pop("optimizer.0.exp_avg"), "lacks 1 tensors"),
        (lambda t, f, m: t.update(extra=torch.zeros(1)), "'extra'|extra"),
        (lambda t, f, m: t.update({"optimizer.0.exp_avg": torch.zeros(2)}), r"\[2\]"),
        (lambda t, f, m: t["optimizer.0.exp_avg"].fill_(float("inf")), "not finite"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(change, says, finished, samples, tmp_path):
    """One clear error, and the file stays as it was."""
    _changed(tmp_path, finished, change)
    before = (tmp_path / CHECKPOINT).read_bytes()
    with pytest.raises(TrainingError, match=says) as error:
        train(samples, tmp_path, TrainSettings(epochs=1, **TINY), resume=True)
    assert "\n" not in str(error.value)
    assert (tmp_path / CHECKPOINT).read_bytes() == before


@pytest.mark.parametrize("keep", [0, 7, 100, -1])
def test_a_truncated_checkpoint_is_refused(keep, finished, samples, tmp_path):
    """Cut off anywhere: named, not gone on with."""
    (tmp_path / CHECKPOINT).write_bytes(finished[:keep])
    with pytest.raises(TrainingError, match=CHECKPOINT):
        train(samples, tmp_path, TrainSettings(epochs=1, **TINY), resume=True)


def test_other_pictures_are_not_gone_on_with(samples, tmp_path):
    """The message says how to start from the weights instead."""
    settings = TrainSettings(epochs=1, **TINY)
    train(samples, tmp_path, settings)
    with pytest.raises(TrainingError, match=f"--from .*{LAST}"):
        train(samples[:3], tmp_path, settings, resume=True)


def test_a_longer_run_on_other_hardware_is_a_fair_wish(samples, tmp_path):
    """Length, workers and patience may change."""
    train(samples, tmp_path, TrainSettings(epochs=1, **TINY))
    train(samples, tmp_path, TrainSettings(epochs=2, workers=2, **TINY), resume=True)
    assert int(log_rows(tmp_path)[-1]["images"]) >= 8


def test_weights_without_a_checkpoint_are_not_written_over(samples, tmp_path):
    """Somebody's weights lie in the folder: even --resume leaves them alone."""
    (tmp_path / WEIGHTS).write_bytes(b"precious")
    for resume in (False, True):
        with pytest.raises(TrainingError, match="holds weights"):
            train(samples, tmp_path, TrainSettings(epochs=1, **TINY), resume=resume)
    assert (tmp_path / WEIGHTS).read_bytes() == b"precious"


def test_a_run_that_is_asked_to_stop_loses_nothing(samples, tmp_path):
    """The step in which the wish came is saved; the rest gives the same bytes as in one go."""
    settings = TrainSettings(epochs=2, **{**TINY, "checkpoint_steps": 1000})
    whole = train(samples, tmp_path / "whole", settings).read_bytes()
    steps = []
    with pytest.raises(KeyboardInterrupt):
        train(
            samples,
            tmp_path / "cut",
            settings,
            report=lambda p: steps.append(p.step),
            stop=lambda: len(steps) == 3,
        )
    assert len(log_rows(tmp_path / "cut")) == 3
    resumed = train(samples, tmp_path / "cut", settings, resume=True)
    assert resumed.read_bytes() == whole
