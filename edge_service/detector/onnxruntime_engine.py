"""ONNX Runtime as the engine, on the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnxruntime  # type: ignore[import-untyped]
from numpy.typing import NDArray

from edge_service.detector.floats import FloatPlanes
from edge_service.detector.layouts import Outputs
from edge_service.detector.onnx_file import OnnxFile
from edge_service.errors import EdgeError, WeightsError

BACKEND = f"onnxruntime {onnxruntime.__version__}"
_ERRORS_ONLY = 3


class OnnxRuntimeEngine:
    """Runs an ONNX model in a pool of its own; the precision is the file's.

    Args:
        file: the model.
        threads: of its pool.
        precision: ``auto``, or ``fp32`` to refuse a quantised file.

    Raises:
        WeightsError: the runtime cannot load the model.
        EdgeError: it does not have this precision.
    """

    def __init__(self, file: OnnxFile, threads: int, precision: str) -> None:
        self.precision = "int8" if file.quantised else "fp32"
        if precision not in ("auto", self.precision):
            raise EdgeError(
                f"precision {precision}: onnxruntime computes {file.path} in {self.precision}"
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = _ERRORS_ONLY
        # Threads that spin between layers burn the quota that others need: on a machine with other
        # work a picture took 54 to 77 ms with it and 38 without
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(
                file.data, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # its errors have no common base of their own
            raise WeightsError(
                f"weights {file.path}: onnxruntime cannot load it ({_first_line(error)})"
            ) from None
        self._input = file.input_name
        self._singly = file.one_at_a_time
        self._planes = FloatPlanes()

    def infer(self, pictures: NDArray[np.uint8]) -> Outputs:
        """Raw outputs for pictures (B, H, W, 3)."""
        planes = self._planes.of(pictures)
        if not self._singly or len(planes) == 1:
            return self._run(planes)
        each = [self._run(planes[k : k + 1]) for k in range(len(planes))]
        return tuple(np.concatenate(outputs) for outputs in zip(*each, strict=True))

    def _run(self, planes: NDArray[np.float32]) -> Outputs:
        outputs: list[Any] = self._session.run(None, {self._input: planes})
        return tuple(outputs)


def _first_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
