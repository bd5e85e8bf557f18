"""The weights file: round trip, and one clear error for every way to be wrong."""

from __future__ import annotations

import hashlib
import pickle

import pytest
import torch
from safetensors.torch import load_file, save_file

from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import (
    DEFAULT_WEIGHTS,
    MAX_WEIGHTS_BYTES,
    load_weights,
    save_weights,
)
from edge_service.errors import WeightsError

CLASSES = ("T_good", "T_better", "T_best")
METADATA = {
    "format": "aerial-contact-detector",
    "version": "2",
    "classes": "T_good,T_better,T_best",
    "width": "4",
    "target": "bullseye-400",
}


@pytest.fixture
def weights(tmp_path):
    torch.manual_seed(0)
    path = tmp_path / "net.safetensors"
    save_weights(path, TargetNet(NetConfig(CLASSES, 4)), "bullseye-400")
    return path


def test_what_was_saved_is_loaded(tmp_path, weights):
    """Every tensor comes back to the bit, with the file's hash and what it says of itself."""
    torch.manual_seed(0)
    want = TargetNet(NetConfig(CLASSES, 4)).eval()
    net, info = load_weights(weights)
    for name, tensor in want.state_dict().items():
        assert torch.equal(tensor, net.state_dict()[name]), name
    assert not net.training
    assert info.config == NetConfig(CLASSES, 4)
    assert info.target == "bullseye-400"
    assert info.sha256 == hashlib.sha256(weights.read_bytes()).hexdigest()
    assert [p.name for p in tmp_path.iterdir()] == ["net.safetensors"]  # no part is left


def test_a_missing_file_is_named(tmp_path):
    """The message says which file and why."""
    with pytest.raises(WeightsError, match=r"nowhere\.safetensors.*No such file"):
        load_weights(tmp_path / "nowhere.safetensors")


@pytest.mark.parametrize("keep", [0, 4, 100, 5000, -1])
def test_a_truncated_file_is_refused(weights, keep):
    """Cut at the length, in the header, in the data, and by one byte."""
    weights.write_bytes(weights.read_bytes()[:keep])
    with pytest.raises(WeightsError, match="not a whole safetensors file"):
        load_weights(weights)


def test_a_pickle_is_refused_and_not_run(tmp_path):
    """Loading executes nothing: a file that would write another one does not."""
    trap, path = tmp_path / "trap", tmp_path / "net.safetensors"

    class Trap:
        def __reduce__(self):
            return (trap.write_text, ("ran",))

    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(WeightsError, match="safetensors"):
        load_weights(path)
    assert not trap.exists()


def test_a_file_over_the_bound_is_not_even_read(tmp_path):
    """The size is looked at first."""
    path = tmp_path / "huge.safetensors"
    with path.open("wb") as file:
        file.truncate(MAX_WEIGHTS_BYTES + 1)
    with pytest.raises(WeightsError, match=f"over {MAX_WEIGHTS_BYTES}"):
        load_weights(path)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("format", None, "format None"),
        ("format", "yolo", "format 'yolo'"),
        ("version", "9", "version '9'"),
        ("classes", "cat,dog", "classes 'cat,dog'"),
        ("width", "", "width ''"),
        ("width", "-4", "width '-4'"),
        ("width", "100000000000", "width"),
        ("width", "6", "this net takes"),
        ("target", None, "target's name"),
    ],
)
def test_foreign_metadata_is_refused(weights, field, value, says):
    """Each field is checked, and the message names what it is and not a stack trace."""
    metadata = {**METADATA, field: value}
    save_file(load_file(weights), weights, {k: v for k, v in metadata.items() if v is not None})
    with pytest.raises(WeightsError, match=says):
        load_weights(weights)


def test_missing_and_unknown_tensors_are_named(weights):
    """One tensor less, one more: the first of them is in the message."""
    tensors = load_file(weights)
    gone = tensors.pop("stem.0.conv.weight")
    save_file(tensors, weights, METADATA)
    with pytest.raises(WeightsError, match=r"lacks 1 tensors, first stem\.0\.conv\.weight"):
        load_weights(weights)
    save_file({**tensors, "stem.0.conv.weight": gone, "spare": torch.ones(1)}, weights, METADATA)
    with pytest.raises(WeightsError, match="1 unknown tensors, first 'spare'"):
        load_weights(weights)


@pytest.mark.parametrize("change", [lambda t: t[:1], lambda t: t.half(), lambda t: t.double()])
def test_a_tensor_of_another_shape_or_type_is_refused(weights, change):
    """Shape and type are compared before anything is built."""
    tensors = load_file(weights)
    tensors["stem.0.conv.weight"] = change(tensors["stem.0.conv.weight"]).contiguous()
    save_file(tensors, weights, METADATA)
    with pytest.raises(WeightsError, match=r"stem\.0\.conv\.weight is .*this net takes F32"):
        load_weights(weights)


def test_numbers_that_are_not_finite_are_refused(weights):
    """A net with a NaN in it would answer nothing, silently."""
    tensors = load_file(weights)
    tensors["stem.0.conv.weight"][0] = float("nan")
    save_file(tensors, weights, METADATA)
    with pytest.raises(WeightsError, match="not finite"):
        load_weights(weights)


def test_the_packaged_weights_load_and_are_small():
    """What ships is under the bound and made for the default target."""
    _, info = load_weights(DEFAULT_WEIGHTS)
    assert DEFAULT_WEIGHTS.stat().st_size < MAX_WEIGHTS_BYTES
    assert info.target == "bullseye-400"
