"""Engines on ONNX: the same boxes as torch, foreign models, and one clear error for the rest.

Every runtime runs in a process of its own, as in the service: their pools never share one.
"""

from __future__ import annotations

import hashlib
import pickle

import numpy as np
import onnx
import pytest
import torch

from edge_service.detector import engines
from edge_service.detector.engines import open_engine
from edge_service.detector.files import DEFAULT_WEIGHTS, MAX_MODEL_BYTES
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.onnx_export import MAX_OPSET, onnx_bytes
from edge_service.detector.onnx_file import read_onnx
from edge_service.detector.onnx_model import model_of
from edge_service.detector.weights import load_weights, save_weights
from edge_service.errors import EdgeError, WeightsError
from target_pose.target import Level
from tests.unit.edge_service.onnx_models import constant_model, detect, yolo_answer

LEVELS = [level.value for level in Level]
NAMES = "{0: 'cat', 1: 'T_best', 2: 'T_good'}"
RUNTIMES = ["onnxruntime", "openvino"]


@pytest.fixture(autouse=True)
def _runtimes():
    pytest.importorskip("onnxruntime")
    pytest.importorskip("openvino")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A tiny net that answers at random."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(path, TargetNet(NetConfig(tuple(LEVELS), 4)), "bullseye-400")
    return path


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Two pictures of one size and one of another, as files."""
    folder, rng = tmp_path_factory.mktemp("pictures"), np.random.default_rng(0)
    paths = []
    for k, (height, width) in enumerate([(64, 96), (64, 96), (90, 50)]):
        paths.append(folder / f"{k}.npy")
        np.save(paths[-1], rng.integers(0, 255, (height, width, 3), dtype=np.uint8))
    return paths


def saved(model, path):
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize("engine", RUNTIMES)
def test_every_engine_finds_the_boxes_that_torch_finds(engine, weights, pictures, tmp_path):
    """From the same weights, converted on the way: within 1 px and 0.001, without torch."""
    options = {"precision": "fp32", "score_threshold": 0.005}
    want = open_engine("torch", weights, threads=1, device="cpu", **options).detect_batch(
        [np.load(p) for p in pictures]
    )
    got = detect(engine, weights, pictures, cache=str(tmp_path / "cache"), **options)
    assert not got["torch"]
    assert got["told"]["engine"] == engine
    assert got["told"]["precision"] == "fp32"
    assert got["told"]["model_hash"] == hashlib.sha256(weights.read_bytes()).hexdigest()
    for ours, theirs in zip(want, got["boxes"], strict=True):
        assert set(theirs) == set(LEVELS)
        for level, boxes in ours.boxes.items():
            rows = np.array([[b.x0, b.y0, b.x1, b.y1, b.score] for b in boxes])
            other = np.array(theirs[level.value]).reshape(rows.shape)
            np.testing.assert_allclose(rows[..., :4], other[..., :4], atol=1)
            np.testing.assert_allclose(rows[..., 4], other[..., 4], atol=1e-3)
    assert sum(len(b) for one in want for b in one.boxes.values()) > 0


def test_the_same_weights_give_the_same_file(weights):
    """To the byte; a fixed batch of one by default, any size, and it says what it is."""
    net, info = load_weights(weights)
    data = onnx_bytes(net, info)
    assert data == onnx_bytes(net, info)
    model = onnx.load_model_from_string(data)
    told = {p.key: p.value for p in model.metadata_props}
    assert told["format"] == "aerial-contact-detector"
    assert told["weights_sha256"] == info.sha256
    assert told["classes"] == ",".join(LEVELS)
    dims = model.graph.input[0].type.tensor_type.shape.dim
    assert [d.dim_value for d in dims] == [1, 3, 0, 0]
    with pytest.raises(EdgeError, match=f"opset {MAX_OPSET + 1}"):
        onnx_bytes(net, info, opset=MAX_OPSET + 1)


def test_a_conversion_is_kept(weights, pictures, tmp_path):
    """The second start takes the file as it is; nothing else is left in the folder."""
    cache = tmp_path / "deep" / "cache"
    first = detect("onnxruntime", weights, pictures[:1], cache=str(cache))
    (kept,) = cache.iterdir()
    before = kept.stat().st_mtime_ns
    assert detect("onnxruntime", weights, pictures[:1], cache=str(cache)) == first
    assert kept.stat().st_mtime_ns == before
    kept.write_bytes(onnx_bytes(*load_weights(DEFAULT_WEIGHTS)))
    got = detect("onnxruntime", weights, cache=str(cache))
    assert "of other weights; remove the file" in got["error"]


def test_weights_that_cannot_be_converted_say_why(tmp_path):
    """What the other process found wrong is the message; so is a folder that cannot be made."""
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"\x10" + bytes(7) + b"{}")
    with pytest.raises(WeightsError, match=r"broken\.safetensors: not a whole safetensors file"):
        open_engine("onnxruntime", broken, cache=tmp_path / "cache")
    (tmp_path / "file").write_text("")
    with pytest.raises(WeightsError, match="EDGE_MODEL_CACHE"):
        open_engine("onnxruntime", broken, cache=tmp_path / "file" / "cache")


@pytest.mark.parametrize("engine", RUNTIMES)
def test_a_yolo_export_is_read(engine, pictures, tmp_path):
    """Its names say which class is which level; its boxes come back in the picture's pixels."""
    answer = yolo_answer([(3, 48, 32, 20, 16, 2, 0.9), (7, 48, 32, 8, 8, 0, 0.9)], classes=3)
    path = saved(constant_model(answer, names=NAMES), tmp_path / "own.onnx")
    got = detect(engine, path, pictures[:2])
    for boxes in got["boxes"]:
        assert boxes["T_best"] == []
        np.testing.assert_allclose(boxes["T_good"], [[37.5, 23.5, 57.5, 39.5, 0.9]], atol=0.01)
    assert got["told"]["layout"] == "yolo"
    assert sorted(got["told"]["levels"]) == ["T_best", "T_good"]


