"""The net: shapes, cell order, fusion."""

from __future__ import annotations

import pytest
import torch

from edge_service.detector.boxes import cell_centers, decode
from edge_service.detector.net import PRIOR_SCORE, ConvBlock, NetConfig, TargetNet

CONFIG = NetConfig(("a", "b"), 4)


def _trained_looking(seed: int = 0) -> TargetNet:
    """A small net whose norms have statistics that are not the initial ones."""
    torch.manual_seed(seed)
    net = TargetNet(CONFIG)
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.3)
            module.running_var.uniform_(0.5, 2.0)
            torch.nn.init.normal_(module.weight, 1.0, 0.2)
            torch.nn.init.normal_(module.bias, 0.0, 0.2)
    return net.eval()


@pytest.mark.parametrize(("height", "width"), [(32, 32), (64, 96), (160, 32)])
def test_outputs_have_one_row_per_cell_and_one_box_per_class(height, width):
    """Any multiple of 32 goes in; cells of all three grids come out, as many as centres."""
    prediction = _trained_looking()(torch.rand(2, 3, height, width))
    centers, strides = cell_centers(height, width)
    n = height * width * (1 / 64 + 1 / 256 + 1 / 1024)
    assert prediction.logits.shape == (2, n, 2)
    assert prediction.distances.shape == (2, n, 2, 4)
    assert centers.shape == (n, 2)
    assert strides.shape == (n,)
    assert bool((prediction.distances > 0).all())


def test_folding_the_norms_changes_nothing():
    """The fused net answers what the net answers, and has no norm left."""
    net = _trained_looking()
    image = torch.rand(1, 3, 64, 96)
    fused = net.fused()
    assert not any(isinstance(m, torch.nn.BatchNorm2d) for m in fused.modules())
    with torch.inference_mode():
        want, got = net(image), fused(image)
    torch.testing.assert_close(got.logits, want.logits, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(got.distances, want.distances, rtol=1e-4, atol=1e-3)


def test_folding_leaves_the_net_as_it_was():
    """``fused`` is a copy: training can go on with the original."""
    net = _trained_looking()
    net.fused()
    assert all(
        isinstance(m.norm, torch.nn.BatchNorm2d) for m in net.modules() if isinstance(m, ConvBlock)
    )


def test_bf16_stays_near_fp32_and_answers_in_fp32():
    """The bf16 body shifts scores and edges by little; the outputs are full precision."""
    net = _trained_looking().fused()
    image = torch.rand(1, 3, 64, 64)
    with torch.inference_mode():
        want = net(image)
        got = net.bfloat16_body()(image.bfloat16())
    assert got.logits.dtype == got.distances.dtype == torch.float32
    assert float((got.logits - want.logits).abs().max()) < 0.2
    assert float((got.distances / want.distances - 1).abs().max()) < 0.05


def test_a_fresh_net_expects_next_to_nothing():
    """The prior keeps the first loss small: scores start near one in a hundred."""
    torch.manual_seed(0)
    with torch.inference_mode():
        scores = TargetNet(CONFIG).eval()(torch.rand(1, 3, 64, 64)).logits.sigmoid()
    assert PRIOR_SCORE / 10 < float(scores.mean()) < PRIOR_SCORE * 10


def test_every_class_has_its_own_box():
    """Cells answer differently per class: the distances do not share weights."""
    distances = _trained_looking()(torch.rand(1, 3, 64, 64)).distances.detach()
    assert float((distances[:, :, 0] - distances[:, :, 1]).abs().max()) > 1e-3


def test_cell_centers_count_from_the_centre_of_the_first_pixel():
    """A cell of stride 8 covers pixels 0 to 7, whose middle is 3.5."""
    centers, strides = cell_centers(32, 64)
    assert centers[0].tolist() == [3.5, 3.5]
    assert centers[1].tolist() == [11.5, 3.5]
    assert centers[8].tolist() == [3.5, 11.5]  # the next row
    assert centers[32].tolist() == [7.5, 7.5]  # the first cell of stride 16
    assert strides[[0, 31, 32, 39, 40]].tolist() == [8, 8, 16, 16, 32]


def test_decode_puts_the_distances_around_the_centre():
    """Left and top are subtracted, right and bottom added, per class."""
    distances = torch.tensor([[[1.0, 2, 3, 4], [5, 6, 7, 8]]])
    boxes = decode(distances, torch.tensor([[10.0, 20.0]]))
    assert boxes.tolist() == [[[9, 18, 13, 24], [5, 14, 17, 28]]]
