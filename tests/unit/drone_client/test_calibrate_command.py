"""``drone-client calibrate`` as people run it, on a recording made wrong in known ways."""

from __future__ import annotations

import http.server
import json
import signal
import sys
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from drone_client import cli
from drone_client.source.replay import open_recording
from drone_client.truth import load_truth
from target_pose.target import load_target
from target_pose.window import projected_boxes
from tests.recordings import RECORDING

TRUTH = RECORDING / "truth.json"
KITCHEN = Path(__file__).parents[4] / "shared/data/kitchen-bullseye"
KITCHEN_CAMERA = {
    "color": {"width": 640, "height": 480, "fx": 585, "fy": 585, "cx": 320, "cy": 240},
    "depth_scale_m": 0.0002,
}


@pytest.fixture(autouse=True)
def as_it_was(monkeypatch):
    """Wide lines, and the process's signals and logs as before."""
    monkeypatch.setenv("COLUMNS", "240")
    handlers = {sign: signal.getsignal(sign) for sign in (signal.SIGINT, signal.SIGTERM)}
    level = cv2.utils.logging.getLogLevel()
    yield
    for sign, handler in handlers.items():
        signal.signal(sign, handler)
    cv2.utils.logging.setLogLevel(level)


@pytest.fixture
def calibrate(monkeypatch, capfd):
    """Runs the command in this process; exit code, stdout, stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["drone-client", "calibrate", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capfd.readouterr()
        return int(ended.value.code or 0), out, err

    return run


@pytest.fixture
def camera_file(tmp_path):
    """Writes the recording's camera file with something changed."""

    def write(change):
        camera = json.loads((RECORDING / "camera.json").read_text())
        change(camera)
        path = tmp_path / "camera.json"
        path.write_text(json.dumps(camera))
        return path

    return write


def shifted(axis, by_m):
    def change(camera):
        camera["color_from_depth"]["translation_m"][axis] += by_m

    return change


def scaled(by):
    def change(camera):
        camera["depth_scale_m"] *= by

    return change


def nothing(camera):
    pass


@pytest.mark.parametrize(
    ("change", "code", "off"),
    [
        (nothing, 0, set()),
        (shifted(2, 0.02), 1, {"shift forward"}),
        (shifted(0, 0.02), 1, {"shift right"}),
        (scaled(1.02), 1, {"scale"}),
        (scaled(5.0), 1, {"depth unit"}),
        (scaled(0.3048), 1, {"depth unit"}),
    ],
)
def test_what_was_made_wrong_is_named(calibrate, camera_file, change, code, off):
    """And nothing else; the untouched recording is good."""
    file = camera_file(change)
    got, out, err = calibrate(RECORDING, "--truth", TRUTH, "--camera", file, "--json")
    body = json.loads(out)
    found = {v["name"]: v for v in body["verdicts"] if v["finding"] == "off"}
    assert (got, err) == (code, "")
    assert set(found) - {"agreement"} == off
    assert body["finding"] == ("off" if code else "good")
    if "shift forward" in off or "shift right" in off:
        name = next(n for n in off if n.startswith("shift"))
        assert abs(found[name]["value"]) == pytest.approx(20, abs=4 * found[name]["sigma"])
        assert "color_from_depth.translation_m" in found[name]["do"]


def test_people_get_a_table_and_a_picture(calibrate, tmp_path):
    """Each quantity with its verdict, and what to do where not enough was seen."""
    plot = tmp_path / "cal.png"
    code, out, err = calibrate(RECORDING, "--truth", TRUTH, "--frames", 23, "--plot", plot)
    assert (code, err) == (0, "")
    for words in ("agreement", "good", "shift down", "unknown", "-> look at the target from above"):
        assert words in out
    assert "frames used, 0.8" in out
    assert cv2.imread(str(plot)).shape[0] > 500
    assert [p.name for p in tmp_path.iterdir()] == ["cal.png"]


def test_one_frame_says_nothing(calibrate, tmp_path):
    """Exit code 2 and how to record; the picture says it too, though there is nothing in it."""
    plot = tmp_path / "cal.png"
    code, out, _ = calibrate(RECORDING, "--truth", TRUTH, "--frames", 1, "--plot", plot)
    assert plot.is_file()
    assert code == 2
    assert "it takes 5" in out
    assert "hold the camera still" in out


def without_depth(folder):
    """The recording with its depth pictures left out."""
    folder.mkdir()
    for name in ("rgb.txt", "groundtruth.txt", "camera.json", "rgb"):
        (folder / name).symlink_to(RECORDING / name)
    return folder