def test_an_end_to_end_export_is_read(pictures, tmp_path):
    """A list of boxes; the letterbox of a net of one size is undone."""
    answer = [
        [(10, 20, 30, 40, 0.8, 1), (0, 0, 9, 9, 0.1, 1), (1, 1, 9, 9, 0.9, 0)] + [[0] * 6] * 5
    ]
    path = saved(constant_model(answer, size=(128, 192)), tmp_path / "own.onnx")
    got = detect("onnxruntime", path, pictures[:1], classes="-,T_better,-")
    assert got["told"]["layout"] == "end_to_end"
    np.testing.assert_allclose(  # the input is twice as large as the picture
        got["boxes"][0]["T_better"], [[4.5, 9.5, 14.5, 19.5, 0.8]], atol=0.01
    )


@pytest.mark.parametrize(
    ("shape", "names", "classes", "says"),
    [
        ((1, 7, 40), None, None, "without metadata names.*--classes"),
        ((1, 7, 40), "{0: 'a'}", None, "classes 'a'"),
        ((1, 7, 40), "f()", None, "no list of class names"),
        ((1, 7, 40), "{1: 'T_good'}", None, "no list of class names"),
        ((1, 9, 40), NAMES, None, "with 3 classes is not known; read are"),
        ((1, 40, 8), NAMES, None, "YOLOv5"),
        ((7, 40), NAMES, None, "outputs of shapes"),
        ((1, 7, 40), None, "T_good,T_good,x", "at most once"),
    ],
)
def test_a_foreign_model_that_cannot_be_read_says_why(shape, names, classes, says, tmp_path):
    """Which names or shapes it has, and what to do."""
    answer = np.zeros(shape, np.float32)
    file = read_onnx(saved(constant_model(answer, names=names), tmp_path / "own.onnx"))
    with pytest.raises(WeightsError, match=says):
        model_of(file, (answer,), classes)


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (lambda: constant_model([[[0]]], shape=[1, 1, 64, 64]), "a detector takes FLOAT"),
        (lambda: constant_model([[[0]]], elem=onnx.TensorProto.FLOAT16), "FLOAT16"),
        (lambda: constant_model([[[0]]], shape=[8, 3, 64, 64]), "a batch of 8"),
        (lambda: constant_model([[[0]]], shape=[1, 3, 9000, 64]), "16 to 4096"),
        (lambda: constant_model([[[0]]], shape=[1, 3, "h", 64]), "one side fixed"),
    ],
)
def test_an_input_that_is_no_picture_is_refused(model, says, tmp_path):
    """Looked at before a runtime is loaded."""
    with pytest.raises(WeightsError, match=says):
        read_onnx(saved(model(), tmp_path / "own.onnx"))


