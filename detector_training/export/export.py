"""Weights to ONNX: export, check against the net, and only then a file."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from detector_training.datasets.sample import Sample
from detector_training.errors import ExportError
from detector_training.export.accuracy import Accuracy, measure, worst_loss
from detector_training.export.apart import apart, installed_runtime
from detector_training.export.quantise import MAX_PICTURES, quantise
from edge_service.detector.drawn import draw
from edge_service.detector.engines import raw_outputs
from edge_service.detector.files import sha256
from edge_service.detector.letterbox import letterbox
from edge_service.detector.onnx_export import OPSET, net_outputs, onnx_bytes, write_whole
from edge_service.detector.parity import Parity, compare, require_parity
from edge_service.detector.weights import load_weights
from target_pose.target import Target

CHECKED_PICTURES = 32
"""A graph that is right for so many is right: they are all the same arithmetic."""


@dataclass(frozen=True, slots=True, eq=False)
class Int8:
    """What a quantised export is made from and judged by."""

    calibrate: Sequence[Sample]
    check: Sequence[Sample]
    max_loss: float = 0.01
    """Largest fall of any level's AP50 or recall that is let pass."""


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written, and what was found out about it."""

    path: Path
    sha256: str
    bytes: int
    opset: int
    runtime: str
    """That checked it."""
    parity: Parity
    """Of the fp32 graph with the net."""
    before: Accuracy | None = None
    after: Accuracy | None = None
    """Of fp32 and of int8, where it was quantised."""

    def as_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {**asdict(self), "path": str(self.path)}


def export(
    weights: Path,
    out: Path,
    target: Target,
    *,
    opset: int = OPSET,
    dynamic_batch: bool = False,
    pictures: Sequence[Sample] = (),
    int8: Int8 | None = None,
    threads: int = 1,
) -> Exported:
    """Write an ONNX file of our weights, or raise and write none.

    Args:
        weights: a safetensors file of ours.
        out: the file; replaced when it is there.
        target: drawn for the check, and scored for int8.
        opset: of ONNX.
        dynamic_batch: take any number of pictures at once; else one.
        pictures: to compare the graph with the net on, beside drawn ones.
        int8: quantise, and refuse what costs accuracy.
        threads: of each of the two processes.

    Raises:
        WeightsError: the weights cannot be used, the graph says something else than the net, or the
            file cannot be written.
        ExportError: no runtime is installed, or int8 costs too much.
    """
    runtime = installed_runtime()
    net, info = load_weights(weights)
    data = onnx_bytes(net, info, opset=opset, dynamic_batch=dynamic_batch)
    inputs = [letterbox(d.color_rgb)[0][None] for d in draw(target)]
    if dynamic_batch:
        inputs.append(np.concatenate(inputs))
    inputs += [picture[None] for picture in _inputs(pictures, CHECKED_PICTURES)]
    torch.set_num_threads(threads)
    want = net_outputs(net, inputs)
    with tempfile.TemporaryDirectory() as folder:
        plain, small = Path(folder) / "fp32.onnx", Path(folder) / "int8.onnx"
        write_whole(plain, data)
        parity = compare(want, apart(raw_outputs, runtime, plain, threads, inputs))
        require_parity(parity, str(weights))
        before = after = None
        if int8 is not None:
            data = apart(quantise, plain, _inputs(int8.calibrate, MAX_PICTURES))
            write_whole(small, data)
            before = apart(measure, runtime, plain, threads, int8.check, target)
            after = apart(measure, runtime, small, threads, int8.check, target)
            if (loss := worst_loss(before, after)) > int8.max_loss:
                raise ExportError(
                    f"{weights}: int8 costs {loss:.3f} of AP50 or recall, at most "
                    f"{int8.max_loss:g} passes (--max-loss). Nothing was written"
                )
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, data)
    return Exported(out, sha256(data), len(data), opset, runtime, parity, before, after)


def _inputs(samples: Sequence[Sample], most: int) -> list[NDArray[np.uint8]]:
    return [letterbox(s.read())[0] for s in _spread(samples, most)]


def _spread(samples: Sequence[Sample], most: int) -> list[Sample]:
    """So many of them, from first to last: neighbours in a data set are alike."""
    if len(samples) <= most:
        return list(samples)
    return [samples[k] for k in np.linspace(0, len(samples) - 1, most).astype(int)]
