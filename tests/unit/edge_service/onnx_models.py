"""Small ONNX models in the layouts of others, and engines at work in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

LIMIT_S = 120

_DETECT = """
import json, sys
from pathlib import Path
import numpy as np
from edge_service.detector.engines import open_engine
from edge_service.errors import EdgeError
given = json.loads(sys.argv[1])
if "cache" in given["options"]:
    given["options"]["cache"] = Path(given["options"]["cache"])
try:
    detector = open_engine(given["engine"], Path(given["weights"]), threads=1, **given["options"])
    found = detector.detect_batch([np.load(p) for p in given["pictures"]])
except EdgeError as error:
    print(json.dumps({"error": str(error), "kind": type(error).__name__}))
    sys.exit()
boxes = [{level.value: [[b.x0, b.y0, b.x1, b.y1, b.score] for b in row]
          for level, row in one.boxes.items()} for one in found]
print(json.dumps({"boxes": boxes, "told": detector.describe(), "torch": "torch" in sys.modules}))
"""


def detect(engine, weights, pictures=(), **options):
    """What an engine says in a process of its own: boxes, describe, whether torch was loaded."""
    given = {
        "engine": engine,
        "weights": str(weights),
        "pictures": [str(p) for p in pictures],
        "options": options,
    }
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", _DETECT, json.dumps(given)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


def constant_model(answer, size=(64, 96), names=None, shape=None, elem=TensorProto.FLOAT):
    """A model that answers ``answer`` whatever it sees: an output is an output.

    The input takes part (times zero), as a runtime would cut it off otherwise.
    """
    answer = np.asarray(answer, np.float32)
    height, width = size
    nodes = [
        helper.make_node("ReduceMean", ["seen"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["answer", "nothing"], ["output0"]),
    ]
    if elem == TensorProto.FLOAT:
        nodes.insert(0, helper.make_node("Identity", ["images"], ["seen"]))
    else:
        nodes.insert(0, helper.make_node("Cast", ["images"], ["seen"], to=TensorProto.FLOAT))
    shape = shape or [1, 3, height, width]
    graph = helper.make_graph(
        nodes,
        "foreign",
        [helper.make_tensor_value_info("images", elem, shape)],
        [helper.make_tensor_value_info("output0", TensorProto.FLOAT, list(answer.shape))],
        [
            numpy_helper.from_array(answer, "answer"),
            numpy_helper.from_array(np.float32(0), "zero"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if names is not None:
        helper.set_model_props(model, {"names": names})
    onnx.checker.check_model(model)
    return model


def yolo_answer(boxes, classes, cells=40):
    """(1, 4 + K, N) with rows of (cell, cx, cy, w, h, class, score) in it."""
    whole = np.zeros((1, 4 + classes, cells), np.float32)
    for cell, cx, cy, w, h, k, score in boxes:
        whole[0, :4, cell] = cx, cy, w, h
        whole[0, 4 + k, cell] = score
    return whole
