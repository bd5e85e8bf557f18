"""A runtime at work in a process of its own: torch's threads and its own never share one."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from pathlib import Path
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from detector_training.errors import ExportError
from edge_service.detector.layouts import Outputs

P = ParamSpec("P")
T = TypeVar("T")

RUNTIMES = ("onnxruntime", "openvino")


def apart(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call a function in a new process and wait for its result; what it raises is raised here.

    Raises:
        ExportError: the process died.
    """
    context = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            return pool.submit(work, *args, **kwargs).result()
    except BrokenProcessPool:
        raise ExportError("the process of the runtime died, maybe for want of memory") from None


def installed_runtime() -> str:
    """The runtime that checks an export.

    Raises:
        ExportError: none is installed.
    """
    for name in RUNTIMES:
        if find_spec(name) is not None:
            return name
    raise ExportError(
        "an export is checked by a runtime, and none is here: install aerial-contact[onnxruntime]"
    )


def raw_outputs(
    runtime: str, path: Path, threads: int, pictures: Sequence[NDArray[np.uint8]]
) -> list[Outputs]:
    """What an ONNX file answers to inputs (H, W, 3) in fp32, one by one; for ``apart``."""
    from edge_service.detector.onnx_file import read_onnx

    file = read_onnx(path)
    if runtime == "openvino":
        from edge_service.detector.openvino_engine import OpenVinoEngine

        infer = OpenVinoEngine(file, threads, "fp32").infer
    else:
        from edge_service.detector.onnxruntime_engine import OnnxRuntimeEngine

        infer = OnnxRuntimeEngine(file, threads, "auto").infer
    return [tuple(np.array(o) for o in infer(picture[None])) for picture in pictures]