def test_without_depth_there_is_nothing_to_compare(calibrate, tmp_path):
    """Said with the count of the frames."""
    rec = without_depth(tmp_path / "rec")
    code, out, _ = calibrate(rec, "--truth", TRUTH, "--frames", 9)
    assert code == 2
    assert "no depth picture" in out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((RECORDING,), "exactly one of these says: --worker http://127.0.0.1:8080"),
        ((RECORDING, "--truth", TRUTH, "--run", "x"), "exactly one of these says"),
        ((RECORDING, "--run", "none"), "run none: "),
        ((RECORDING, "--truth", "none.json"), "truth file none.json: No such file"),
        ((RECORDING, "--truth", TRUTH, "--target", "none"), "no target 'none'; packaged: "),
        ((RECORDING, "--worker", "http://127.0.0.1:9"), "no answer from http://127.0.0.1:9"),
        ((RECORDING, "--worker", "nonsense"), "address 'nonsense' is none"),
        (("none", "--truth", TRUTH), "none: no such file or folder; a source is"),
        ((RECORDING, "--truth", TRUTH, "--plot", "x.svg"), "--plot x.svg: must end in .png"),
        ((RECORDING, "--truth", TRUTH, "--plot", "no/x.png"), "there is no folder no"),
    ],
)
def test_a_mistake_is_one_line(calibrate, arguments, says):
    """What, where and what to do; exit code 2, before any work."""
    code, out, err = calibrate(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("drone-client: ")
    assert says in err
    assert err.count("\n") == 1


def true_boxes():
    """Boxes of the fully visible frames by the names of their pictures."""
    source, target = open_recording(RECORDING), load_target()
    entries = load_truth(TRUTH, len(source))
    names = [
        Path(line.split()[1]).name
        for line in (RECORDING / "rgb.txt").read_text().splitlines()
        if not line.startswith("#")
    ]
    return {
        name: projected_boxes(target, entry.camera_from_target, source.camera.color)
        for name, entry in zip(names, entries, strict=True)
        if entry.visible > 0.999
    }


def test_boxes_may_come_from_an_earlier_run(calibrate, tmp_path):
    """A ledger's lines by the pictures' names; a foreign or broken line does no harm."""
    lines = ["[1]", '{"name": "else"}', "{cut"]
    for name, boxes in true_boxes().items():
        sides = {lv: [b.x0, b.y0, b.x1, b.y1, 0.9] for lv, b in boxes.items()}
        lines.append(json.dumps({"name": name, "boxes": sides}))
    (tmp_path / "ledger.jsonl").write_text("\n".join(lines) + "\n")
    code, out, _ = calibrate(RECORDING, "--run", tmp_path, "--json")
    body = json.loads(out)
    assert (code, body["finding"]) == (0, "good")
    assert body["misses"]["not found in that run"] > 0
    (tmp_path / "ledger.jsonl").write_text('{"name": "else"}\n')
    code, _, err = calibrate(RECORDING, "--run", tmp_path)
    assert code == 2
    assert "no frame in ledger.jsonl has boxes" in err


class Worker(http.server.ThreadingHTTPServer):
    """Answers the frames of the recording one after the other, as an edge service would."""

    def __init__(self, target, frames):
        super().__init__(("127.0.0.1", 0), Handler)
        self.target, self.frames, self.asked = target, iter(frames), []


class Handler(http.server.BaseHTTPRequestHandler):
    server: Worker

    def do_GET(self):
        self.answer({"target": self.server.target})

    def do_POST(self):
        self.server.asked.append(self.rfile.read(int(self.headers["Content-Length"])))
        self.answer(next(self.server.frames))

    def answer(self, body):
        data = json.dumps(body).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_):
        """Silent."""


@pytest.fixture
def worker():
    running = []

    def start(discs_m, frames):
        target = {"name": "theirs", "discs": [{"diameter_m": d} for d in discs_m]}
        server = Worker(target, frames)
        threading.Thread(target=server.serve_forever).start()
        running.append(server)
        return server, f"http://127.0.0.1:{server.server_port}"

    yield start
    for server in running:
        server.shutdown()
        server.server_close()


def answers():
    """What a worker says of each frame of the recording."""
    boxes, source = true_boxes(), open_recording(RECORDING)
    for capture in source.captures():
        if capture.name not in boxes:
            yield {"outcome": "nothing_found", "target": None}
            continue
        listed = [
            {"level": lv, "x0": b.x0, "y0": b.y0, "x1": b.x1, "y1": b.y1, "score": 0.9}
            for lv, b in boxes[capture.name].items()
        ]
        yield {"outcome": "target", "target": {"boxes": listed, "score": 0.9}}


def test_a_worker_tells_where_the_target_is(calibrate, worker, camera_file):
    """It is shown colour alone, exactly as recorded, and no depth with a wrong unit."""
    server, url = worker([0.3, 0.14, 0.06], answers())
    file = camera_file(shifted(2, 0.02))
    code, out, _ = calibrate(RECORDING, "--worker", url, "--camera", file, "--json")
    body = json.loads(out)
    assert code == 1
    assert "shift forward" in {v["name"] for v in body["verdicts"] if v["finding"] == "off"}
    assert body["misses"]["worker: nothing_found"] > 0
    first = server.asked[0]
    assert b'name="depth"' not in first
    png = first[first.index(b"\x89PNG") :]
    sent = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB)
    np.testing.assert_array_equal(sent, next(open_recording(RECORDING).captures()).color_rgb)


def test_a_worker_of_another_target_is_refused(calibrate, worker):
    """Before the first frame, with both names."""
    server, url = worker([0.15, 0.07, 0.03], ())
    code, _, err = calibrate(RECORDING, "--worker", url)
    assert code == 2
    assert "looks for theirs and not for bullseye-400" in err
    assert not server.asked


@pytest.mark.recording
@pytest.mark.skipif(not KITCHEN.is_dir(), reason="the real recording is not here")
@pytest.mark.parametrize(
    ("scale", "code", "off"), [(1.0, 0, None), (1.02, 1, "agreement"), (5.0, 1, "depth unit")]
)
def test_the_real_recording(calibrate, tmp_path, scale, code, off):
    """Good as it is; from its one range a factor is seen, and that it may be a shift is said."""
    camera = KITCHEN_CAMERA | {"depth_scale_m": 0.0002 * scale}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    truth = KITCHEN / "targets.json"
    arguments = ["--camera", tmp_path / "camera.json", "--truth", truth, "--frames", 25, "--json"]
    got, out, _ = calibrate(KITCHEN, *arguments)
    body = json.loads(out)
    assert got == code
    wrong = [v for v in body["verdicts"] if v["finding"] == "off"]
    assert [v["name"] for v in wrong] == ([] if off is None else [off])
    if off == "agreement":
        assert "either a shift of 4" in wrong[0]["do"]
