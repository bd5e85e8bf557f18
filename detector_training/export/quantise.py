"""Int8 by calibration: unsigned activations, signed weights, per channel; the last layers stay.

The output convolutions compute in fp32: a distance in 256 steps would be a box of whole pixels.
Signed activations are a trap: a CPU multiplies unsigned by signed, all else is emulated.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray

from detector_training.errors import ExportError

MAX_PICTURES = 64
"""The ranges settle long before."""


def quantise(source: Path, pictures: Sequence[NDArray[np.uint8]]) -> bytes:
    """An int8 copy of an ONNX model of ours; for ``apart``.

    Args:
        source: the fp32 export.
        pictures: inputs (H, W, 3) as the detector will see them.

    Raises:
        ExportError: there are no pictures, or onnxruntime is not installed.
    """
    if not pictures:
        raise ExportError("int8 needs pictures to calibrate on: --calibrate DATA")
    try:
        from onnxruntime import quantization  # type: ignore[import-untyped]
    except ImportError:
        raise ExportError("int8 needs aerial-contact[onnxruntime]") from None
    logging.getLogger().setLevel(logging.ERROR)  # it advises a step that our graph does not need

    class Pictures(quantization.CalibrationDataReader):  # type: ignore[misc] # untyped there
        def __init__(self) -> None:
            self._left = _floats(pictures)

        def get_next(self) -> dict[str, NDArray[np.float32]] | None:
            return next(self._left, None)

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "int8.onnx"
        quantization.quantize_static(
            str(source),
            str(out),
            Pictures(),
            quant_format=quantization.QuantFormat.QDQ,
            activation_type=quantization.QuantType.QUInt8,
            weight_type=quantization.QuantType.QInt8,
            per_channel=True,
            op_types_to_quantize=["Conv", "Add", "Concat", "MaxPool", "Resize"],
            nodes_to_exclude=last_convolutions(onnx.load(str(source)).graph),
            extra_options={"CalibMovingAverage": True},
        )
        model = onnx.load(str(out))
    known = {p.key for p in model.metadata_props}
    for p in onnx.load(str(source)).metadata_props:
        if p.key not in known:
            model.metadata_props.add(key=p.key, value=p.value)
    model.metadata_props.add(key="precision", value="int8")
    model.producer_name, model.producer_version = "aerial-contact", ""
    data: bytes = model.SerializeToString(deterministic=True)
    return data


def last_convolutions(graph: onnx.GraphProto) -> list[str]:
    """Names of the nodes from the last convolutions to the outputs, by the graph alone."""
    maker = {name: node for node in graph.node for name in node.output}
    names: set[str] = set()
    left = [value.name for value in graph.output]
    while left:
        node = maker.get(left.pop())
        if node is None or node.name in names:
            continue
        names.add(node.name)
        if node.op_type != "Conv":
            left.extend(node.input)
    return sorted(names)


def _floats(pictures: Sequence[NDArray[np.uint8]]) -> Iterator[dict[str, NDArray[np.float32]]]:
    from edge_service.detector.floats import FloatPlanes

    for picture in pictures:
        yield {"images": FloatPlanes().of(picture[None])}
