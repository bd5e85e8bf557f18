"""From our weights to ONNX, once: in a process of its own, into a folder keyed by their hash.

A worker on ONNX Runtime or OpenVINO never imports torch: two pools of threads in one process take
the cores from each other. So the conversion is done by another process, and kept.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from edge_service.detector.files import sha256
from edge_service.detector.onnx_model import EXPORT_VERSION
from edge_service.errors import WeightsError

LIMIT_S = 300.0
"""A conversion takes some seconds on a whole CPU; a small share of one may need a hundred times."""


def default_cache() -> Path:
    """Where conversions are kept when nobody says: below the home folder, which is the user's."""
    return Path.home() / ".cache" / "aerial-contact"


def converted(weights: Path, data: bytes, cache: Path, engine: str) -> Path:
    """The ONNX file of some weights, made now unless it has been made before.

    Args:
        weights: the safetensors file.
        data: its bytes.
        cache: folder for such files; made when missing. It must not be writable by strangers.
        engine: that will run it; the conversion is kept only if it answers there as the net does.

    Raises:
        WeightsError: the weights cannot be used, or the folder cannot be written.
    """
    out = cache / f"{sha256(data)}-{EXPORT_VERSION}-{engine}.onnx"
    if out.is_file():
        return out
    try:
        cache.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise WeightsError(
            f"model cache {cache}: {error.strerror}; name a folder that can be written with "
            "--model-cache (EDGE_MODEL_CACHE), or export an .onnx file beforehand"
        ) from None
    command = [sys.executable, "-m", "edge_service.detector.onnx_export", str(weights), str(out)]
    command += ["--engine", engine]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        raise WeightsError(f"weights {weights}: conversion took over {LIMIT_S:.0f} s") from None
    if run.returncode != 0 or not out.is_file():
        last = (run.stderr.strip().splitlines() or ["no word"])[-1][:300]
        foreseen = run.returncode == 2
        raise WeightsError(last if foreseen else f"weights {weights}: not converted: {last}")
    return out
