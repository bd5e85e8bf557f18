"""The weights file: safetensors with metadata, everything checked before a net is built."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from edge_service.detector.files import DEFAULT_WEIGHTS, FORMAT, Kind, kind_of
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.errors import WeightsError
from target_pose.target import Level

VERSION = "2"
MAX_WEIGHTS_BYTES = 10_000_000
MIN_WIDTH, MAX_WIDTH = 4, 64
__all__ = [
    "DEFAULT_WEIGHTS",
    "MAX_WEIGHTS_BYTES",
    "WeightsInfo",
    "load_weights",
    "save_weights",
]

_COUNTER = "num_batches_tracked"
_DTYPES = {"F32": torch.float32}


@dataclass(frozen=True, slots=True)
class WeightsInfo:
    """What a weights file says about itself."""

    config: NetConfig
    target: str
    """Name of the target that the net was trained on."""
    version: str
    sha256: str
    """Of the whole file, in hex."""


def save_weights(path: Path, net: TargetNet, target: str) -> None:
    """Write a net that is not fused, atomically: a reader sees the old file or the new one.

    Raises:
        WeightsError: the file would be over ``MAX_WEIGHTS_BYTES``.
    """
    tensors = {
        name: tensor.detach().to(torch.float32).contiguous().clone()
        for name, tensor in net.state_dict().items()
        if not name.endswith(_COUNTER)
    }
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "classes": ",".join(net.config.classes),
        "width": str(net.config.width),
        "target": target,
    }
    data = _in_order(save(tensors, metadata))
    if len(data) > MAX_WEIGHTS_BYTES:
        raise WeightsError(f"{path}: {len(data)} bytes are over {MAX_WEIGHTS_BYTES}")
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    os.replace(part, path)


def _in_order(data: bytes) -> bytes:
    """The same file with its header sorted: as it comes, the order of the metadata is random.

    Eight bytes of length, JSON padded with blanks, tensors (the format's own description).
    """
    end = 8 + int.from_bytes(data[:8], "little")
    header = json.dumps(json.loads(data[8:end]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + data[end:]


def load_weights(path: Path) -> tuple[TargetNet, WeightsInfo]:
    """The net in a weights file, in eval mode and not fused.

    Raises:
        WeightsError: the file is missing, damaged, foreign or fits no net; says what is wrong.
    """
    try:
        size = path.stat().st_size
        if size > MAX_WEIGHTS_BYTES:
            raise WeightsError(f"weights {path}: {size} bytes are over {MAX_WEIGHTS_BYTES}")
        data = path.read_bytes()
        if kind_of(path, data) is not Kind.SAFETENSORS:
            raise WeightsError(f"weights {path}: an .onnx file, and no .safetensors file of ours")
        digest = hashlib.sha256(data).hexdigest()
        with safe_open(path, framework="pt") as file:
            info = _info(path, file.metadata() or {}, digest)
            expected = _expected_shapes(info.config)
            _check_names(path, set(file.keys()), set(expected))
            for name, shape in expected.items():
                part = file.get_slice(name)
                found, dtype = tuple(part.get_shape()), part.get_dtype()
                if found != shape or dtype not in _DTYPES:
                    raise WeightsError(
                        f"weights {path}: {name} is {dtype}{list(found)}, "
                        f"this net takes F32{list(shape)}"
                    )
            tensors: dict[str, Tensor] = {name: file.get_tensor(name) for name in expected}
    except OSError as error:
        raise WeightsError(f"weights {path}: {error.strerror or error}") from None
    except SafetensorError as error:
        raise WeightsError(f"weights {path}: not a whole safetensors file ({error})") from None
    for name, tensor in tensors.items():
        if not bool(torch.isfinite(tensor).all()):
            raise WeightsError(f"weights {path}: {name} holds numbers that are not finite")
    net = TargetNet(info.config)
    net.load_state_dict(tensors, strict=False)  # the names are checked; counters stay at zero
    return net.eval(), info


def _info(path: Path, metadata: dict[str, str], digest: str) -> WeightsInfo:
    if metadata.get("format") != FORMAT:
        raise WeightsError(
            f"weights {path}: format {metadata.get('format')!r} is not {FORMAT!r}; "
            "train one with `python -m detector_training train`"
        )
    if metadata.get("version") != VERSION:
        raise WeightsError(
            f"weights {path}: version {metadata.get('version')!r}, this program reads {VERSION!r}"
        )
    classes = tuple(metadata.get("classes", "").split(","))
    levels = tuple(level.value for level in Level)
    if classes != levels:
        raise WeightsError(
            f"weights {path}: classes {','.join(classes)!r} are not {','.join(levels)!r}"
        )
    width = metadata.get("width", "")
    if not (width.isascii() and width.isdigit() and MIN_WIDTH <= int(width[:9]) <= MAX_WIDTH):
        raise WeightsError(
            f"weights {path}: width {width[:20]!r} is not in {MIN_WIDTH} to {MAX_WIDTH}"
        )
    target = metadata.get("target", "")
    if not 1 <= len(target) <= 64:
        raise WeightsError(f"weights {path}: the target's name has {len(target)} characters")
    return WeightsInfo(NetConfig(classes, int(width)), target, VERSION, digest)


def _expected_shapes(config: NetConfig) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the net's tensors, without the memory for them."""
    with torch.device("meta"):
        state = TargetNet(config).state_dict()
    return {name: tuple(t.shape) for name, t in state.items() if not name.endswith(_COUNTER)}


def _check_names(path: Path, found: set[str], expected: set[str]) -> None:
    if missing := sorted(expected - found):
        raise WeightsError(f"weights {path}: lacks {len(missing)} tensors, first {missing[0]}")
    if unknown := sorted(found - expected):
        raise WeightsError(
            f"weights {path}: has {len(unknown)} unknown tensors, first {unknown[0]!r}"
        )
