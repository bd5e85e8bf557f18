"""The command: what people see first, and that every mistake is one line."""

from __future__ import annotations

import json
import os
import re
import sys

import imagecodecs
import pytest
from typer.main import get_command

from edge_service import parts
from edge_service.cli import app, main
from edge_service.detector.net import NetConfig, TargetNet
from edge_service.detector.weights import save_weights
from edge_service.settings import EdgeSettings
from target_pose.target import Level
from tests.unit.edge_service.edge_fakes import CAMERA_JSON, COLOR, DEPTH, KnownDetector


@pytest.fixture(autouse=True)
def _wide_terminal(monkeypatch):
    for name in [n for n in os.environ if n.startswith("EDGE_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERM", "dumb")


@pytest.fixture
def run(monkeypatch, capsys):
    """Runs a command in this process: exit code, output, errors."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["edge-service", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return ended.value.code, captured.out, captured.err

    return run


@pytest.fixture
def files(tmp_path):
    """Colour, depth and camera of the scene, as files."""
    paths = [tmp_path / name for name in ("color.png", "depth.png", "camera.json")]
    paths[0].write_bytes(imagecodecs.png_encode(COLOR))
    paths[1].write_bytes(imagecodecs.png_encode(DEPTH))
    paths[2].write_text(CAMERA_JSON)
    return paths


@pytest.fixture
def _known_detector(monkeypatch):
    monkeypatch.setattr(parts, "open_engine", lambda *_, **__: KnownDetector())


@pytest.mark.usefixtures("_known_detector")
def test_localize_says_where_the_target_is(run, files):
    """A small table for people: distance, position with its uncertainty, how it was found."""
    color, depth, camera = files
    code, out, err = run("localize", color, depth, "--camera", camera)
    assert (code, err) == (0, "")
    assert re.search(r"distance +1\.50\d m \+- [\d.]+ mm", out)
    assert re.search(r"circles +\d+ of \d+ edge points, rms [\d.]+ px", out)
    assert re.search(r"ranges +1\.\d+ m by the circles, 1\.\d+ m by the depth: [\d.]+ sigma", out)
    assert re.search(r"position +\+0\.0[45]\d\d -0\.0[23]\d\d \+1\.[45]\d\d\d m in camera", out)
    assert re.search(r"method +fused, roll by \w+, score 0\.92", out)
    assert re.search(r"time +detect [\d.]+, nest [\d.]+, localise [\d.]+ ms", out)


@pytest.mark.usefixtures("_known_detector")
def test_localize_prints_json_for_scripts(run, files):
    """The same body as POST /v1/localize, and nothing else on the output."""
    color, _, camera = files
    code, out, _ = run("localize", color, "--camera", camera, "--json")
    body = json.loads(out)
    assert code == 0
    assert body["target"]["method"] == "ellipse"  # no depth was given
    assert body["model"] == KnownDetector.model_hash


@pytest.mark.usefixtures("_known_detector")
def test_localize_draws_what_it_found(run, files, tmp_path):
    """A picture beside the table; a name that cannot be one is told before the work."""
    color, depth, camera = files
    out = tmp_path / "found.png"
    code, _, err = run("localize", color, depth, "--camera", camera, "--draw", out)
    assert (code, err) == (0, "")
    assert imagecodecs.png_decode(out.read_bytes()).shape[2] == 3
    code, out, err = run("localize", color, "--camera", camera, "--draw", tmp_path / "found.bmp")
    assert (code, out) == (2, "")
    assert err.startswith("edge-service: --draw ")
    assert err.count("\n") == 1


def test_localize_without_a_target_exits_with_1(run, files, tmp_path):
    """Like grep: 0 found, 1 not found, 2 a mistake. Through the real, untrained net."""
    weights = tmp_path / "untrained.safetensors"
    save_weights(weights, TargetNet(NetConfig(tuple(lv.value for lv in Level), 4)), "none")
    color, depth, camera = files
    arguments = ["localize", color, depth, "--camera", camera, "--weights", weights]
    code, out, _ = run(*arguments, "--threads", 1)
    assert code == 1
    assert re.search(r"outcome +nothing_found", out)
    assert re.search(r"reason +no box", out)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({0: "none.jpg"}, "color: none.jpg: No such file or directory"),
        ({0: "/"}, "color: /: Is a directory"),
        ({1: "none.png"}, "depth: none.png: No such file"),
        ({1: 0}, "depth: the PNG is 8-bit RGB and must be a 16-bit grey PNG"),
        ({2: "none.json"}, "camera: none.json: No such file"),
        ({2: 0}, "camera: "),
    ],
)
def test_a_file_that_cannot_be_used_is_one_line(run, files, change, words):
    """Which argument, which file, what is wrong with it; exit code 2."""
    chosen = [files[c] if isinstance(c, int) else c for c in (change.get(n, n) for n in range(3))]
    color, depth, camera = chosen
    code, out, err = run("localize", color, depth, "--camera", camera)
    assert (code, out) == (2, "")
    assert err.startswith("edge-service: " + words)
    assert err.count("\n") == 1


def test_settings_lists_every_variable(run):
    """Each variable with its default and what it means."""
    code, out, _ = run("settings")
    assert code == 0
    for name in EdgeSettings.model_fields:
        assert f"EDGE_{name.upper()} " in out
    assert "tcp/0.0.0.0:7447" in out
    assert "Longest time [s]" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--help"], ["serve", "localize", "settings"]),
        (["serve", "--help"], ["--listen", "--http", "Example: edge-service serve --listen"]),
        (["localize", "--help"], ["color", "--camera", "Example: edge-service localize color.jpg"]),
    ],
)
def test_help_has_an_example(run, arguments, words):
    """Help comes at once and shows a whole command."""
    code, out, _ = run(*arguments)
    assert code == 0
    for word in words:
        assert word in out


@pytest.mark.parametrize("command", ["serve", "localize"])
def test_every_flag_can_be_read_at_80_columns(run, monkeypatch, command):
    """None is cut short, and no line is longer than the terminal."""
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run(command, "--help")
    assert code == 0
    for flag in (o for p in get_command(app).commands[command].params for o in p.opts):
        assert re.search(rf"(?m)(^| ){re.escape(flag)}( |$)", out), flag
    assert max(map(len, out.splitlines())) <= 80


def test_a_missing_extra_is_one_line(run, files, monkeypatch):
    """Where torch is not installed, the line says how to install it."""
    monkeypatch.setitem(sys.modules, "edge_service.one_frame", None)
    monkeypatch.delitem(sys.modules, "edge_service.one_frame")
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "edge_service.parts", raising=False)
    monkeypatch.delitem(sys.modules, "edge_service.detector.engine", raising=False)
    color, depth, camera = files
    code, _, err = run("localize", color, depth, "--camera", camera)
    assert code == 2
    assert err == "edge-service: package torch is missing; install aerial-contact[edge]\n"
