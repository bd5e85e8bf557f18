"""Workers on other engines, and one whose detector is blind: as real processes."""

from __future__ import annotations

import contextlib
import json
import urllib.request
from pathlib import Path

import pytest
import torch

from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import save_weights
from target_pose.target import Level
from tests.service_process import END_S, ServiceProcess, service_process


@pytest.mark.parametrize("engine", ["onnxruntime", "openvino"])
def test_a_worker_on_another_engine_gets_ready_and_says_so(engine, tmp_path):
    """The packaged weights are converted on the way; metrics and /v1/model name the engine."""
    pytest.importorskip(engine)
    cache = tmp_path / "cache"
    env = {"EDGE_ENGINE": engine, "EDGE_MODEL_CACHE": str(cache)}
    with service_process(tmp_path, env=env) as service:
        with urllib.request.urlopen(f"http://{service.http}/v1/model", timeout=10) as answer:
            told = json.load(answer)["detector"]
        with urllib.request.urlopen(f"http://{service.http}/metrics", timeout=10) as answer:
            metrics = answer.read().decode()
        maps = Path(f"/proc/{service.process.pid}/maps").read_text()
        assert service.stop() == 0
    assert told["engine"] == engine
    assert told["threads"] == 1
    assert told["self_check"].startswith("found 3 of 3")
    assert told["detect_p50_ms"] > 0
    assert f'engine="{engine}"' in metrics
    assert f"model  bullseye-400 {told['model_hash'][:12]}, {engine} " in service.log.read_text()
    assert "libtorch" not in maps  # one runtime's pool in a process
    assert len(list(cache.iterdir())) == 1


def test_a_worker_with_untrained_weights_never_gets_ready(tmp_path):
    """It says what it did not find in one line, and ends: a rollout stops there."""
    torch.manual_seed(0)
    weights = tmp_path / "untrained.safetensors"
    save_weights(weights, TargetNet(NetConfig(tuple(lv.value for lv in Level), 4)), "bullseye-400")
    service = ServiceProcess(tmp_path, env={"EDGE_WEIGHTS": str(weights)})
    with contextlib.closing(service):
        service.start()
        assert service.process.wait(END_S) == 2
    log = service.log.read_text()
    assert "found 0 of 3 drawn targets" in log.splitlines()[-1]
    assert "ready  in" not in log
