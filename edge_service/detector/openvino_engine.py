"""OpenVINO as the engine, on the CPU."""

from __future__ import annotations

import numpy as np
import openvino  # type: ignore[import-untyped]
from numpy.typing import NDArray

from edge_service.detector.floats import FloatPlanes
from edge_service.detector.layouts import Outputs
from edge_service.detector.onnx_file import OnnxFile
from edge_service.errors import EdgeError, WeightsError

BACKEND = f"openvino {openvino.__version__.split('-')[0]}"

_HINTS = {"fp32": "f32", "bf16": "bf16"}
_NAMES = {"f32": "fp32", "float32": "fp32", "bf16": "bf16", "bfloat16": "bf16"}


class OpenVinoEngine:
    """Runs an ONNX model in a pool of its own.

    Args:
        file: the model.
        threads: of its pool.
        precision: ``auto``: bf16 where the CPU has it, as OpenVINO decides; or ``fp32``, ``bf16``.

    Raises:
        WeightsError: the runtime cannot load the model.
        EdgeError: it does not have this precision.
    """

    def __init__(self, file: OnnxFile, threads: int, precision: str) -> None:
        if precision not in ("auto", *_HINTS):
            raise EdgeError(f"precision {precision}: openvino takes auto, fp32 or bf16")
        config: dict[str, object] = {
            "PERFORMANCE_HINT": "LATENCY",
            "NUM_STREAMS": 1,
            "INFERENCE_NUM_THREADS": threads,
            "ENABLE_CPU_PINNING": False,  # beside others on the machine a pinned thread waits
        }
        if precision != "auto":
            config["INFERENCE_PRECISION_HINT"] = _HINTS[precision]
        try:
            core = openvino.Core()
            compiled = core.compile_model(core.read_model(file.data), "CPU", config)
        except RuntimeError as error:
            reason = " ".join(str(error).split())[-200:]
            raise WeightsError(f"weights {file.path}: openvino cannot load it ({reason})") from None
        hint = compiled.get_property("INFERENCE_PRECISION_HINT").get_type_name()
        self.precision = _NAMES.get(hint, hint) + (" and int8" if file.quantised else "")
        self._request = compiled.create_infer_request()
        self._singly = file.one_at_a_time
        self._planes = FloatPlanes()

    def infer(self, pictures: NDArray[np.uint8]) -> Outputs:
        """Raw outputs for pictures (B, H, W, 3)."""
        planes = self._planes.of(pictures)
        if not self._singly or len(planes) == 1:
            return self._run(planes)
        each = [
            tuple(output.copy() for output in self._run(planes[k : k + 1]))
            for k in range(len(planes))
        ]
        return tuple(np.concatenate(outputs) for outputs in zip(*each, strict=True))

    def _run(self, planes: NDArray[np.float32]) -> Outputs:
        # shared both ways: no copies; the outputs hold until the next run
        outputs = self._request.infer([planes], share_inputs=True, share_outputs=True)
        return tuple(outputs.values())
