"""The engines by name, and the one way to open them: ``open_engine("openvino", weights)``.

One process has one engine. Only ``torch`` imports torch here; the others get our weights converted
by a process of its own (``converted``), or take an ONNX file, ours or a foreign one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from edge_service.detector.converted import converted, default_cache
from edge_service.detector.detector import (
    SCORE_THRESHOLD,
    WARM_UP_SIZE,
    EngineDetector,
    check_threads,
    check_threshold,
)
from edge_service.detector.files import DEFAULT_WEIGHTS, Kind, read_model_file, sha256
from edge_service.detector.layouts import Outputs
from edge_service.detector.threads import available_cpus, wait_asleep
from edge_service.errors import EdgeError, WeightsError

if TYPE_CHECKING:
    from edge_service.detector.onnx_file import OnnxFile
    from edge_service.detector.onnxruntime_engine import OnnxRuntimeEngine
    from edge_service.detector.openvino_engine import OpenVinoEngine

EngineName: TypeAlias = Literal["torch", "onnxruntime", "openvino"]
ENGINES: tuple[str, ...] = get_args(EngineName)


def open_engine(
    name: str,
    weights: Path | None = None,
    *,
    threads: int | None = None,
    precision: str = "auto",
    device: str = "auto",
    score_threshold: float = SCORE_THRESHOLD,
    classes: str | None = None,
    cache: Path | None = None,
    points: int = 0,
) -> EngineDetector:
    """A detector that runs on the engine of this name, warm.

    Args:
        name: ``torch``, ``onnxruntime`` or ``openvino``.
        weights: A safetensors file of ours, or for the latter two an ONNX file; None: packaged.
        threads: of the engine's pool; None: what affinity and CPU quota leave.
        precision: ``auto``: the fastest that costs no accuracy here. torch: fp32 or bf16, on a
            GPU fp32 or fp16; openvino: fp32 or bf16; onnxruntime: what the file has.
        device: of torch: ``auto``, ``cpu`` or ``cuda``.
        score_threshold: boxes at or below are dropped.
        classes: of a foreign ONNX model without names: comma-separated, in its order.
        cache: folder for conversions; None: ``~/.cache/aerial-contact``.
        points: labelled points of the target, which a foreign pose model gives as key points.

    Raises:
        WeightsError: the file cannot be used, or not by this engine.
        EdgeError: an argument is out of bounds.
        ModuleNotFoundError: the engine's package is not installed.
    """
    if name not in ENGINES:
        raise EdgeError(f"engine {name!r} is not one of {', '.join(ENGINES)}")
    path = weights or DEFAULT_WEIGHTS
    if name != "torch":
        return _on_onnx(name, path, threads, precision, score_threshold, classes, cache, points)
    kind, _ = read_model_file(path)
    if kind is Kind.ONNX:
        raise WeightsError(
            f"weights {path}: torch takes our .safetensors files; "
            "for an .onnx file use --engine onnxruntime or openvino"
        )
    wait_asleep()
    from edge_service.detector.engine import TorchDetector  # loads torch: only where it is used

    return TorchDetector(
        path,
        threads=threads,
        precision=precision,  # type: ignore[arg-type] # checked there
        score_threshold=score_threshold,
        device=device,  # type: ignore[arg-type] # checked there
    )


def _on_onnx(
    name: str,
    path: Path,
    threads: int | None,
    precision: str,
    score_threshold: float,
    classes: str | None,
    cache: Path | None,
    points: int,
) -> EngineDetector:
    check_threads(threads)
    check_threshold(score_threshold)
    if find_spec(name) is None:  # told before a conversion is tried
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    from edge_service.detector.onnx_file import read_onnx
    from edge_service.detector.onnx_model import model_of

    kind, data = read_model_file(path)
    onnx_path = path
    if kind is Kind.SAFETENSORS:
        onnx_path = converted(path, data, cache or default_cache(), name)
    file = read_onnx(onnx_path)
    threads = threads or available_cpus()
    engine, backend = _runtime(name, file, threads, precision)
    blank = np.zeros((1, *(file.size or WARM_UP_SIZE), 3), np.uint8)
    model = model_of(file, engine.infer(blank), classes, points)
    if onnx_path != path:  # known by what was asked for, whatever it was converted to
        if file.metadata.get("weights_sha256") != sha256(data):
            raise WeightsError(f"model cache {onnx_path}: of other weights; remove the file")
        model = replace(model, name=path.stem, sha256=sha256(data))
    running = {
        "engine": name,
        "backend": backend,
        "device": "cpu",
        "precision": engine.precision,
        "threads": threads,
    }
    return EngineDetector(engine, model, running, score_threshold)


def _runtime(
    name: str, file: OnnxFile, threads: int, precision: str
) -> tuple[OnnxRuntimeEngine | OpenVinoEngine, str]:
    """The engine of this name, and what it calls itself; an import loads a runtime: only one."""
    if name == "openvino":
        from edge_service.detector import openvino_engine

        return openvino_engine.OpenVinoEngine(file, threads, precision), openvino_engine.BACKEND
    from edge_service.detector import onnxruntime_engine

    backend = onnxruntime_engine.BACKEND
    return onnxruntime_engine.OnnxRuntimeEngine(file, threads, precision), backend


def raw_outputs(
    name: str, path: Path, threads: int, pictures: Sequence[NDArray[np.uint8]]
) -> list[Outputs]:
    """What a runtime answers with an fp32 ONNX file to inputs (B, H, W, 3), one after the other.

    Raises:
        WeightsError: the file cannot be used.
    """
    from edge_service.detector.onnx_file import read_onnx

    engine, _ = _runtime(name, read_onnx(path), threads, "fp32")
    try:
        return [tuple(np.array(o) for o in engine.infer(one)) for one in pictures]
    except Exception as error:  # the runtimes' errors have no base of their own
        reason = " ".join(str(error).split())[-200:]
        raise WeightsError(f"{name} cannot run the export: {reason}") from None
