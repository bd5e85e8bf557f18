"""Model files: where the packaged one lies, what kind a file is, and what is never opened."""

from __future__ import annotations

import hashlib
from enum import StrEnum
from pathlib import Path

from edge_service.errors import WeightsError

FORMAT = "aerial-contact-detector"
"""What our own files say of themselves in their metadata, weights and ONNX alike."""

DEFAULT_WEIGHTS = Path(__file__).parent / "weights" / "bullseye-400.safetensors"
"""The weights that come with the package."""

MAX_MODEL_BYTES = 300_000_000
"""Of any model file: the largest of the YOLO family fit."""

_PICKLE = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")
"""How a PyTorch checkpoint begins: a zip archive, or a bare pickle."""
_SAFETENSORS_JSON = 8
"""A safetensors file begins with a length of so many bytes, then with JSON."""


class Kind(StrEnum):
    """What a model file is."""

    SAFETENSORS = "safetensors"
    ONNX = "onnx"


def read_model_file(path: Path) -> tuple[Kind, bytes]:
    """The bytes of a model file, read once, and their kind.

    What the bytes hold decides, and the name only where they do not show it (ONNX has no mark).

    Raises:
        WeightsError: it is missing, too large, a pickle, or neither of the two kinds.
    """
    try:
        size = path.stat().st_size
        if size > MAX_MODEL_BYTES:
            raise WeightsError(f"weights {path}: {size} bytes are over {MAX_MODEL_BYTES}")
        data = path.read_bytes()
    except OSError as error:
        raise WeightsError(f"weights {path}: {error.strerror or error}") from None
    return kind_of(path, data), data


def kind_of(path: Path, data: bytes) -> Kind:
    """What kind of model ``data`` is; ``path`` is named in the error.

    Raises:
        WeightsError: neither safetensors nor ONNX.
    """
    if data.startswith(_PICKLE) or path.suffix in (".pt", ".pth", ".pkl", ".ckpt"):
        raise WeightsError(
            f"weights {path}: a pickled checkpoint can run anything that it likes, and is never "
            "opened; safetensors or ONNX only: export it where you trust it, to ONNX"
        )
    if data[_SAFETENSORS_JSON : _SAFETENSORS_JSON + 1] == b"{" or path.suffix == ".safetensors":
        return Kind.SAFETENSORS
    if path.suffix == ".onnx":
        return Kind.ONNX
    raise WeightsError(
        f"weights {path}: neither a .safetensors file (our weights) nor an .onnx file (an export)"
    )


def sha256(data: bytes) -> str:
    """Hash of a file's bytes, in hex."""
    return hashlib.sha256(data).hexdigest()
