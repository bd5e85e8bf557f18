"""The bench of fine-tuning with tiny counts: it runs through and goes on."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
import torch

from detector_training.datasets.sample import CLASSES
from detector_training.scenes.printed import Paint
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import save_weights
from tests.perf import bench_finetune
from tests.perf.bench_finetune import Faded
from tests.unit.detector_training.small_runs import use_small_crops


@pytest.fixture(autouse=True)
def _small_crops_and_threads_given_back(monkeypatch):
    use_small_crops(monkeypatch.setattr)
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def test_it_measures_before_and_after_and_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    """Two pictures of each kind, one step of a small net; the second call trains nothing."""
    sizes = ["--own", "2", "--mixed", "2", "--count", "2", "--pictures", "1", "--jobs", "1"]
    weights = tmp_path / "small.safetensors"
    save_weights(weights, TargetNet(NetConfig(CLASSES, 4)), "bullseye-400")
    sizes += ["--weights", str(weights)]
    places = ["--package-root", str(tmp_path), "--work", str(tmp_path / "work")]
    monkeypatch.setattr(sys, "argv", ["bench", *sizes, *places, "--recipe", "nominal", "--json"])
    bench_finetune.main()
    first = json.loads(capsys.readouterr().out)
    assert set(first["rows"]) == {"shipped", "tuned, mixed", "tuned alone"}
    for row in first["rows"].values():
        assert [m["pictures"] for m in row.values()] == [2, 2]
    monkeypatch.setattr(sys, "argv", sys.argv[:-1])
    bench_finetune.main()
    assert "| tuned alone | general-test |" in capsys.readouterr().out


def test_the_faded_print_stays_dark_on_light():
    """Else it would be another target."""
    paint = Paint(np.full(3, 0.8, np.float32), np.full(3, 0.05, np.float32))
    albedo = Faded()(200, paint).mean(-1)
    assert albedo[100, 2] > 1.8 * albedo.min()
    assert albedo.min() > 0.2
