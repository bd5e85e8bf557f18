"""A live camera is written down as it is, whole or not at all."""

from __future__ import annotations

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from drone_client.errors import OutputError, SourceError
from drone_client.source import Capture, record_command, recording_folder
from drone_client.source.realsense import RealsenseSource
from drone_client.source.record import record
from drone_client.source.recording_folder import RecordingFolder
from drone_client.source.replay import open_recording
from rgbd_wire.clock import MonotonicClock
from tests.unit.drone_client.builders import CAMERA, HEIGHT, MS, WIDTH, eventually
from tests.unit.drone_client.realsense_rig import Rig
from tests.unit.drone_client.test_realsense import SETTINGS


def capture(number: int, depth: bool = True) -> Capture:
    """A picture with noise, so that loss would show."""
    rng = np.random.default_rng(number)
    color = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    units = rng.integers(0, 1 << 16, (HEIGHT, WIDTH), np.uint16) if depth else None
    return Capture(123_456_789_012_345 + number * 33 * MS, color, units, f"{number}")


class Script:
    """A live source that gives what it was told to, and then does as it was told."""

    def __init__(self, captures, then=None) -> None:
        self.camera = CAMERA
        self.stopped = False
        self._captures = captures
        self._then = then

    def start(self) -> None:
        pass

    def captures(self, timeout_s: float):
        yield None
        yield from self._captures
        if self._then is not None:
            raise self._then

    def counts(self) -> dict[str, int]:
        return {"paired": len(self._captures)}

    def stop(self) -> None:
        self.stopped = True


def test_what_was_recorded_is_read_back_bit_by_bit(tmp_path):
    """Pictures, depth where there was some, stamps to the nanosecond, camera."""
    shots = [capture(n, depth=n != 2) for n in range(5)]
    source = Script(shots)
    told = []
    done = record(source, tmp_path / "rec", on_progress=lambda s, n: told.append(n))
    assert (done.frames, done.with_depth, done.left_out, done.ended_by) == (5, 4, 0, "time")
    assert done.seconds == pytest.approx(0.132)
    assert told[-1] == 5
    assert source.stopped
    back = open_recording(tmp_path / "rec")
    assert back.camera.to_json() == CAMERA.to_json()
    for was, read in zip(shots, back.captures(), strict=True):
        assert read.t_source_ns == was.t_source_ns
        np.testing.assert_array_equal(read.color_rgb, was.color_rgb)
        assert (read.depth_units is None) == (was.depth_units is None)
        if was.depth_units is not None:
            np.testing.assert_array_equal(read.depth_units, was.depth_units)
    assert not (tmp_path / "rec.part").exists()


def test_a_real_camera_is_recorded(tmp_path):
    """Through the SDK; the test ends it once enough has come."""
    rig = Rig()
    source = RealsenseSource(SETTINGS, MonotonicClock(), lambda: rig.device)
    over, enough = threading.Event(), threading.Event()

    def feed() -> None:
        for number in range(10_000):
            stamp_ms = MonotonicClock().now_ns() / 1e6
            rig.color(number % 200, stamp_ms)
            rig.depth(number % 200, stamp_ms)
            if over.wait(0.005):
                return

    def on_progress(_: float, frames: int) -> None:
        if frames >= 5:
            enough.set()

    feeder = threading.Thread(target=feed)
    feeder.start()
    done = record(source, tmp_path / "rec", on_progress=on_progress, stop=enough)
    over.set()
    feeder.join()
    assert done.ended_by == "interrupt"
    assert done.with_depth >= 4  # the last may have been between its two pictures
    assert done.frames >= 5
    assert done.camera_counts["paired"] >= done.frames
    assert len(list(open_recording(tmp_path / "rec").captures())) == done.frames


def test_an_interrupt_keeps_what_was_recorded(tmp_path):
    """Ctrl-C is the usual end."""
    done = record(Script([capture(0), capture(1)], KeyboardInterrupt()), tmp_path / "rec")
    assert (done.frames, done.ended_by) == (2, "interrupt")
    assert len(open_recording(tmp_path / "rec")) == 2


def test_a_camera_that_goes_away_leaves_what_came_before(tmp_path):
    """And what it said."""
    done = record(Script([capture(0)], SourceError("unplugged")), tmp_path / "rec")
    assert (done.frames, done.ended_by) == (1, "unplugged")


