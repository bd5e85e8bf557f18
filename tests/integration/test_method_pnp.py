"""PnP as users run it: a target that is no circle through a pose export, and the bullseye.

The model is a real ONNX graph that looks at the picture: a colour filter for each point and the
mean place of what passes, in the layout of a YOLOv8 pose export.
"""

from __future__ import annotations

import json
import subprocess
import sys
import urllib.request

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose, vector_from_rotation
from target_pose.target import load_target
from tests.recordings import RECORDING
from tests.service_process import service_process
from tests.unit.target_pose.render import _cast, facing_pose, render_depth

pytest.importorskip("onnxruntime")

LIMIT_S = 120
MAIN = [sys.executable, "-W", "error", "-c", "from edge_service.cli import main; main()"]
SIDE = (256, 320)  # of the net's input; the picture is larger and of another shape
TOML = """name = "panel"
[board]
side_m = 0.3
shade = "white"
"""
PLACES = ((-0.12, 0.12), (0.12, 0.11), (0.11, -0.12), (-0.10, -0.11), (0.02, 0.04), (-0.04, -0.02))
COLOURS = np.eye(3, dtype=int).tolist() + (1 - np.eye(3, dtype=int)).tolist()
LENS = (-0.055, 0.065, 0.0005, -0.0003, -0.02)
COLOR = CameraIntrinsics(480, 360, 450.0, 450.0, 243.0, 178.0, "brown_conrady", LENS)
DEPTH = CameraIntrinsics(240, 180, 200.0, 200.0, 120.5, 90.0)
CAMERA = RgbdCamera(COLOR, DEPTH, 0.001, Pose(np.array([-0.059, 0, 0]), [1.0, 0, 0, 0]))
POSE = facing_pose([0.12, -0.06, 1.0], 0.5, 2.0, 2.2)  # hung more than upside down


def pose_model(count):
    """Looks for the first colours of the list in its input; answers (1, 4 + 1 + 3 count, 8)."""
    height, width = SIDE
    # +1 for the channels that a colour has, -1 for the others, and no more than saturated
    filters = 2.0 * np.array(COLOURS[:count], np.float32) - 1
    filters /= np.maximum(np.array(COLOURS[:count]).sum(axis=1, keepdims=True), 1)
    v, u = np.mgrid[:height, :width].reshape(2, -1).astype(np.float32) + 0.5
    constants = {
        "filters": filters.reshape(count, 3, 1, 1).astype(np.float32),
        "sharp": np.float32(60),
        "flat": np.array([1, count, -1], np.int64),
        "grid": np.column_stack([u, v])[None],
        "sure": np.full((1, count, 1), 0.95, np.float32),
        "row": np.array([1, -1, 1], np.int64),
        "score": np.full((1, 1, 1), 0.9, np.float32),
        "half": np.float32(0.5),
        "nothing": np.zeros((1, 5 + 3 * count, 7), np.float32),
        "two": np.array([1, 2, 1], np.int64),
    }
    nodes = [
        helper.make_node("Conv", ["images", "filters"], ["likeness"]),
        helper.make_node("Mul", ["likeness", "sharp"], ["scaled"]),
        helper.make_node("Reshape", ["scaled", "flat"], ["pixels"]),
        helper.make_node("Softmax", ["pixels"], ["where"], axis=2),
        helper.make_node("MatMul", ["where", "grid"], ["points"]),
        helper.make_node("Concat", ["points", "sure"], ["threes"], axis=2),
        helper.make_node("Reshape", ["threes", "row"], ["numbers"]),
        helper.make_node("ReduceMin", ["points"], ["low"], axes=[1]),
        helper.make_node("ReduceMax", ["points"], ["high"], axes=[1]),
        helper.make_node("Add", ["low", "high"], ["both"]),
        helper.make_node("Mul", ["both", "half"], ["center2"]),
        helper.make_node("Sub", ["high", "low"], ["size2"]),
        helper.make_node("Reshape", ["center2", "two"], ["center"]),
        helper.make_node("Reshape", ["size2", "two"], ["size"]),
        helper.make_node("Concat", ["center", "size", "score", "numbers"], ["box"], axis=1),
        helper.make_node("Concat", ["box", "nothing"], ["output0"], axis=2),
    ]
    graph = helper.make_graph(
        nodes,
        "pose",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, height, width])],
        [helper.make_tensor_value_info("output0", TensorProto.FLOAT, [1, 5 + 3 * count, 8])],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"names": "{0: 'panel'}", "kpt_shape": f"[{count}, 3]"})
    onnx.checker.check_model(model)
    return model


