"""What is written down while a drone flies, and what happens where it cannot be."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sized
from pathlib import Path

import cv2
import numpy as np
import pytest

from drone_client.autopilot import VehicleState
from drone_client.line_writer import LineWriter
from drone_client.run_files import list_pictures
from drone_client.source import Capture
from drone_client.viewing.facts import load_facts
from drone_client.viewing.pictures import PictureWriter
from drone_client.viewing.recorder import FlightRecorder
from tests.unit.drone_client.view_builders import RIG, START_NS, body_at, facts


class Still:
    """A camera that has taken its pictures already."""

    def __init__(self, pictures: list[np.ndarray]) -> None:
        self.camera = RIG
        self.is_open = False
        self._pictures = pictures

    def start(self) -> None:
        self.is_open = True

    def captures(self, timeout_s: float) -> Iterator[Capture | None]:
        yield None
        for i, picture in enumerate(self._pictures):
            yield Capture(START_NS + i, picture, None, str(i))

    def counts(self) -> dict[str, int]:
        return {"given": len(self._pictures)}

    def stop(self) -> None:
        self.is_open = False


class Hovering:
    """A vehicle whose pose is a new one whenever it is asked; tells when it was, often enough."""

    def __init__(self, enough: int) -> None:
        self.asked = 0
        self.enough = threading.Event()
        self._enough = enough

    def state(self) -> VehicleState:
        self.asked += 1
        if self.asked >= self._enough:
            self.enough.set()
        t_ns = START_NS + (self.asked // 2) * 1_000_000  # each pose twice
        return VehicleState(
            START_NS, "OFFBOARD", True, True, t_ns, body_at(t_ns), np.array([0.5, 0.0, 0.0])
        )


def gradient(i: int) -> np.ndarray:
    """A picture that JPEG keeps: (120, 160, 3) RGB, red from left to right, blue by number."""
    picture = np.zeros((120, 160, 3), dtype=np.uint8)
    picture[..., 0] = np.arange(160, dtype=np.uint8)
    picture[..., 2] = 40 * i
    return picture


def record(folder: Path, camera: Still, *, pictures: bool = True) -> FlightRecorder:
    """A whole flight through a recorder."""
    vehicle = Hovering(6)
    recorder = FlightRecorder(camera, vehicle.state, folder, lambda rig: facts(), pictures=pictures)
    recorder.start()
    assert camera.is_open
    for given in recorder.captures(0.1):
        assert given is None or given.color_rgb.shape == (120, 160, 3)
    if (folder / "poses.jsonl").is_file():
        assert vehicle.enough.wait(10.0)
    recorder.stop()
    assert not camera.is_open
    recorder.close()
    return recorder


def test_pictures_poses_and_facts_are_written(tmp_path: Path):
    """A picture is named by its time and comes back as it was; a pose is written once."""
    pictures = [gradient(i) for i in range(3)]
    recorder = record(tmp_path, Still(pictures))
    assert recorder.report() == {"pictures": 3, "unwritten": []}
    found = list_pictures(tmp_path)
    assert [t_ns for _, t_ns in found] == [START_NS + i for i in range(3)]
    for (path, _), picture in zip(found, pictures, strict=True):
        read = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
        assert np.abs(read.astype(int) - picture).mean() < 3.0
    lines = [json.loads(line) for line in (tmp_path / "poses.jsonl").read_text().splitlines()]
    stamps = [line["t_ns"] for line in lines]
    assert len(stamps) == len(set(stamps)) >= 3
    np.testing.assert_allclose(
        lines[-1]["world_from_body"][:3], body_at(stamps[-1]).translation, atol=1e-6
    )
    read_facts = load_facts(tmp_path / "flight.json")
    assert read_facts is not None
    assert read_facts.drone == facts().drone


def test_pictures_are_written_only_where_they_are_wanted(tmp_path: Path):
    """A megabyte a second is not for every flight."""
    record(tmp_path, Still([gradient(0)]), pictures=False)
    assert not (tmp_path / "pictures").exists()


def test_pictures_of_an_earlier_run_go(tmp_path: Path):
    """Those that a recorder wrote, and nothing else in the folder."""
    record(tmp_path, Still([gradient(i) for i in range(3)]))
    (tmp_path / "pictures" / "mine.jpg").write_bytes(b"x")
    record(tmp_path, Still([gradient(0)]))
    assert len(list_pictures(tmp_path)) == 1
    assert (tmp_path / "pictures" / "mine.jpg").exists()


def test_a_disk_that_takes_nothing_ends_no_flight(tmp_path: Path):
    """The camera is let through, and the report says what is missing."""
    (tmp_path / "pictures").write_bytes(b"a file where a folder should be")
    recorder = record(tmp_path, Still([gradient(0)]))
    (problem,) = recorder.report()["unwritten"]
    assert "pictures: File exists" in problem


def test_what_one_file_cannot_have_another_may(tmp_path: Path):
    """Where the facts cannot be written, poses and pictures are."""
    (tmp_path / "flight.json").mkdir()
    recorder = record(tmp_path, Still([gradient(0)]))
    report = recorder.report()
    assert report["pictures"] == 1
    (problem,) = report["unwritten"]
    assert problem.startswith(f"{tmp_path / 'flight.json'}: ")
    assert (tmp_path / "poses.jsonl").stat().st_size > 0


def test_poses_that_the_disk_does_not_take_leave_no_empty_file(tmp_path: Path, monkeypatch):
    """It would look like a record of a drone that never moved."""

    def full(self: LineWriter, batch: Sized) -> None:
        self.lost += len(batch)

    monkeypatch.setattr(LineWriter, "_write", full)
    recorder = record(tmp_path, Still([]))
    (problem,) = recorder.report()["unwritten"]
    assert problem.endswith("lines of poses.jsonl")
    assert not (tmp_path / "poses.jsonl").exists()


def test_pictures_leave_room_on_the_disk(tmp_path: Path):
    """Ledger and summary count more."""
    writer = PictureWriter(tmp_path, kept_bytes=1 << 60)
    writer.put(1, gradient(0))
    writer.close()
    assert (writer.written, writer.left_out) == (0, 1)
    assert writer.problem == "the disk has no more room than ledger and summary need"


def test_pictures_end_where_their_bytes_do(tmp_path: Path):
    """And what was left out is counted, with the reason."""
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    writer = PictureWriter(tmp_path, max_bytes=5_000)
    writer.put(1, gradient(0))
    writer.put(2, noise)
    writer.close()
    assert [t_ns for _, t_ns in list_pictures(tmp_path)] == [1]
    assert (writer.written, writer.left_out) == (1, 1)
    assert writer.problem is not None
    assert "as many bytes" in writer.problem


def test_a_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """By its own words; the pictures after it are tried all the same."""

    def full(self: Path, data: bytes) -> int:
        self.touch()
        raise OSError(28, "No space left on device")

    writer = PictureWriter(tmp_path)
    monkeypatch.setattr(Path, "write_bytes", full)
    writer.put(1, gradient(0))
    writer.put(2, gradient(1))
    writer.close()
    assert (writer.written, writer.left_out) == (0, 2)
    assert writer.problem == "No space left on device"
    assert list((tmp_path / "pictures").iterdir()) == []


def test_a_picture_after_the_end_is_left_out(tmp_path: Path):
    """Nothing waits for a writer that is gone."""
    writer = PictureWriter(tmp_path)
    writer.close()
    writer.put(1, gradient(0))
    assert writer.left_out == 1
