"""The commands: what they print, what they leave, one line for what is wrong."""

from __future__ import annotations

import json
import shutil
import signal

import numpy as np
import pytest
import torch
import typer
from typer.testing import CliRunner

from detector_training.commands import evaluate, train
from detector_training.commands.train_shell import stop_when_asked
from detector_training.training import batches
from edge_service.detector.weights import DEFAULT_WEIGHTS, load_weights
from tests.unit.detector_training.tiny import write_tiny

APP = typer.Typer()
train.register(APP)
evaluate.register(APP)
ONE = ("--workers", 1)
"""More threads than free cores slow a small net down."""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_tiny(tmp_path_factory.mktemp("data"))


@pytest.fixture(autouse=True)
def _small_and_on_one_thread(monkeypatch):
    """The real crops would take most of the time; torch's threads are given back."""
    monkeypatch.setattr(batches, "SIZES", ((96, 96),))
    monkeypatch.setattr(batches, "SIZE_SHARES", (1.0,))
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def _run(*arguments):
    return CliRunner().invoke(APP, [str(a) for a in arguments])


def test_train_leaves_a_run_with_weights_plot_and_scores(data, tmp_path):
    """One pass over four pictures and the report on them."""
    out = tmp_path / "run"
    result = _run("train", data, "--val", data, "--out", out, "--epochs", 1, *ONE)
    assert result.exit_code == 0, result.output
    left = {p.name for p in out.iterdir()}
    assert left == {
        "checkpoint.safetensors",
        "weights.safetensors",
        "last.safetensors",
        "log.csv",
        "loss.png",
        "crops.png",
        "val.png",
        "evaluation.json",
    }
    assert json.loads((out / "evaluation.json").read_text())["pictures"] == 4
    assert "4 pictures to train on" in result.output
    assert "recall of whole targets" in result.output


def test_evaluate_prints_json_with_levels_and_conditions(data):
    """The shipped weights on the tiny set: every level of every target is found."""
    result = _run("evaluate", DEFAULT_WEIGHTS, data, "--json", *ONE)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert set(report["rows"]) == {"all", "far"}
    assert report["rows"]["far"]["T_better"]["recall"]["value"] == 1.0
    assert report["rows"]["all"]["candidate"]["truths"] == 4


def test_evaluate_prints_a_table(data):
    """For people: a line per level."""
    result = _run("evaluate", DEFAULT_WEIGHTS, data, *ONE)
    assert result.exit_code == 0, result.output
    assert "T_best" in result.output
    assert "recall" in result.output


def test_fine_tuning_from_the_shipped_weights_with_others_mixed_in(data, tmp_path):
    """One step; labels of another name are mapped; JSON alone on stdout."""
    renamed = tmp_path / "renamed"
    shutil.copytree(data, renamed)
    labels = renamed / "labels.jsonl"
    labels.write_text(labels.read_text().replace("T_good", "rings"))
    out = tmp_path / "run"
    names = ("--map", "rings=T_good")
    mixed = ("--mix", data, "--mix-share", 0.25)
    result = _run(
        "train", renamed, "--from", "shipped", "--out", out, "--pictures", 1, "--val", data,
        "--val-pictures", 2, "--validations", 1, *names, *mixed, "--device", "cpu", "--json", *ONE,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["weights"] == str(out / "weights.safetensors")
    assert report["evaluation"]["rows"]["all"]["candidate"]["recall"]["value"] == 1.0
    assert "fine-tuning for 1 pictures seen, 25% of them of 4 others" in result.stderr
    assert "4 T_good, 4 T_better, 4 T_best" in result.stderr
    assert load_weights(out / "weights.safetensors")[1].target == "bullseye-400"


def test_a_level_without_a_box_is_warned_of(data, tmp_path):
    """A net that never sees a level unlearns it; mixed-in pictures that show it are enough."""
    outer = tmp_path / "outer"
    shutil.copytree(data, outer)
    labels = outer / "labels.jsonl"
    labels.write_text(labels.read_text().replace("T_best", "inner"))
    names = ("--ignore", "inner", "--pictures", 1, *ONE)
    result = _run("train", outer, "--out", tmp_path / "run", *names)
    assert result.exit_code == 0, result.output
    assert "no box of T_best" in result.output


def test_ctrl_c_leaves_a_run_that_goes_on_and_says_how(data, tmp_path, monkeypatch):
    """A real signal in the middle: status 130 and the command; then the rest with --resume."""
    make, told = batches.BatchSource.make, []

    def make_and_interrupt(source, step):
        if step == 4 and not told:
            told.append(step)
            signal.raise_signal(signal.SIGINT)
        return make(source, step)

    monkeypatch.setattr(batches.BatchSource, "make", make_and_interrupt)
    monkeypatch.setattr("detector_training.training.loop.draw_crops", _no_picture)
    line = ("train", data, "--out", tmp_path / "run", "--pictures", 500, *ONE)
    result = _run(*line)
    assert result.exit_code == 130, result.output
    assert "go on with:" in result.stderr
    assert "--resume" in result.stderr
    assert (tmp_path / "run" / "checkpoint.safetensors").exists()
    result = _run(*line, "--resume")
    assert result.exit_code == 0, result.output


def _no_picture(source):
    return np.zeros((8, 8, 3), np.uint8)


def test_a_second_signal_stops_at_once():
    """The first asks for the end of the step; the handlers are put back."""
    before = signal.getsignal(signal.SIGINT)
    with stop_when_asked() as stop:
        assert not stop()
        signal.raise_signal(signal.SIGTERM)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_a_damaged_picture_is_named_with_status_2(data, tmp_path):
    """It is met while the first crops are made."""
    broken = tmp_path / "broken"
    shutil.copytree(data, broken)
    for path in (broken / "images").iterdir():
        path.write_bytes(path.read_bytes()[:400])
    result = _run("train", broken, "--out", tmp_path / "run", "--epochs", 1, *ONE)
    assert result.exit_code == 2
    assert ".jpg" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("train", "tiny", "--out", "run", "--mix", "tiny"), "--mix goes with --from"),
        (("train", "tiny", "--out", "run", "--patience", 2), "give one"),
        (("train", "tiny", "--out", "run", "--device", "tpu"), "--device 'tpu'"),
        (("train", "tiny", "--out", "run", "--learning-rate", 0), "learning rate = 0"),
        (("train", "tiny", "--out", "run", "--from", "gone.safetensors"), "gone.safetensors"),
        (("train", "tiny", "--out", "run", "--map", "rings"), "NAME=LEVEL"),
        (("evaluate", "missing.safetensors", "tiny"), "missing.safetensors"),
        (("evaluate", DEFAULT_WEIGHTS, "nowhere"), "no data set in nowhere"),
        (("train", "nowhere", "--out", "run", "--epochs", 1), "no data set in nowhere"),
        (("train", "tiny", "--out", "run", "--epochs", 1, "--minutes", 1), "--minutes or --epochs"),
        (("evaluate", DEFAULT_WEIGHTS, "tiny", "--target", "cup"), "no target 'cup'"),
    ],
)
def test_what_is_wrong_is_one_line_and_exit_code_2(arguments, says, data, tmp_path, monkeypatch):
    """A missing file, folder, length or target."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny").symlink_to(data)
    result = _run(*arguments, *ONE)
    assert result.exit_code == 2
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