@pytest.mark.parametrize("then", [None, SourceError("unplugged"), KeyboardInterrupt()])
def test_nothing_recorded_leaves_nothing_behind(tmp_path, then):
    """No folder that looks like a recording."""
    source = Script([], then)
    with pytest.raises(SourceError, match="not one picture|unplugged"):
        record(source, tmp_path / "rec")
    assert source.stopped
    assert list(tmp_path.iterdir()) == []


def test_the_time_ends_it(tmp_path):
    """None of an endless camera is waited for."""

    class Endless(Script):
        def captures(self, timeout_s: float):
            number = 0
            while True:
                yield capture(number)
                number += 1

    done = record(Endless([]), tmp_path / "rec", seconds=0.05)
    assert done.ended_by == "time"
    assert done.frames > 0


def test_a_capture_without_room_is_left_out(tmp_path, monkeypatch):
    """Adding never waits; neither does it for a stamp that goes back."""
    gate = threading.Event()
    whole = RecordingFolder._write
    monkeypatch.setattr(
        RecordingFolder, "_write", lambda self, s, c: gate.wait() and whole(self, s, c)
    )
    folder = RecordingFolder(tmp_path / "rec")
    for number in range(recording_folder.MAX_WAITING + 3):
        folder.add(capture(number))
    folder.add(capture(0))
    assert folder.left_out == 4
    gate.set()
    assert folder.finish(CAMERA.to_json()) == recording_folder.MAX_WAITING


def test_a_folder_that_is_there_is_not_touched(tmp_path):
    """Neither a recording nor the remains of one."""
    (tmp_path / "rec").mkdir()
    with pytest.raises(OutputError, match="rec exists; a recording gets a folder of its own"):
        record(Script([capture(0)]), tmp_path / "rec")
    (tmp_path / "old.part" / "rgb").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"old\.part is left of a recording that was cut off"):
        record(Script([capture(0)]), tmp_path / "old")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="Not a directory"):
        record(Script([capture(0)]), tmp_path / "file" / "rec")


def test_a_full_disk_ends_it_and_is_told(tmp_path):
    """What was written before stays."""
    shots = [capture(n) for n in range(3)]

    class Filling(Script):
        def captures(self, timeout_s: float):
            yield shots[0]
            assert eventually(lambda: len(list(tmp_path.glob("rec.part/depth/*"))) == 1)
            for path in tmp_path.glob("rec.part/depth"):  # stands for a disk that is full
                path.rename(tmp_path / "elsewhere")
            yield shots[1]
            while True:
                yield None

    done = record(Filling(shots), tmp_path / "rec")
    assert done.frames == 1
    assert "No such file" in done.ended_by


def command(*arguments: str):
    """What the command does, and says."""
    app = typer.Typer()
    app.command()(record_command.record)
    return CliRunner().invoke(app, list(arguments))


def test_the_command_records_a_camera(tmp_path, monkeypatch):
    """With its outcome as JSON or in words."""
    asked = []

    def opened(text, clock, settings, camera):
        asked.append((text, settings))
        return Script([capture(n) for n in range(3)])

    monkeypatch.setattr(record_command, "open_live", opened)
    result = command(str(tmp_path / "a"), "--size", "1280x720", "--preset", "Hand", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["frames"] == 3
    text, settings = asked[0]
    assert text == "realsense"
    assert settings.color_size_px == (1280, 720)
    assert settings == replace(type(settings)(), color_size_px=(1280, 720), preset="Hand")
    result = command(str(tmp_path / "b"))
    assert "3 frames in 0.1 s, 3 with depth, 0 left out" in result.stdout
    assert "camera: paired 3" in result.stdout


def test_the_command_says_what_is_wrong(tmp_path, monkeypatch):
    """A size that is none; a camera that went away."""
    result = command(str(tmp_path / "a"), "--size", "big")
    assert isinstance(result.exception, SourceError)
    assert str(result.exception) == "--size 'big' is no size; such as 640x480"
    source = Script([capture(0)], SourceError("unplugged"))
    monkeypatch.setattr(record_command, "open_live", lambda *_: source)
    result = command(str(tmp_path / "a"))
    assert str(result.exception).startswith("unplugged; what came before is in ")
