"""How long one picture of 640x480 takes on each engine, beside the plain fp32 forward of torch.

``plain`` is the net as trained: eager, batch norms not folded, NCHW, fp32, no packed weights. Each
engine has a process of its own, since pools of torch, onnxruntime and OpenVINO disturb each other
in one. The processes take turns, a block of pictures each, so that a busy moment hits all of them;
the first pictures of a block are not counted. ``net`` is the engine's forward alone, what the
ratio is of; ``detect`` is all that the service does with a picture: letterbox, net, boxes and
suppression.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_service.detector.threads import available_cpus, wait_asleep

PLAIN = "plain"
SIZE = (480, 640)
WARM_PICTURES = 3
MODULE = "tests.perf.bench_detector_speed"
START_S = 180


@dataclass
class Times:
    """What was measured of one contender [ms]."""

    about: dict[str, Any]
    net_ms: list[float] = field(default_factory=list)
    detect_ms: list[float] = field(default_factory=list)
    block_ms: list[float] = field(default_factory=list)
    """Median of the net's times in each block."""


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    engine: str
    about: dict[str, Any]
    net_p50_ms: float
    net_p99_ms: float
    detect_p50_ms: float | None
    detect_p99_ms: float | None
    ratio: float
    """Median over the rounds of plain's block median over this one's: times faster."""
    ratio_low: float
    ratio_high: float


def picture() -> NDArray[np.uint8]:
    """Noise: the time does not hang on what is to be seen."""
    return np.random.default_rng(1).integers(0, 256, (*SIZE, 3), np.uint8)


def contenders(
    name: str, weights: Path | None
) -> tuple[dict[str, Any], Callable[[], object], Callable[[], object] | None]:
    """About, the net's forward, and everything that is done with a picture (None for plain)."""
    rgb = picture()
    if name == PLAIN:
        wait_asleep()  # as the service does: the ratio shall not be that of two ways to wait
        import torch

        from edge_service.detector.weights import DEFAULT_WEIGHTS, load_weights

        torch.set_num_threads(available_cpus())
        net, _ = load_weights(weights or DEFAULT_WEIGHTS)
        net.eval()
        nchw = np.ascontiguousarray(rgb.transpose(2, 0, 1)[None]).astype(np.float32) / 255
        images = torch.from_numpy(nchw)

        def forward() -> object:
            with torch.inference_mode():
                return net(images)

        about = {
            "backend": f"torch {torch.__version__}",
            "precision": "fp32",
            "threads": torch.get_num_threads(),
        }
        return about, forward, None
    from edge_service.detector.engines import open_engine

    detector = open_engine(name, weights)
    batch = rgb[None]
    about = {k: detector.describe()[k] for k in ("backend", "precision", "threads")}
    return about, lambda: detector._engine.infer(batch), lambda: detector.detect(rgb)


def serve(name: str, weights: Path | None) -> None:
    """Measure blocks as asked on standard input, one JSON line each."""
    about, forward, whole = contenders(name, weights)
    runs = {"net": forward} | ({} if whole is None else {"detect": whole})
    for run in runs.values():
        for _ in range(10):
            run()
    print(json.dumps(about), flush=True)
    for line in sys.stdin:
        print(json.dumps({k: _block(run, int(line)) for k, run in runs.items()}), flush=True)


def _block(run: Callable[[], object], pictures: int) -> list[float]:
    times = []
    for _ in range(WARM_PICTURES + pictures):
        start = time.perf_counter_ns()
        run()
        times.append((time.perf_counter_ns() - start) / 1e6)
    return times[WARM_PICTURES:]


def measure(
    engines: tuple[str, ...],
    weights: Path | None,
    rounds: int,
    pictures: int,
    on_round: Callable[[int], None] = lambda done: None,
) -> tuple[list[Row], list[str]]:
    """All engines by turns.

    Args:
        engines: Names of engines.
        weights: None: the packaged ones.
        rounds: Turns of each.
        pictures: Of a turn.
        on_round: Called with the number of rounds done.

    Returns:
        The rows, plain first, and what could not start and why.
    """
    with ExitStack() as stack:
        running: dict[str, subprocess.Popen[str]] = {}
        times: dict[str, Times] = {}
        failed = []
        for name in (PLAIN, *engines):
            process = _start(name, weights)
            stack.callback(_stop, process)
            assert process.stdout is not None
            line = process.stdout.readline()
            if not line:
                failed.append(f"{name} did not start: exit status {process.wait(START_S)}")
                continue
            running[name], times[name] = process, Times(json.loads(line))
        if PLAIN not in running:
            return [], failed
        for done in range(1, rounds + 1):
            for name, process in running.items():
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(f"{pictures}\n")
                process.stdin.flush()
                block = json.loads(process.stdout.readline())
                times[name].net_ms += block["net"]
                times[name].detect_ms += block.get("detect", [])
                times[name].block_ms.append(float(np.median(block["net"])))
            on_round(done)
    return [_row(name, t, times[PLAIN]) for name, t in times.items()], failed


def _start(name: str, weights: Path | None) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", MODULE, name]
    if weights is not None:
        command += ["--weights", str(weights)]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )


def _stop(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()  # ends its loop
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    process.stdout.close()


def _row(name: str, t: Times, plain: Times) -> Row:
    ratios = np.array(plain.block_ms) / np.array(t.block_ms)
    whole = np.percentile(t.detect_ms, (50, 99)).tolist() if t.detect_ms else [None, None]
    p50, p99 = np.percentile(t.net_ms, (50, 99)).tolist()
    spread = (float(np.median(ratios)), float(ratios.min()), float(ratios.max()))
    return Row(name, t.about, p50, p99, *whole, *spread)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="One engine, asked over standard input.")
    parser.add_argument("engine")
    parser.add_argument("--weights", type=Path)
    arguments = parser.parse_args()
    serve(arguments.engine, arguments.weights)