def picture(target, supersample=3):
    """The board with a coloured dot at each of its points, (H, W, 3) RGB."""
    n = supersample
    u = (np.arange(COLOR.width * n) + 0.5) / n - 0.5
    v = (np.arange(COLOR.height * n) + 0.5) / n - 0.5
    places, _, hit = _cast(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2), COLOR, POSE, target)
    fine = np.where(hit[:, None], 215.0, 120.0).repeat(3, axis=1)
    for place, colour in zip(PLACES, COLOURS, strict=True):
        dot = hit & (np.hypot(*(places - place).T) < 0.012)
        fine[dot] = 20 + 215 * np.array(colour)
    shape = (COLOR.height, n, COLOR.width, n, 3)
    return fine.reshape(shape).mean(axis=(1, 3)).round().astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Target, camera, model and pictures as files."""
    path = tmp_path_factory.mktemp("panel")
    rows = [f'[[points]]\nname = "p{k}"\ny_m = {y}\nz_m = {z}\n' for k, (y, z) in enumerate(PLACES)]
    (path / "panel.toml").write_text(TOML + "".join(rows))
    (path / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    (path / "pose.onnx").write_bytes(pose_model(len(PLACES)).SerializeToString())
    (path / "short.onnx").write_bytes(pose_model(len(PLACES) - 1).SerializeToString())
    target = load_target(path / "panel.toml")
    color = picture(target)
    depth = render_depth(target, CAMERA, POSE, None, np.random.default_rng(0), noise=2.5e-3)
    mirrored = color[:, ::-1]
    for name, rgb in (("color", color), ("mirrored", mirrored)):
        assert cv2.imwrite(str(path / f"{name}.png"), np.ascontiguousarray(rgb[..., ::-1]))
    assert cv2.imwrite(str(path / "depth.png"), depth)
    return path


def localize(folder, *arguments, weights="pose.onnx"):
    """Run ``edge-service localize`` in a process of its own, as the runtimes want it."""
    command = [*MAIN, "localize", *map(str, arguments), "--camera", "camera.json", "--json"]
    command += ["--target", "panel.toml", "--threads", "1"]
    command += ["--engine", "onnxruntime", "--weights", weights] if weights else []
    return subprocess.run(
        command, capture_output=True, text=True, timeout=LIMIT_S, check=False, cwd=folder
    )


@pytest.mark.parametrize("depth", [True, False])
def test_a_panel_is_found_by_its_points_and_its_roll_without_help(folder, depth):
    """Through letterbox, net, suppression and PnP: millimetres, and which way up it hangs."""
    files = ("color.png", "depth.png") if depth else ("color.png",)
    run = localize(folder, *files, "--method", "pnp", "--classes", "T_good")
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)["target"]
    assert (found["method"], found["roll_source"]) == ("pnp", "points")
    matrix = np.array(found["camera_from_target"]["matrix"])
    assert np.linalg.norm(matrix[:3, 3] - POSE.translation) < (0.004 if depth else 0.01)
    turn = vector_from_rotation(POSE.rotation @ matrix[:3, :3].T)
    assert np.degrees(np.linalg.norm(turn)) < 1.0
    assert (found["evidence"]["range_plane_m"] is not None) == depth


def test_a_mirrored_panel_is_refused(folder):
    """All of its points are there, but not where a pose of the board would put them."""
    run = localize(folder, "mirrored.png", "--method", "pnp", "--classes", "T_good")
    assert run.returncode == 1, run.stderr
    body = json.loads(run.stdout)
    assert (body["outcome"], body["target"]) == ("refused", None)
    assert body["reason"] in ("points_disagree", "behind_camera")


@pytest.mark.parametrize(
    ("arguments", "weights", "told"),
    [
        (("--classes", "T_good"), "pose.onnx", "--method pnp"),
        (("--method", "pnp"), "pose.onnx", "--classes"),
        (("--method", "pnp", "--classes", "T_best"), "pose.onnx", "say which class it is"),
        (
            ("--method", "pnp", "--classes", "T_good"),
            "short.onnx",
            "5 key points a box, and the target has 6 [[points]]",
        ),
        (("--method", "pnp"), None, "the packaged weights give no key points"),
        (("--method", "pnq"), "pose.onnx", "--method: "),
    ],
)
def test_what_does_not_fit_together_is_one_line_at_the_start(folder, arguments, weights, told):
    """Exit status 2, what is wrong, and which flag mends it."""
    run = localize(folder, "color.png", *arguments, weights=weights)
    assert (run.returncode, run.stdout) == (2, "")
    (line,) = run.stderr.splitlines()
    assert line.startswith("edge-service: ")
    assert told in line


def test_a_worker_says_by_which_method_it_localises(folder, tmp_path):
    """On its first lines and in /v1/model; a target that cannot be drawn is not checked for."""
    env = {
        "EDGE_TARGET": str(folder / "panel.toml"),
        "EDGE_METHOD": "pnp",
        "EDGE_ENGINE": "onnxruntime",
        "EDGE_WEIGHTS": str(folder / "pose.onnx"),
        "EDGE_CLASSES": "T_good",
    }
    with service_process(tmp_path, env=env) as service:
        with urllib.request.urlopen(f"http://{service.http}/v1/model", timeout=10) as answer:
            told = json.load(answer)
        assert service.stop() == 0
    assert told["method"] == "pnp"
    assert told["target"]["points"][0] == {"name": "p0", "y_m": -0.12, "z_m": 0.12}
    assert told["detector"]["points"] == len(PLACES)
    assert told["detector"]["self_check"] == "none: panel has no discs that could be drawn"
    assert "target panel, method pnp" in service.log.read_text()


@pytest.mark.parametrize("number", [-12, -1])
def test_a_rendered_bullseye_goes_the_same_way(number):
    """A frame of the shipped recording, the packaged net, the corners of the board."""
    frames = json.loads((RECORDING / "truth.json").read_text())
    files = []
    for name in ("rgb.txt", "depth.txt"):
        lines = [row for row in (RECORDING / name).read_text().splitlines() if row[0] != "#"]
        files.append(lines[number].split()[1])
    command = [*MAIN, "localize", *files, "--camera", "camera.json", "--json", "--method", "pnp"]
    run = subprocess.run(
        [*command, "--threads", "1"],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
        cwd=RECORDING,
    )
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)["target"]
    assert found["method"] == "pnp"
    assert found["evidence"]["plane_inliers"] > 100
    got = np.array(found["camera_from_target"]["matrix"])
    want = np.array(frames[number]["camera_from_target"])
    assert np.linalg.norm(got[:3, 3] - want[:3, 3]) < 0.01
    assert got[:3, 0] @ want[:3, 0] > np.cos(np.radians(2))
