"""The net: plain 3x3 convolutions, a path-aggregation neck and one box per class in each cell.

The three levels of a target are concentric, so a head that regresses one box per cell and then
names its class makes them fight for the same cells. Here every cell gives each class its own score
and its own four distances (docs: paper, Section II-B names the levels).

Built from published ideas, in plain torch: short cuts that fold away (Ding et al., RepVGG, 2021),
path aggregation (Liu et al., PANet, 2018), anchor-free distances (Tian et al., FCOS, 2019).
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

STRIDES = (8, 16, 32)
"""Pixels per cell of the three output grids."""

SIZE_MULTIPLE_PX = STRIDES[-1]
"""Both sides of an input are multiples of this."""

PRIOR_SCORE = 0.01
"""What an untrained cell answers: almost every cell holds no target (RetinaNet's prior)."""


@dataclass(frozen=True, slots=True)
class NetConfig:
    """What it takes to build the net: its weights' shapes follow from this alone."""

    classes: tuple[str, ...]
    width: int
    """Channels after the first convolution; every other layer is a multiple of it."""


class Prediction(NamedTuple):
    """Raw output for a batch; N is the number of cells of all three grids, C of classes."""

    logits: Tensor  # (B, N, C)
    """Score of each class before the sigmoid."""
    distances: Tensor  # (B, N, C, 4)
    """Left, top, right and bottom distance from the cell's centre to the box [px]."""


class ConvBlock(nn.Module):
    """Convolution, batch norm, ReLU (cheap on a CPU in both directions).

    With ``shortcut`` the input is added before the ReLU; fused, that is one more tap in the middle
    of the kernel and costs nothing (Ding et al., "RepVGG", 2021).
    """

    def __init__(
        self, c_in: int, c_out: int, kernel: int = 1, stride: int = 1, shortcut: bool = False
    ) -> None:
        super().__init__()
        assert not shortcut or (c_in == c_out and stride == 1)
        self.conv = nn.Conv2d(c_in, c_out, kernel, stride, kernel // 2, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(c_out, eps=1e-3, momentum=0.03)
        self.act = nn.ReLU(inplace=True)
        self.shortcut = shortcut

    def forward(self, x: Tensor) -> Tensor:
        """(B, c_in, H, W) to (B, c_out, H / stride, W / stride)."""
        y = self.norm(self.conv(x))
        if self.shortcut:
            y = y + x
        out: Tensor = self.act(y)
        return out


class PyramidPool(nn.Module):
    """Three chained 5x5 maxima beside the input: a wide view at little cost (He et al., 2015)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        half = channels // 2
        self.reduce = ConvBlock(channels, half)
        self.pool = nn.MaxPool2d(5, 1, 2)
        self.out = ConvBlock(4 * half, channels)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        steps = [self.reduce(x)]
        for _ in range(3):
            steps.append(self.pool(steps[-1]))
        y: Tensor = self.out(torch.cat(steps, 1))
        return y


class Head(nn.Module):
    """Scores and distances of one grid, by two branches of one convolution each."""

    def __init__(self, c_in: int, hidden: int, n_classes: int, stride: int) -> None:
        super().__init__()
        self.n_classes, self.stride = n_classes, stride
        self.score_branch = ConvBlock(c_in, hidden, 3)
        self.box_branch = ConvBlock(c_in, hidden, 3)
        self.score_out = nn.Conv2d(hidden, n_classes, 1)
        self.box_out = nn.Conv2d(hidden, 4 * n_classes, 1)
        prior = math.log(PRIOR_SCORE / (1 - PRIOR_SCORE))
        nn.init.constant_(self.score_out.bias, prior)  # type: ignore[arg-type] # bias is on
        nn.init.constant_(self.box_out.bias, 3.0)  # type: ignore[arg-type] # a box of six cells

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(B, c_in, H, W) to logits (B, H * W, C) and distances (B, H * W, C, 4) [px]."""
        n = x.shape[0]  # not len(): an exported trace would hold its value
        # The outputs are computed in full precision: bf16 has 8 bits, a far edge would jump by 1 px
        score = self.score_out(self.score_branch(x).to(self.score_out.weight.dtype))
        box = self.box_out(self.box_branch(x).to(self.box_out.weight.dtype))
        logits = score.permute(0, 2, 3, 1).reshape(n, -1, self.n_classes)
        raw = box.permute(0, 2, 3, 1).reshape(n, -1, self.n_classes, 4)
        return logits.float(), nn.functional.softplus(raw.float()) * self.stride


class TargetNet(nn.Module):
    """The detector's net; both input sides must be multiples of ``SIZE_MULTIPLE_PX``.

    Few wide 3x3 convolutions in place of many narrow ones: on a CPU each call of a convolution
    costs about 0.1 ms whatever it computes, and narrow ones use a fraction of its arithmetic.
    """

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.config = config
        w, c = config.width, len(config.classes)
        c3, c4, c5, neck = 4 * w, 8 * w, 12 * w, 4 * w
        self.stem = nn.Sequential(ConvBlock(3, w, 3, 2), ConvBlock(w, 2 * w, 3, 2), _same(2 * w))
        self.stage3 = nn.Sequential(ConvBlock(2 * w, c3, 3, 2), _same(c3), _same(c3))
        self.stage4 = nn.Sequential(ConvBlock(c3, c4, 3, 2), _same(c4), _same(c4))
        self.stage5 = nn.Sequential(ConvBlock(c4, c5, 3, 2), _same(c5), PyramidPool(c5))
        self.up = nn.Upsample(scale_factor=2, mode="nearest")
        self.lateral5, self.lateral4 = ConvBlock(c5, neck), ConvBlock(c4, neck)
        self.lateral3 = ConvBlock(c3, neck)
        self.top4, self.top3 = _same(neck), _same(neck)
        self.down3, self.down4 = ConvBlock(neck, neck, 3, 2), ConvBlock(neck, neck, 3, 2)
        self.bottom4, self.bottom5 = _same(neck), _same(neck)
        self.heads = nn.ModuleList(Head(neck, 3 * w, c, stride) for stride in STRIDES)

    def forward(self, image: Tensor) -> Prediction:
        """Raw scores and distances of all cells.

        Args:
            image: (B, 3, H, W), RGB in [0, 1].

        Returns:
            Cells of stride 8 first, each grid row by row (the order of ``boxes.cell_centers``).
        """
        p3 = self.stage3(self.stem(image))
        p4 = self.stage4(p3)
        p5 = self.lateral5(self.stage5(p4))
        n4 = self.top4(self.up(p5) + self.lateral4(p4))
        out3 = self.top3(self.up(n4) + self.lateral3(p3))
        out4 = self.bottom4(self.down3(out3) + n4)
        out5 = self.bottom5(self.down4(out4) + p5)
        outs = [head(x) for head, x in zip(self.heads, (out3, out4, out5), strict=True)]
        logits, distances = zip(*outs, strict=True)
        return Prediction(torch.cat(logits, 1), torch.cat(distances, 1))

    def fused(self) -> TargetNet:
        """A copy for inference with every batch norm folded into its convolution."""
        net = copy.deepcopy(self).eval()
        for block in net.modules():
            if isinstance(block, ConvBlock) and isinstance(block.norm, nn.BatchNorm2d):
                block.conv = _fold(block.conv, block.norm, block.shortcut)
                block.norm, block.shortcut = nn.Identity(), False
        return net

    def bfloat16_body(self) -> TargetNet:
        """Turn all but the output convolutions to bf16, in place."""
        self.to(torch.bfloat16)
        for head in self.heads:
            assert isinstance(head, Head)
            head.score_out.float()
            head.box_out.float()
        return self


def _same(channels: int) -> ConvBlock:
    return ConvBlock(channels, channels, 3, shortcut=True)


def _fold(conv: nn.Conv2d, norm: nn.BatchNorm2d, shortcut: bool) -> nn.Conv2d:
    """One convolution with a bias that does what ``norm(conv(x))`` does in eval mode.

    With ``shortcut`` it does what ``norm(conv(x)) + x`` does.
    """
    assert norm.running_mean is not None
    assert norm.running_var is not None
    scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    folded = nn.Conv2d(
        conv.in_channels,
        conv.out_channels,
        (conv.kernel_size[0], conv.kernel_size[1]),
        (conv.stride[0], conv.stride[1]),
        (conv.kernel_size[0] // 2, conv.kernel_size[1] // 2),
    )
    with torch.no_grad():
        folded.weight.copy_(conv.weight * scale[:, None, None, None])
        if shortcut:
            middle = conv.kernel_size[0] // 2
            channels = torch.arange(conv.out_channels)
            folded.weight[channels, channels, middle, middle] += 1.0
        assert folded.bias is not None
        folded.bias.copy_(norm.bias - norm.running_mean * scale)
    return folded.requires_grad_(False)
