"""An ONNX file, read and checked before any runtime sees it: what goes in, what it says of itself.

Nothing is executed and nothing else is opened: a file that keeps its weights beside itself is
refused, since the path in it may point anywhere.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]

from edge_service.detector.files import FORMAT, Kind, read_model_file, sha256
from edge_service.detector.letterbox import MAX_SIDE_PX, MIN_SIDE_PX
from edge_service.errors import WeightsError

MAX_CLASSES = 1000
MAX_NAME_CHARACTERS = 64
MAX_TEXT_CHARACTERS = 100_000


@dataclass(frozen=True, slots=True)
class OnnxFile:
    """What an ONNX file holds, as far as the detector must know."""

    path: Path
    data: bytes
    sha256: str
    input_name: str
    size: tuple[int, int] | None
    """(H, W) of the input [px] if it takes one size only."""
    one_at_a_time: bool
    """Its batch is fixed at one picture."""
    outputs: tuple[str, ...]
    metadata: dict[str, str]
    quantised: bool
    """It computes in int8, in part at least."""
    parameters: int
    """Numbers in its weights."""

    @property
    def is_ours(self) -> bool:
        """It was written by this program's export."""
        return self.metadata.get("format") == FORMAT

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names of a foreign model's classes, from its metadata ``names``; none: it does not say.

        Raises:
            WeightsError: there are some, and they cannot be read.
        """
        text = self.metadata.get("names")
        if text is None:
            return ()
        try:
            if len(text) > MAX_TEXT_CHARACTERS:
                raise ValueError(text)
            names = ast.literal_eval(text)  # as the YOLO family writes it: {0: 'a', 1: 'b'}
            if isinstance(names, dict):
                names = [names[k] for k in range(len(names))]
            if not isinstance(names, list | tuple) or len(names) > MAX_CLASSES:
                raise ValueError(names)
            return tuple(str(name)[:MAX_NAME_CHARACTERS] for name in names)
        except (ValueError, SyntaxError, KeyError, TypeError, MemoryError, RecursionError):
            raise WeightsError(
                f"weights {self.path}: metadata names {text[:60]!r} is no list of class names"
            ) from None

    @property
    def key_points(self) -> tuple[int, int] | None:
        """Key points of a foreign pose model and numbers of each, from its metadata ``kpt_shape``.

        Raises:
            WeightsError: there is one, and it cannot be read.
        """
        text = self.metadata.get("kpt_shape")
        if text is None:
            return None
        try:
            count, numbers = ast.literal_eval(text[:MAX_NAME_CHARACTERS])
            if not (type(count) is type(numbers) is int and count > 0 and numbers in (2, 3)):
                raise ValueError(text)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            raise WeightsError(
                f"weights {self.path}: metadata kpt_shape {text[:60]!r} is not [points, 2 or 3]"
            ) from None
        return count, numbers


def read_onnx(path: Path) -> OnnxFile:
    """Read and check an ONNX file.

    Raises:
        WeightsError: it is missing, truncated, not ONNX, or takes something else than pictures.
    """
    kind, data = read_model_file(path)
    if kind is not Kind.ONNX:
        raise WeightsError(f"weights {path}: a {kind.value} file, and no ONNX")
    try:
        model = onnx.load_model_from_string(data)
    except (DecodeError, ValueError) as error:
        raise WeightsError(f"weights {path}: not a whole ONNX file ({error})") from None
    graph = model.graph
    if not graph.node or not graph.output:
        raise WeightsError(f"weights {path}: not a whole ONNX file (no graph in it)")
    initializers = {tensor.name for tensor in graph.initializer}
    for tensor in _tensors(graph):
        if tensor.external_data or tensor.data_location == onnx.TensorProto.EXTERNAL:
            raise WeightsError(
                f"weights {path}: {tensor.name[:40]} lies in another file; export as a single file"
            )
    inputs = [value for value in graph.input if value.name not in initializers]
    if len(inputs) != 1:
        raise WeightsError(f"weights {path}: {len(inputs)} inputs, a detector has one")
    batch, size = _input_shape(path, inputs[0])
    return OnnxFile(
        path=path,
        data=data,
        sha256=sha256(data),
        input_name=inputs[0].name,
        size=size,
        one_at_a_time=batch == 1,
        outputs=tuple(value.name for value in graph.output),
        metadata={p.key: p.value for p in model.metadata_props},
        quantised=any(
            "Quantize" in n.op_type or n.op_type.startswith("QLinear") for n in graph.node
        ),
        parameters=sum(_count(tensor) for tensor in graph.initializer),
    )


def _input_shape(
    path: Path, value: onnx.ValueInfoProto
) -> tuple[int | None, tuple[int, int] | None]:
    """Batch and (H, W) of the input, each None when it may vary."""
    kind = value.type.tensor_type
    dims = [d.dim_value if d.HasField("dim_value") else None for d in kind.shape.dim]
    told = f"{onnx.TensorProto.DataType.Name(kind.elem_type)}{[d or '?' for d in dims]}"
    wants = "a detector takes FLOAT (B, 3, H, W), RGB in [0, 1]"
    if kind.elem_type != onnx.TensorProto.FLOAT or len(dims) != 4 or dims[1] != 3:
        raise WeightsError(f"weights {path}: input {value.name[:40]} is {told}, {wants}")
    batch, _, height, width = dims
    if batch not in (None, 1):
        raise WeightsError(f"weights {path}: a batch of {batch}; export it for 1 or for any number")
    if height is None or width is None:
        if height is not width:
            raise WeightsError(f"weights {path}: input is {told}, one side fixed and one not")
        return batch, None
    if not all(MIN_SIDE_PX <= side <= MAX_SIDE_PX for side in (height, width)):
        raise WeightsError(
            f"weights {path}: input is {told}; a side is {MIN_SIDE_PX} to {MAX_SIDE_PX} px"
        )
    return batch, (height, width)


def _tensors(graph: onnx.GraphProto) -> Iterator[onnx.TensorProto]:
    """Every tensor of a graph, those of its branches and constants included."""
    yield from graph.initializer
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.HasField("t"):
                yield attribute.t
            yield from attribute.tensors
            for inner in (attribute.g, *attribute.graphs):
                if inner.node:
                    yield from _tensors(inner)


def _count(tensor: onnx.TensorProto) -> int:
    n = 1
    for dim in tensor.dims:
        n *= dim
    return n if len(tensor.dims) > 1 else 0
