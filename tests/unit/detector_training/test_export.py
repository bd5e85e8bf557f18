"""Export: a file only when it says what the net says, and int8 only when it costs nothing."""

from __future__ import annotations

import json
import subprocess
import sys

import cv2
import numpy as np
import onnx
import pytest
import torch
import typer
from onnx import TensorProto, helper
from torch import nn

from detector_training.commands import export as export_file
from detector_training.datasets.sample import CLASSES, Sample
from detector_training.errors import ExportError
from detector_training.export.accuracy import Accuracy, worst_loss
from detector_training.export.apart import apart
from detector_training.export.export import Int8, export
from detector_training.export.quantise import last_convolutions
from edge_service.detector.drawn import draw
from edge_service.detector.engines import raw_outputs
from edge_service.detector.net import NetConfig, Prediction, TargetNet
from edge_service.detector.onnx_export import net_outputs, onnx_bytes
from edge_service.detector.onnx_file import read_onnx
from edge_service.detector.parity import compare, require_parity
from edge_service.detector.weights import load_weights, save_weights
from edge_service.errors import WeightsError
from target_pose.target import Level, load_target

TARGET = load_target()


@pytest.fixture(autouse=True)
def _runtime():
    pytest.importorskip("onnxruntime")


@pytest.fixture
def weights(tmp_path):
    """A tiny net that answers at random."""
    torch.manual_seed(0)
    path = tmp_path / "tiny.safetensors"
    save_weights(path, TargetNet(NetConfig(CLASSES, 4)), "bullseye-400")
    return path


@pytest.fixture
def samples(tmp_path):
    """The drawn targets as a data set of three pictures."""
    made = []
    for k, drawn in enumerate(draw(TARGET)):
        path = tmp_path / f"{k}.png"
        cv2.imwrite(str(path), drawn.color_rgb[..., ::-1])
        boxes = [[b.x0, b.y0, b.x1, b.y1] for b in (drawn.boxes[level] for level in Level)]
        height, width = drawn.color_rgb.shape[:2]
        made.append(
            Sample(
                image=path,
                width=width,
                height=height,
                kind="scene",
                conditions=(),
                boxes=np.array(boxes, np.float32),
                classes=np.arange(3),
                visible=np.ones(3, np.float32),
            )
        )
    return made


def answers(score=0.5, far=10.0):
    logit = np.full((1, 2, 3), np.log(score / (1 - score)), np.float32)
    return logit, np.full((1, 2, 3, 4), far, np.float32)


def test_parity_is_the_largest_difference():
    """Of scores everywhere, of boxes where one could be told."""
    want, got = answers(0.5, 10.0), answers(0.5005, 10.8)
    parity = compare([want], [got])
    assert parity.score == pytest.approx(0.0005, abs=1e-6)
    assert parity.box_px == pytest.approx(0.8, abs=1e-5)
    assert parity.holds
    assert not compare([want], [answers(0.5, 11.1)]).holds
    assert not compare([want], [answers(0.502, 10.0)]).holds
    assert compare([answers(0.01, 10.0)], [answers(0.01, 99.0)]).holds  # nobody is told of it
    assert not compare([want], [answers(0.5, np.nan)]).holds
    with pytest.raises(WeightsError, match="1.1 px.*Nothing was written"):
        require_parity(compare([want], [answers(0.5, 11.1)]), "it")
    with pytest.raises(WeightsError, match="shapes"):
        compare([want], [want[:1]])


def test_the_last_convolutions_are_those_before_the_outputs():
    """And what follows them; not the one before."""
    conv = [
        helper.make_node("Conv", [a, "w"], [b], name=name)
        for a, b, name in (("x", "a", "body"), ("a", "b", "head"))
    ]
    nodes = [*conv, helper.make_node("Relu", ["b"], ["y"], name="end")]
    value = helper.make_tensor_value_info("y", TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "g", [], [value])
    assert last_convolutions(graph) == ["end", "head"]


