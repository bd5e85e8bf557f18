"""Packed weights and prepared shapes: faster ways to the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from edge_service.detector.cuda_engine import CudaEngine
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.packed import PackedConv, packed
from edge_service.detector.torch_engine import (
    MAX_SHAPES,
    SEEN_BEFORE_PREPARING,
    CpuEngine,
    Prepared,
)
from target_pose.target import Level


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(0)
    return TargetNet(NetConfig(tuple(level.value for level in Level), 4)).eval()


def pictures(batch=1, height=64, width=96, seed=0):
    rng = np.random.default_rng(seed)
    return rng.integers(0, 255, (batch, height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("batch", [1, 2])
def test_a_packed_net_answers_as_the_plain_one(net, dtype, batch):
    """Whole net, both precisions, one picture and two."""
    fused = net.fused()
    if dtype == torch.bfloat16:
        fused = fused.bfloat16_body()
    images = torch.from_numpy(pictures(batch)).permute(0, 3, 1, 2).to(dtype).div_(255)
    run = packed(fused, images)
    if dtype == torch.bfloat16 and not torch.ops.mkldnn._is_mkldnn_bf16_supported():
        assert run is None  # oneDNN packs no bf16 on such a CPU: the net stays as it is
        return
    assert run is not None
    with torch.inference_mode():
        for got, want in zip(run(images), fused(images), strict=True):
            torch.testing.assert_close(got, want, rtol=1e-4, atol=1e-4)


def test_a_packed_convolution_takes_other_shapes_too():
    """The packing is a matter of speed, not of meaning."""
    torch.manual_seed(1)
    conv = nn.Conv2d(8, 16, 3, 2, 1)
    relu = PackedConv(conv, (1, 8, 32, 32), relu=True)
    with torch.inference_mode():
        for shape in ((1, 8, 32, 32), (3, 8, 20, 44)):
            x = torch.randn(shape)
            torch.testing.assert_close(relu(x), conv(x).relu(), rtol=1e-5, atol=1e-5)


def test_a_net_that_decides_by_its_data_is_not_packed():
    """It stays as it is: slower, and right."""

    class Deciding(nn.Module):
        def forward(self, x):
            return (x, x) if x.sum() > 0 else (-x, x)

    assert packed(Deciding(), torch.ones(1, 3, 4, 4)) is None


def test_a_rewrite_that_answers_otherwise_is_not_used():
    """What was read from the batch's length cannot be the channels'; the example shows it."""

    class Odd(nn.Module):
        def forward(self, x):
            return x * len(x[0]), x

    assert packed(Odd(), torch.ones(1, 3, 4, 4)) is None


def test_a_shape_is_prepared_when_it_comes_again():
    """The first few run plain; then one is made, kept, and the oldest of too many is forgotten."""
    made = []

    def prepare(x):
        made.append(tuple(x.shape))
        return (lambda x: "fast") if len(x) < 100 else None

    prepared = Prepared(lambda x: "plain", prepare)
    x = torch.zeros(1)
    told = [prepared.run_for(x)(x) for _ in range(SEEN_BEFORE_PREPARING + 1)]
    assert told == ["plain"] * (SEEN_BEFORE_PREPARING - 1) + ["fast"] * 2
    for n in range(2, MAX_SHAPES + 2):
        prepared.run_for(torch.zeros(n), at_once=True)
    assert prepared.run_for(x)(x) == "plain"
    assert len(made) == MAX_SHAPES + 1
    strange = torch.zeros(100)
    assert prepared.run_for(strange, at_once=True)(strange) == "plain"
    assert prepared.run_for(strange)(strange) == "plain"
    assert made.count((100,)) == 1  # that it cannot be done is remembered as well


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16])
def test_the_engine_for_gpus_answers_as_that_for_cpus(net, dtype):
    """Its arithmetic, on a CPU: graphs alone need the real thing."""
    want = CpuEngine(net, torch.float32).infer(pictures(2))
    got = CudaEngine(net, dtype, device="cpu").infer(pictures(2))
    for a, b in zip(got, want, strict=True):
        assert a.dtype == np.float32
        np.testing.assert_allclose(a, b, atol=1e-4 if dtype == torch.float32 else 0.1)
