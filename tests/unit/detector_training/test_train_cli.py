"""The commands: what they print, what they leave, one line for what is wrong."""

from __future__ import annotations

import json

import pytest
import torch
import typer
from typer.testing import CliRunner

from detector_training.commands import evaluate, train
from detector_training.training import batches
from edge_service.detector.weights import DEFAULT_WEIGHTS
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


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
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