def test_the_worst_loss_is_the_largest_fall():
    """A gain elsewhere does not make up for it; what cannot be measured does not count."""
    before = Accuracy({"a": 0.9, "b": 0.5, "c": None}, {"a": 0.9}, 0.0)
    after = Accuracy({"a": 0.87, "b": 0.7, "c": None}, {"a": 0.95}, 0.0)
    assert worst_loss(before, after) == pytest.approx(0.03)
    assert worst_loss(after, after) == 0


def test_an_int8_export_is_small_checked_and_read(weights, samples, tmp_path):
    """A net that finds nothing loses nothing: the file is written, and says that it is int8."""
    out = tmp_path / "deep" / "int8.onnx"
    done = export(weights, out, TARGET, pictures=samples, int8=Int8(samples, samples))
    assert done.parity.holds
    assert done.parity.pictures == 6
    assert done.before is not None
    assert [p.name for p in out.parent.iterdir()] == ["int8.onnx"]
    file = read_onnx(out)
    assert file.quantised
    assert file.is_ours
    assert file.sha256 == done.sha256
    kinds = {n.op_type for n in onnx.load(out).graph.node}
    assert "QuantizeLinear" in kinds
    json.dumps(done.as_json())


class Flat(nn.Module):
    """A net of one convolution for each answer, that takes any number of pictures."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        self.outs = nn.ModuleList(nn.Conv2d(3, 3 * k, 8, 8) for k in (1, 4))

    def fused(self):
        return self

    def forward(self, x):
        logits, far = (out(x).flatten(2).transpose(1, 2) for out in self.outs)
        return Prediction(logits, far.unflatten(2, (3, 4)))


@pytest.mark.parametrize("runtime", ["onnxruntime", "openvino"])
def test_a_batch_of_any_size_is_asked_for_by_name(weights, runtime, tmp_path):
    """The graph of a net that allows it answers to three pictures as the net does."""
    pytest.importorskip(runtime)
    torch.manual_seed(0)
    net, info = Flat(NetConfig(CLASSES, 4)), load_weights(weights)[1]
    inputs = [np.random.default_rng(0).integers(0, 255, (b, 64, 96, 3), np.uint8) for b in (1, 3)]
    path = tmp_path / "any.onnx"
    path.write_bytes(onnx_bytes(net, info, dynamic_batch=True))
    want = net_outputs(net, inputs)
    parity = compare(want, apart(raw_outputs, runtime, path, 1, inputs))
    assert parity.pictures == 4
    assert parity.holds


def test_what_int8_may_not_cost_writes_nothing(weights, samples, tmp_path):
    """A bound that nothing can meet: the file is not there, and neither is a part of it."""
    out = tmp_path / "out" / "int8.onnx"
    with pytest.raises(ExportError, match="int8 costs 0.000 .*Nothing was written"):
        export(weights, out, TARGET, int8=Int8(samples, samples, max_loss=-1.0))
    assert not out.parent.exists()


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "detector_training", "export", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_command_says_what_it_made(weights, tmp_path):
    """As JSON for scripts; the same weights give the same hash."""
    out = tmp_path / "a.onnx"
    run = command(weights, out, "--json", "--workers", 1)
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)
    assert told["sha256"] == read_onnx(out).sha256
    assert told["parity"]["box_px"] < 1


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["a.onnx", "--int8"], "--calibrate DATA"),
        (["a.onnx", "--calibrate", "."], "--int8 alone"),
        (["a.onnx", "--int8", "--calibrate", "."], "--check DATA"),
        (["a.bin"], "must end in .onnx"),
    ],
)
def test_what_does_not_go_together_is_one_line(arguments, says, capsys):
    """Told before anything is loaded; exit status 2."""
    app = typer.Typer()
    export_file.register(app)
    with pytest.raises(SystemExit) as ended:
        app(["none.safetensors", *arguments], standalone_mode=False)
    assert ended.value.code == 2
    assert says in capsys.readouterr().err
