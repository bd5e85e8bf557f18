"""Our weights as an ONNX file: ``python -m edge_service.detector.onnx_export WEIGHTS OUT.onnx``.

The exporter is PyTorch's by tracing (``dynamo=False``). The net is plain convolutions without a
branch, which a trace holds in full, and the newer exporter would need another package. Height and
width stay free: measured, a graph of one size is not faster in either runtime.

The same weights give the same bytes: what varies (names of tools, comments) is taken out.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.jit._trace import TracerWarning

from edge_service.detector.drawn import draw
from edge_service.detector.engines import ENGINES, raw_outputs
from edge_service.detector.files import FORMAT
from edge_service.detector.layouts import Outputs
from edge_service.detector.net import STRIDES, TargetNet
from edge_service.detector.onnx_model import EXPORT_VERSION, OUTPUTS
from edge_service.detector.parity import compare, require_parity
from edge_service.detector.torch_engine import as_images
from edge_service.detector.weights import WeightsInfo, load_weights
from edge_service.errors import EdgeError, WeightsError
from target_pose.target import load_target

OPSET = 17
MIN_OPSET, MAX_OPSET = 13, 20
"""What the exporter writes and both runtimes read."""


class _Plain(nn.Module):
    """Both answers as plain outputs."""

    def __init__(self, net: TargetNet) -> None:
        super().__init__()
        self._net = net

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        logits, distances = self._net(images)
        return logits, distances


def onnx_bytes(
    net: TargetNet, info: WeightsInfo, *, opset: int = OPSET, dynamic_batch: bool = False
) -> bytes:
    """The net as an ONNX model: fused, fp32, checked by ``onnx.checker``.

    Input ``images`` (B, 3, H, W), RGB in [0, 1], sides multiples of 32. Outputs ``logits``
    (B, N, C) and ``distances`` (B, N, C, 4), as ``net.Prediction``. B is 1 unless
    ``dynamic_batch``.

    Raises:
        EdgeError: the opset is out of bounds.
        WeightsError: the exporter or the checker refuses the net.
    """
    if not MIN_OPSET <= opset <= MAX_OPSET:
        raise EdgeError(f"opset {opset} is not in [{MIN_OPSET}, {MAX_OPSET}]")
    whole = _Plain(net.fused()).eval()
    example = torch.zeros(2 if dynamic_batch else 1, 3, 96, 64)
    batch = {0: "batch"} if dynamic_batch else {}
    raw = BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        # It says that it will be replaced, and that the batch's size is a constant of the trace
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", TracerWarning)
        torch.onnx.export(
            whole,
            (example,),
            raw,  # type: ignore[arg-type] # it takes a file as well
            input_names=["images"],
            output_names=list(OUTPUTS),
            dynamic_axes={
                "images": {**batch, 2: "height", 3: "width"},
                **{name: {**batch, 1: "cells"} for name in OUTPUTS},
            },
            opset_version=opset,
            dynamo=False,
        )
    model = onnx.load_model_from_string(raw.getvalue())
    _sign(model, info)
    try:
        onnx.checker.check_model(model, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise WeightsError(f"the exported graph is not valid ONNX: {error}") from None
    data: bytes = model.SerializeToString(deterministic=True)
    return data


def _sign(model: onnx.ModelProto, info: WeightsInfo) -> None:
    """Say what it is, and leave out what differs from machine to machine."""
    model.producer_name, model.producer_version, model.doc_string = "aerial-contact", "", ""
    model.graph.name, model.graph.doc_string = FORMAT, ""
    for node in model.graph.node:
        node.doc_string = ""
    del model.metadata_props[:]
    metadata = {
        "format": FORMAT,
        "export_version": EXPORT_VERSION,
        "weights_version": info.version,
        "weights_sha256": info.sha256,
        "target": info.target,
        "classes": ",".join(info.config.classes),
        "strides": ",".join(map(str, STRIDES)),
        "width": str(info.config.width),
    }
    for key, value in sorted(metadata.items()):
        model.metadata_props.add(key=key, value=value)


def net_outputs(net: TargetNet, pictures: Sequence[NDArray[np.uint8]]) -> list[Outputs]:
    """What the net itself answers in fp32 to inputs (B, H, W, 3), one after the other."""
    fused = net.fused()
    answers: list[Outputs] = []
    with torch.inference_mode():
        for picture in pictures:
            logits, distances = fused(as_images(picture).float() / 255)
            answers.append((logits.numpy(), distances.numpy()))
    return answers


def _check(net: TargetNet, data: bytes, engine: str, what: str) -> None:
    """Two pools in one process are slow and not wrong, and this process ends soon."""
    pictures = [drawn.color_rgb[None] for drawn in draw(load_target())]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "export.onnx"
        write_whole(path, data)
        parity = compare(net_outputs(net, pictures), raw_outputs(engine, path, 1, pictures))
    require_parity(parity, f"weights {what} on {engine}")


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that a reader sees all of it or none.

    Raises:
        WeightsError: it cannot be written.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise WeightsError(f"{path}: cannot be written ({error.strerror})") from None


def main(arguments: list[str] | None = None) -> int:
    """Convert one file; for the worker, which starts this in a process of its own."""
    parser = argparse.ArgumentParser(prog="python -m edge_service.detector.onnx_export")
    parser.add_argument("weights", type=Path, help="a .safetensors file of ours")
    parser.add_argument("out", type=Path, help="the .onnx file to write")
    parser.add_argument("--engine", choices=ENGINES[1:], help="check that it answers as the net")
    given = parser.parse_args(arguments)
    try:
        torch.set_num_threads(1)
        net, info = load_weights(given.weights)
        data = onnx_bytes(net, info)
        if given.engine:
            _check(net, data, given.engine, str(given.weights))
        write_whole(given.out, data)
    except EdgeError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
