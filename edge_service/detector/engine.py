"""The default detector: our net in PyTorch, as fast as this machine allows."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np
import torch

from edge_service.detector.cuda_engine import CudaEngine
from edge_service.detector.detector import (
    MAX_BOXES_PER_LEVEL,
    SCORE_THRESHOLD,
    WARM_UP_SIZE,
    Engine,
    EngineDetector,
    Model,
    check_threads,
    check_threshold,
)
from edge_service.detector.layouts import CellLayout
from edge_service.detector.net import TargetNet
from edge_service.detector.threads import available_cpus
from edge_service.detector.torch_engine import CpuEngine, Precision, faster
from edge_service.detector.weights import DEFAULT_WEIGHTS, load_weights
from edge_service.errors import EdgeError
from target_pose.target import Level

__all__ = ["MAX_BOXES_PER_LEVEL", "SCORE_THRESHOLD", "Precision", "TorchDetector"]

Device: TypeAlias = Literal["auto", "cpu", "cuda"]

_CPU_TYPES = {"bf16": torch.bfloat16, "fp32": torch.float32}
_CUDA_TYPES = {"fp16": torch.float16, "fp32": torch.float32}


class TorchDetector(EngineDetector):
    """Finds the three levels of the target in a colour picture.

    Not thread-safe by intent: one instance belongs to one worker thread.

    Args:
        weights: A weights file; None: the packaged one.
        threads: Threads of torch in this process; None: what affinity and CPU quota leave.
        precision: ``auto`` measures bf16 against fp32 at start and takes the faster; on a GPU it
            is fp16.
        score_threshold: Boxes below are dropped.
        device: ``auto`` takes a GPU when there is one.

    Raises:
        WeightsError: the file cannot be used.
        EdgeError: an argument is out of bounds.
    """

    def __init__(
        self,
        weights: Path | None = None,
        *,
        threads: int | None = None,
        precision: Precision = "auto",
        score_threshold: float = SCORE_THRESHOLD,
        device: Device = "auto",
    ) -> None:
        if precision not in get_args(Precision):
            raise EdgeError(f"precision {precision!r} is not one of {get_args(Precision)}")
        if device not in get_args(Device):
            raise EdgeError(f"device {device!r} is not one of {get_args(Device)}")
        check_threads(threads)
        check_threshold(score_threshold)
        path = weights or DEFAULT_WEIGHTS
        net, info = load_weights(path)
        threads = threads or available_cpus()
        torch.set_num_threads(threads)
        place = _place(device)
        engine, chosen = (_on_cpu if place == "cpu" else _on_gpu)(net, precision)
        facts = {
            "weights_version": info.version,
            "parameters": sum(p.numel() for p in net.parameters()),
            "width": info.config.width,
        }
        levels = tuple(Level(name) for name in info.config.classes)
        running = {
            "engine": "torch",
            "backend": f"torch {torch.__version__}",
            "device": place,
            "precision": chosen,
            "threads": threads,
        }
        model = Model(path.stem, info.target, info.sha256, CellLayout(levels), None, facts)
        super().__init__(engine, model, running, score_threshold)


def _place(device: Device) -> str:
    has_gpu = torch.cuda.is_available()
    if device == "cuda" and not has_gpu:
        raise EdgeError("device cuda: torch sees no GPU here; device cpu or auto works")
    return "cuda" if has_gpu and device != "cpu" else "cpu"


def _on_cpu(net: TargetNet, precision: Precision) -> tuple[Engine, str]:
    """The engine in the precision asked for, or in the faster one of this CPU; warm."""
    if precision == "fp16":
        raise EdgeError("precision fp16 is for GPUs; a CPU takes auto, fp32 or bf16")
    engines = {
        name: CpuEngine(net, dtype)
        for name, dtype in _CPU_TYPES.items()
        if precision in ("auto", name)
    }
    chosen = faster(engines, WARM_UP_SIZE)
    return engines[chosen], chosen


def _on_gpu(net: TargetNet, precision: Precision) -> tuple[Engine, str]:
    if precision == "bf16":
        raise EdgeError("precision bf16 is for CPUs; a GPU takes auto, fp16 or fp32")
    chosen = "fp16" if precision == "auto" else precision
    engine = CudaEngine(net, _CUDA_TYPES[chosen])
    engine.warm_up(np.zeros((1, *WARM_UP_SIZE, 3), np.uint8))
    return engine, chosen
