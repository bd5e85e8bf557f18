"""PyTorch on an NVIDIA GPU: half precision, one CUDA graph for each shape of input.

A net this small is launched kernel by kernel in more time than it runs. A graph replays all of
them with one call; it holds for one shape and for fixed memory, so each shape has its own.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from edge_service.detector.layouts import Outputs
from edge_service.detector.net import TargetNet
from edge_service.detector.packed import Run
from edge_service.detector.torch_engine import Prepared, as_images


class HalfNet(nn.Module):
    """From bytes to scores: the conversion belongs to the graph. Outputs in fp32."""

    def __init__(self, net: TargetNet, dtype: torch.dtype) -> None:
        super().__init__()
        fused = net.fused()
        # What is bf16 on a CPU is half here. The output convolutions stay: half of a pixel is the
        # finest step of fp16 between 512 and 1024 px
        on_cpu = dict(net.fused().bfloat16_body().named_parameters())
        for name, parameter in fused.named_parameters():
            if on_cpu[name].dtype == torch.bfloat16:
                parameter.data = parameter.data.to(dtype)
        self._net = fused.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._dtype = dtype

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B, N, C) and distances (B, N, C, 4) of images (B, 3, H, W), uint8."""
        logits, distances = self._net(images.to(self._dtype).div_(255))
        return logits.float(), distances.float()


class CudaEngine:
    """The fused net on the first GPU, fp16 or fp32."""

    def __init__(self, net: TargetNet, dtype: torch.dtype, device: str = "cuda") -> None:
        self._device = torch.device(device)
        self._net = HalfNet(net, dtype).to(self._device).eval()
        on_gpu = self._device.type == "cuda"
        self._prepared = Prepared(self._net, self._graph if on_gpu else lambda _: None)

    def infer(self, pictures: NDArray[np.uint8]) -> Outputs:
        """Logits (B, N, C) and distances (B, N, C, 4) of pictures (B, H, W, 3)."""
        return self._infer(pictures, at_once=False)

    def warm_up(self, pictures: NDArray[np.uint8]) -> None:
        """Prepare for pictures of this shape."""
        self._infer(pictures, at_once=True)

    def _infer(self, pictures: NDArray[np.uint8], at_once: bool) -> Outputs:
        with torch.inference_mode():
            images = as_images(pictures).to(self._device)
            logits, distances = self._prepared.run_for(images, at_once=at_once)(images)
            return logits.cpu().numpy(), distances.cpu().numpy()

    def _graph(self, example: Tensor) -> Run:
        """Record the net for one shape (PyTorch notes, "CUDA graphs": warm up on a side stream)."""
        images = example.clone()
        side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(3):
                self._net(images)
        torch.cuda.current_stream().wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            outputs = self._net(images)

        def replay(new: Tensor) -> tuple[Tensor, Tensor]:
            images.copy_(new)
            graph.replay()
            logits, distances = outputs
            return logits, distances

        return replay
