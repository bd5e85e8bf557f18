"""The command as people meet it: what it says, where it writes, and how it ends."""

from __future__ import annotations

import http.server
import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer

from drone_client import cli
from drone_client.link import zenoh as link_zenoh
from drone_client.settings import ClientSettings, known_name
from rgbd_wire.frame_codec import unpack
from rgbd_wire.messages import pose_of
from tests.service_process import free_port
from tests.unit.drone_client.builders import (
    CAMERA,
    HEIGHT,
    WIDTH,
    answering,
    eventually,
    pose,
    target_of,
)
from tests.unit.drone_client.zenoh_worker import ZenohWorker

COMMAND = Path(sys.executable).with_name("drone-client")
WORLD_FROM_TARGET = pose((6, 1, 1.5), (0, 0, np.pi))
# A busy machine makes no frame late
PATIENT = ("--tau-max-ms", "9000", "--age-max-ms", "9000")


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch):
    """No DRONE_ variables but patience, narrow lines; signals and logs as before."""
    for name in list(os.environ):
        if name.startswith("DRONE_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("COLUMNS", "100")
    # A machine that stands still for a while loses no link, and every answer is waited for
    monkeypatch.setitem(link_zenoh._CONFIG, "transport/link/tx/lease", 60_000)
    monkeypatch.setenv("DRONE_REPLY_TIMEOUT_MS", "60000")
    monkeypatch.setenv("DRONE_ACK_TIMEOUT_MS", "10000")
    handlers = {sign: signal.getsignal(sign) for sign in (signal.SIGINT, signal.SIGTERM)}
    level = cv2.utils.logging.getLogLevel()
    yield
    for sign, handler in handlers.items():
        signal.signal(sign, handler)
    cv2.utils.logging.setLogLevel(level)


@pytest.fixture
def command(monkeypatch, capfd):
    """Runs ``drone-client`` in this process; exit code, stdout, stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["drone-client", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capfd.readouterr()
        return int(ended.value.code or 0), out, err

    return run


def write_recording(folder: Path, count: int, rate_hz: float = 100) -> Path:
    """A recording of tiny pictures, in which the camera flies east."""
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    picture = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    depth = np.full((HEIGHT, WIDTH), 2000, np.uint16)
    cv2.imwrite(str(folder / "rgb/0.png"), picture)
    cv2.imwrite(str(folder / "depth/0.png"), depth)
    times = [f"{1000 + i / rate_hz:.6f}" for i in range(count)]
    (folder / "rgb.txt").write_text("".join(f"{t} rgb/0.png\n" for t in times))
    (folder / "depth.txt").write_text("".join(f"{t} depth/0.png\n" for t in times))
    # Camera axes in the world for one that looks east: x = -y, y = -z, z = x
    (folder / "groundtruth.txt").write_text(
        "".join(f"{t} {2 + i / 100} 1 1.5 0.5 -0.5 0.5 -0.5\n" for i, t in enumerate(times))
    )
    (folder / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    return folder


@pytest.fixture
def recording(tmp_path) -> Path:
    """Five frames."""
    return write_recording(tmp_path / "rec", 5)


@pytest.fixture(scope="module")
def worker():
    """A worker on loopback that sees the target in every frame."""
    worker = ZenohWorker(
        answer=answering(
            lambda header: target_of(
                pose_of(header.world_from_camera).inverse() @ WORLD_FROM_TARGET
            )
        )
    )
    yield worker
    worker.close()


def lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_help_names_the_commands_and_every_variable(command):
    """Without arguments too; that one is a mistake and says so by its exit code."""
    code, out, _ = command("--help")
    assert code == 0
    assert "replay" in out
    assert "snap" in out
    for field in ClientSettings.model_fields:
        assert known_name(field) in out
    code, out, err = command()
    assert code == 2
    assert "replay" in out + err


def test_help_of_replay_has_units_defaults_and_an_example(command):
    """What a new user needs to type the first command."""
    code, out, _ = command("replay", "--help")
    words = " ".join(out.replace("│", " ").split())
    assert code == 0
    assert "Example: drone-client replay " in words
    assert "d1+d2 [ms] (default: 250.0)" in words
    assert "(default: tcp/127.0.0.1:7447)" in words
    assert "--no-as-fast-as-possible" not in words


@pytest.mark.parametrize("name", ["calibrate", "replay", "snap"])
def test_every_flag_can_be_read_at_80_columns(command, monkeypatch, name):
    """None is cut short, and no line is longer than the terminal."""
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = command(name, "--help")
    assert code == 0
    group = typer.main.get_command(cli.app)
    flags = [o for p in group.commands[name].params for o in (*p.opts, *p.secondary_opts)]
    for flag in flags:
        assert re.search(rf"(?m)(^| ){re.escape(flag)}( |$)", out), flag
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["no-such-folder"], "no-such-folder: no such file or folder; a source is"),
        (["rec", "--camera", "no.json"], "camera file no.json: No such file or directory"),
        (["rec", "--camera", "rec/rgb.txt"], "camera file rec/rgb.txt: not JSON: "),
        (["rec", "--camera", "wide.json"], "rec/rgb/0.png is 16x12, the camera file says 17x12"),
        (["rec", "--connect", "127.0.0.1:7447"], "did you mean tcp/127.0.0.1:7447?"),
        (["rec", "--connect", ","], "no endpoint; such as"),
        (["rec", "--tau-max-ms", "400"], "--tau-max-ms = 400 exceeds --age-max-ms = 300"),
        (["rec", "--window", "99"], "--window = 99: input should be less than or equal to 16"),
        (["rec", "--name", "My Drone"], "this drone's name: a-z, 0-9"),
        (["rec", "--out", "rec/rgb.txt"], "folder rec/rgb.txt: there is a file of that name"),
        (["rec", "--airframe", "no.toml"], "airframe file no.toml: No such file"),
        (["rec", "--truth", "truth.json"], "truth file truth.json: 0 frames"),
        (["rec", "--out", "run"], "no worker answers at tcp/127.0.0.1:"),
        (["rec", "--connect", "udp/127.0.0.1:1"], "need this drone's key: give --key-file"),
        (
            ["rec", "--connect", "udp/127.0.0.1:1", "--key-file", "nope.key"],
            "--key-file (DRONE_KEY_FILE): nope.key: No such file or directory; "
            "scripts/certificates FOLDER --drones drone ",
        ),
        (
            ["rec", "--connect", "tls/127.0.0.1:1", "--tls", "nope"],
            "cannot read nope/ca.pem: No such file or directory; scripts/certificates makes",
        ),
    ],
)
def test_a_mistake_is_one_line_on_stderr_and_exit_code_2(
    command, recording, monkeypatch, arguments, says
):
    """What, where, and what to do; nothing on stdout."""
    monkeypatch.chdir(recording.parent)
    wide = CAMERA.to_json()
    wide["color"]["width"] = wide["depth"]["width"] = 17
    Path("wide.json").write_text(json.dumps(wide))
    Path("truth.json").write_text("[]")
    if "--connect" not in arguments:
        arguments = [*arguments, "--connect", f"tcp/127.0.0.1:{free_port()}"]
    code, out, err = command("replay", *arguments, "--wait-for-worker-s", "0")
    assert (code, out) == (2, "")
    assert err.startswith("drone-client: ")
    assert says in err
    assert err.count("\n") == 1


def test_a_picture_that_breaks_in_mid_flight_is_one_line_too(command, recording, worker):
    """OpenCV's own words stay away; the frames before it are in the ledger."""
    names = (recording / "rgb.txt").read_text().splitlines()
    (recording / "rgb/1.png").write_bytes((recording / "rgb/0.png").read_bytes()[:50])
    names[3] = names[3].replace("0.png", "1.png")
    (recording / "rgb.txt").write_text("\n".join(names))
    out = recording.parent / "run"
    code, _, err = command(
        "replay", recording, "--connect", worker.endpoint, "--out", out, *PATIENT
    )
    assert code == 2
    assert err == f"drone-client: {recording / 'rgb/1.png'}: no picture that can be read\n"
    assert sorted(f["sequence"] for f in lines(out / "ledger.jsonl")) == [0, 1, 2]


def test_a_misspelt_variable_is_told_with_the_one_that_was_meant(command, recording, monkeypatch):
    """It would be silently ignored otherwise."""
    monkeypatch.setenv("DRONE_CONECT", "tcp/192.0.2.7:7447")
    code, _, err = command("replay", recording)
    assert code == 2
    assert err == "drone-client: unknown setting DRONE_CONECT; did you mean DRONE_CONNECT?\n"


def test_a_flag_that_does_not_exist_is_told_with_one_that_does(command, recording):
    """By the command line's own parser."""
    code, _, err = command("replay", recording, "--tau-max", "3")
    assert code == 2
    assert "--tau-max-ms" in err


def test_a_replay_says_what_happened_and_writes_it_down(command, recording, worker, monkeypatch):
    """A table for people, and four files and a picture for later; settings from the environment."""
    monkeypatch.setenv("DRONE_NAME", "env-drone")
    while not worker.frames.empty():
        worker.frames.get()
    out = recording.parent / "run"
    code, text, err = command(
        "replay", recording, "--connect", worker.endpoint, "--out", out, *PATIENT,
        "--as-fast-as-possible",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "5: 5 answered" in text
    assert "5 accepted" in text
    assert "tau_max 9000" in text
    assert str(out / "run.png") in text
    names = {"ledger.jsonl", "events.jsonl", "ticks.jsonl", "summary.json", "run.png"}
    assert {p.name for p in out.iterdir()} == names
    for line in lines(out / "ledger.jsonl"):
        seen = pose_of(tuple(line["world_from_target"]))
        np.testing.assert_allclose(seen.translation, WORLD_FROM_TARGET.translation, atol=1e-5)
    asked = [unpack(worker.frames.get(timeout=10)).header.drone for _ in range(5)]
    assert asked == ["env-drone"] * 5


def test_json_is_all_that_stdout_holds_when_it_is_asked_for(command, recording, worker):
    """For scripts; truth is compared where it is given."""
    matrix = np.eye(4).tolist()
    truth = recording / "truth.json"
    truth.write_text(json.dumps([{"camera_from_target": matrix, "visible": 1.0}] * 5))
    out = recording.parent / "[odd] name"
    code, text, _ = command(
        "replay", recording, "--connect", worker.endpoint, "--out", out, *PATIENT,
        "--as-fast-as-possible", "--json", "--no-plot", "--truth", truth,
    )  # fmt: skip
    assert code == 0
    summary = json.loads(text)
    assert summary == json.loads((out / "summary.json").read_text())
    assert summary["truth"]["found_of_these"] == 5
    assert not (out / "run.png").exists()


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_replay_with_a_whole_ledger(tmp_path, worker, sign):
    """A real process in mid-flight: exit code 130, every line whole, the summary says why."""
    recording = write_recording(tmp_path / "rec", 3_000, rate_hz=50)
    out = tmp_path / "run"
    arguments = [COMMAND, "replay", recording, "--connect", worker.endpoint, "--out", out, *PATIENT]
    process = subprocess.Popen(
        [*arguments, "--no-plot"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    ledger = out / "ledger.jsonl"
    try:
        assert eventually(
            lambda: ledger.exists() and ledger.read_text().count('"accepted"') >= 3, timeout_s=60
        )
        process.send_signal(sign)
        text, err = process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, err) == (130, "")
    frames = lines(ledger)
    assert sorted(f["sequence"] for f in frames) == list(range(len(frames)))
    summary = json.loads((out / "summary.json").read_text())
    assert summary["interrupted"] is True
    assert summary["frames"] == len(frames) < 3_000
    assert "answered" in text


def test_the_installed_command_ends_without_a_traceback(tmp_path):
    """As a shell sees it."""
    done = subprocess.run(
        [COMMAND, "replay", tmp_path / "nowhere"], capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stdout) == (2, "")
    line = f"drone-client: {tmp_path / 'nowhere'}: no such file or folder; a source is "
    assert done.stderr.startswith(line)
    assert done.stderr.count("\n") == 1


class Answering(http.server.ThreadingHTTPServer):
    """An HTTP service that gives one answer and keeps what it was asked."""

    def __init__(self, status: int, body: bytes) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.status, self.body = status, body
        self.asked: list[tuple[str, bytes]] = []
        threading.Thread(target=self.serve_forever, args=(0.01,), daemon=True).start()

    def handle_error(self, *_: object) -> None:
        """A client that hangs up in the middle of an answer is no word on this test's stderr."""

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(http.server.BaseHTTPRequestHandler):
    server: Answering

    def do_POST(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.asked.append((self.path, data))
        self.send_response(self.server.status)
        self.send_header("Content-Length", str(len(self.server.body)))
        self.end_headers()
        self.wfile.write(self.server.body)

    def log_message(self, *_: object) -> None:
        """Silent."""


@pytest.fixture
def service():
    """Starts services with one answer each; closed at the end."""
    running: list[Answering] = []

    def start(status: int, body: bytes) -> Answering:
        running.append(Answering(status, body))
        return running[-1]

    yield start
    for server in running:
        server.shutdown()
        server.server_close()


def test_snap_sends_both_pictures_and_the_camera_and_shows_the_answer(command, recording, service):
    """As a table of what people read, or all of it as JSON."""
    answer = {
        "outcome": "target",
        "note": "[bold]x[/bold]",
        "target": {"translation_m": [0.123456789, 2], "matrix": [[1.5, 0], [0, 1.5]]},
        "boxes": [{"level": "T_good", "score": 0.5}],
    }
    server = service(200, json.dumps(answer).encode())
    pictures = [recording / "rgb/0.png", recording / "depth/0.png"]
    ask = ["snap", *pictures, "--camera", recording / "camera.json", "--url", server.url + "/"]
    code, out, err = command(*ask)
    assert (code, err) == (0, "")
    rows = {row[0]: " ".join(row[1:]) for row in map(str.split, out.replace("│", " ").splitlines())}
    assert rows["note"] == "[bold]x[/bold]"
    assert rows["target.translation_m"] == "0.123457, 2"
    assert rows["boxes[0].score"] == "0.5"
    assert "1.5" not in out
    path, data = server.asked[0]
    assert path == "/v1/localize"
    for field, file in zip(("color", "depth"), pictures, strict=True):
        assert f'name="{field}"'.encode() in data
        assert file.read_bytes() in data
    assert (recording / "camera.json").read_bytes() in data
    code, out, _ = command(*ask, "--json")
    assert json.loads(out) == answer


def test_snap_tells_a_script_that_there_is_no_target(command, recording, service):
    """Exit code 1, with the answer shown all the same."""
    server = service(200, b'{"outcome": "nothing_found", "reason": "no box", "target": null}')
    camera = recording / "camera.json"
    ask = ["snap", recording / "rgb/0.png", "--camera", camera, "--url", server.url]
    code, out, err = command(*ask)
    assert (code, err) == (1, "")
    assert "nothing_found" in out


@pytest.mark.parametrize(
    ("status", "body", "says"),
    [
        (422, b'{"field": "camera", "detail": "it lacks color"}', "refused (422): it lacks color"),
        (400, b'{"detail": "two\\nlines"}', "refused (400): two lines"),
        (200, b"[1]", "refused (200): [1]"),
        (200, b"<html>", "answered 200, but no JSON"),
        (500, b"\xff\xfe", "answered 500, but no JSON"),
        (200, b"[" * 100_000, "but no JSON"),
        (200, b" " * 2_000_000, "answered over 1048576 bytes"),
        (422, b'{"detail": "' + b"x" * 9000 + b'"}', "x" * 500 + "\n"),
    ],
)
def test_an_answer_that_is_none_is_one_line(command, recording, service, status, body, says):
    """Whatever sits at that address."""
    server = service(status, body)
    code, out, err = command(
        "snap", recording / "rgb/0.png", "--camera", recording / "camera.json", "--url", server.url
    )
    assert (code, out) == (2, "")
    assert says in err
    assert err.startswith("drone-client: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("color", "camera", "url", "says"),
    [
        ("no.png", "camera.json", "http://127.0.0.1:1", "no.png: No such file"),
        ("rgb/0.png", "rgb.txt", "http://127.0.0.1:1", "rgb.txt: not JSON"),
        ("rgb/0.png", "camera.json", "http://127.0.0.1:1", "is edge-service running there?"),
        ("rgb/0.png", "camera.json", "127.0.0.1:8080", "try http://127.0.0.1:8080"),
        ("rgb/0.png", "camera.json", "ftp://edge", "try http://127.0.0.1:8080"),
        ("rgb/0.png", "camera.json", "http://a..b:8080", "try http://127.0.0.1:8080"),
    ],
)
def test_a_question_that_cannot_be_asked_is_one_line(command, recording, color, camera, url, says):
    """A file that is wrong is told before anybody is asked."""
    ask = ["snap", recording / color, "--camera", recording / camera, "--url", url]
    code, out, err = command(*ask)
    assert (code, out) == (2, "")
    assert says in err
    assert err.count("\n") == 1


def test_own_eyes_need_a_target_that_can_be_read(command, recording, worker):
    """One line that names it and the ones that there are; nothing was written."""
    out = recording.parent / "run"
    code, _, err = command(
        "replay", recording, "--connect", worker.endpoint, "--out", out, "--onboard-fallback",
        "--onboard-target", "bullseye-900",
    )  # fmt: skip
    assert code == 2
    assert err.startswith("drone-client: no target 'bullseye-900'; packaged: bullseye-200")
    assert err.count("\n") == 1
    assert not out.exists()


def test_own_eyes_leave_a_file_and_their_part_of_the_summary(command, recording, worker):
    """The pictures show no target: nothing is claimed."""
    out = recording.parent / "run"
    code, text, _ = command(
        "replay", recording, "--connect", worker.endpoint, "--out", out, *PATIENT,
        "--as-fast-as-possible", "--onboard-fallback", "--json", "--no-plot",
    )  # fmt: skip
    assert code == 0
    assert json.loads(text)["onboard"]["accepted"] == 0
    assert (out / "onboard.jsonl").exists()