@pytest.mark.parametrize("keep", [0, 10, 300, -40])
def test_a_truncated_onnx_file_is_refused(keep, weights, tmp_path):
    """Wherever it was cut."""
    path = tmp_path / "cut.onnx"
    path.write_bytes(onnx_bytes(*load_weights(weights))[:keep])
    with pytest.raises(WeightsError, match=r"cut\.onnx: not a whole ONNX file"):
        read_onnx(path)


def test_weights_beside_the_file_are_refused(tmp_path):
    """The path in it could point to anything on the machine."""
    model = constant_model(np.zeros((1, 7, 400)), names=NAMES)
    tensor = model.graph.initializer[0]
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../etc/passwd")
    with pytest.raises(WeightsError, match="single file"):
        read_onnx(saved(model, tmp_path / "own.onnx"))


def test_a_pickle_is_never_opened(tmp_path):
    """By its first bytes or by its name, for any engine."""
    for name, data in (
        ("a.pt", b"x"),
        ("b.onnx", pickle.dumps(1)),
        ("c.safetensors", b"PK\x03\x04"),
    ):
        path = tmp_path / name
        path.write_bytes(data)
        for engine in ("torch", "onnxruntime"):
            with pytest.raises(WeightsError, match="pickled.*safetensors or ONNX only"):
                open_engine(engine, path)


def test_a_file_of_the_wrong_kind_or_size_is_refused(tmp_path):
    """An ONNX file for torch, neither of the two, far too large, or missing."""
    path = saved(constant_model([[[0]]]), tmp_path / "own.onnx")
    with pytest.raises(WeightsError, match="--engine onnxruntime"):
        open_engine("torch", path)
    with pytest.raises(WeightsError, match="neither"):
        open_engine("onnxruntime", path.rename(tmp_path / "own.bin"))
    with (tmp_path / "huge.onnx").open("wb") as file:
        file.truncate(MAX_MODEL_BYTES + 1)
    with pytest.raises(WeightsError, match="are over"):
        open_engine("onnxruntime", tmp_path / "huge.onnx")
    with pytest.raises(WeightsError, match="No such file"):
        open_engine("openvino", tmp_path / "none.onnx")


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("tensorrt", {}, "'tensorrt' is not one of torch"),
        ("torch", {"precision": "fp16", "device": "cpu"}, "fp16 is for GPUs"),
        ("onnxruntime", {"threads": 0}, "threads = 0"),
        ("openvino", {"score_threshold": 0.0}, "score threshold"),
    ],
)
def test_options_out_of_bounds_raise(name, options, says):
    """The message states the value."""
    with pytest.raises(EdgeError, match=says):
        open_engine(name, **options)


def test_a_precision_that_an_engine_lacks_is_told(weights, tmp_path):
    """Asked for bf16, onnxruntime does not quietly compute in another."""
    got = detect("onnxruntime", weights, precision="bf16", cache=str(tmp_path))
    assert "onnxruntime computes" in got["error"]


def test_an_engine_that_is_not_installed_says_which(weights, monkeypatch):
    """Before anything is converted; the command names the extra that brings it."""
    monkeypatch.setattr(engines, "find_spec", lambda _: None)
    with pytest.raises(ModuleNotFoundError) as raised:
        open_engine("openvino", weights)
    assert raised.value.name == "openvino"
