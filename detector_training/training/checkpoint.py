"""A run's whole state in one safetensors file, to go on from; never a pickle.

The tensors are named ``net.*``, ``average.*`` and ``optimizer.N.*`` (N-th parameter); numbers and
settings are JSON in the metadata. A file is checked against the net before anything is taken over.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from detector_training.datasets.output import write_file
from detector_training.errors import TrainingError
from detector_training.training.settings import TrainSettings
from detector_training.training.state import State

FORMAT = "aerial-contact-training"
VERSION = "1"
_MOMENTS = ("exp_avg", "exp_avg_sq")
_STEP = "step"
_NUMBERS: dict[str, type] = {
    "step": int,
    "images": int,
    "elapsed_s": float,
    "best": float,
    "best_step": int,
    "since_best": int,
}


def save_checkpoint(path: Path, state: State, settings: TrainSettings, origin: str) -> None:
    """Write the state whole or not at all.

    Args:
        path: The file.
        state: Of a run between two steps.
        settings: Of the run.
        origin: Digest of the data and of the weights that it started from.

    Raises:
        DatasetError: it cannot be written.
    """
    facts = {
        "settings": settings.comparable(),
        "origin": origin,
        **{name: getattr(state, name) for name in _NUMBERS},
    }
    tensors = {name: t.detach().cpu().contiguous().clone() for name, t in _tensors(state).items()}
    metadata = {"format": FORMAT, "version": VERSION, "state": json.dumps(facts)}
    write_file(path, save(tensors, metadata))


def load_checkpoint(path: Path, state: State, settings: TrainSettings, origin: str) -> None:
    """Put ``state``, fresh with the same settings, where the file says.

    Raises:
        TrainingError: the file is damaged, foreign, or of a run with other settings or data.
    """
    try:
        with safe_open(path, framework="pt") as file:
            facts = _facts(path, file.metadata() or {})
            _compare(path, facts, settings, origin)
            names = list(file.keys())
            tensors = {name: file.get_tensor(name) for name in names}
    except OSError as error:
        raise TrainingError(f"checkpoint {path}: {error.strerror or error}") from None
    except SafetensorError as error:
        raise TrainingError(
            f"checkpoint {path} is not a whole safetensors file ({error}); start anew, "
            "or from the run's weights with --from"
        ) from None
    step = facts["step"]
    _check_tensors(path, tensors, _expected(state, step > 0))
    for part, net in (("net", state.net), ("average", state.average)):
        net.load_state_dict({n: tensors[f"{part}.{n}"] for n in net.state_dict()})
    if step > 0:
        _fill_optimizer(state, tensors)
    for name in _NUMBERS:
        setattr(state, name, facts[name])


def _tensors(state: State) -> dict[str, Tensor]:
    tensors = {f"net.{n}": t for n, t in state.net.state_dict().items()}
    tensors |= {f"average.{n}": t for n, t in state.average.state_dict().items()}
    for k, values in state.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{k}.{n}": values[n] for n in (_STEP, *_MOMENTS)}
    return tensors


def _parameters(state: State) -> list[Tensor]:
    """In the order in which the optimizer numbers them."""
    return [p for group in state.optimizer.param_groups for p in group["params"]]


def _expected(state: State, with_optimizer: bool) -> dict[str, tuple[tuple[int, ...], torch.dtype]]:
    """Shape and type of each tensor of a checkpoint of this net."""
    nets = (("net", state.net), ("average", state.average))
    expected = {
        f"{part}.{n}": (tuple(t.shape), t.dtype)
        for part, net in nets
        for n, t in net.state_dict().items()
    }
    if with_optimizer:
        for k, p in enumerate(_parameters(state)):
            expected[f"optimizer.{k}.{_STEP}"] = ((), torch.float32)
            expected |= {f"optimizer.{k}.{n}": (tuple(p.shape), p.dtype) for n in _MOMENTS}
    return expected


def _fill_optimizer(state: State, tensors: dict[str, Tensor]) -> None:
    """As the optimizer left them: its moments lie in memory as their parameters do."""
    filled = state.optimizer.state_dict()
    filled["state"] = {
        k: {
            _STEP: tensors[f"optimizer.{k}.{_STEP}"],
            **{n: torch.empty_like(p).copy_(tensors[f"optimizer.{k}.{n}"]) for n in _MOMENTS},
        }
        for k, p in enumerate(_parameters(state))
    }
    state.optimizer.load_state_dict(filled)


def _facts(path: Path, metadata: dict[str, str]) -> dict[str, Any]:
    if metadata.get("format") != FORMAT or metadata.get("version") != VERSION:
        raise TrainingError(
            f"checkpoint {path}: format {metadata.get('format')!r} version "
            f"{metadata.get('version')!r}, this program reads {FORMAT!r} version {VERSION!r}"
        )
    try:
        facts = json.loads(metadata.get("state", ""))
    except (ValueError, RecursionError):
        facts = None
    if not isinstance(facts, dict) or not isinstance(facts.get("settings"), dict):
        raise TrainingError(f"checkpoint {path}: its state is no JSON object with settings")
    for name, kind in _NUMBERS.items():
        value = facts.get(name)
        if not isinstance(value, (int, float) if kind is float else int) or value != value:
            raise TrainingError(f"checkpoint {path}: {name} is {str(value)[:40]}, no number")
        if kind is int and value < 0:
            raise TrainingError(f"checkpoint {path}: {name} = {value} is negative")
    return facts


def _compare(path: Path, facts: dict[str, Any], settings: TrainSettings, origin: str) -> None:
    was, wanted = facts["settings"], settings.comparable()
    if changed := [k for k in wanted if was.get(k) != wanted[k]]:
        what = ", ".join(f"{k} ({str(was.get(k))[:40]}, now {wanted[k]})" for k in changed)
        raise TrainingError(f"{path} was made with another {what}; give the same, or another --out")
    if facts.get("origin") != origin:
        raise TrainingError(
            f"{path} was made with other pictures, labels or start weights; to go on with these: "
            f"--from {path.parent / 'last.safetensors'} and another --out"
        )


def _check_tensors(
    path: Path,
    tensors: dict[str, Tensor],
    expected: dict[str, tuple[tuple[int, ...], torch.dtype]],
) -> None:
    if missing := sorted(set(expected) - set(tensors)):
        raise TrainingError(f"checkpoint {path} lacks {len(missing)} tensors, first {missing[0]}")
    if unknown := sorted(set(tensors) - set(expected)):
        raise TrainingError(
            f"checkpoint {path} has {len(unknown)} unknown tensors, first {unknown[0][:80]}"
        )
    for name, (shape, dtype) in expected.items():
        found = tensors[name]
        if tuple(found.shape) != shape or found.dtype != dtype:
            raise TrainingError(
                f"checkpoint {path}: {name} is {found.dtype}{list(found.shape)}, "
                f"this net takes {dtype}{list(shape)}"
            )
        if dtype.is_floating_point and not bool(torch.isfinite(found).all()):
            raise TrainingError(f"checkpoint {path}: {name} holds numbers that are not finite")
