"""What a user names as a source, and what is said where it is none."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import pytest

from drone_client.errors import SourceError
from drone_client.source.bag import BagSource
from drone_client.source.choose import is_live, open_live, open_recorded, open_source
from drone_client.source.realsense import RealsenseSource
from drone_client.source.realsense_setup import RealsenseSettings
from drone_client.source.replay import ReplaySource
from rgbd_wire.clock import ManualClock
from rgbd_wire.errors import CameraFileError
from tests.unit.drone_client.bag_builders import Messages, camera_messages, pictures, write_ros2
from tests.unit.drone_client.builders import CAMERA, frame
from tests.unit.drone_client.realsense_rig import sdk, sdk_recording

M = Messages()


def tum(folder: Path) -> Path:
    """A recording of one picture."""
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), frame().color_rgb)
    (folder / "rgb.txt").write_text("1.0 a.png\n")
    (folder / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    return folder


def test_folders_bags_and_cameras(tmp_path):
    """By what they are, and not by what they are called."""
    folder = tum(tmp_path / "looks_like_a.bag")
    assert isinstance(open_source(str(folder), ManualClock()), ReplaySource)
    bag = write_ros2(tmp_path / "bag.bag", camera_messages(M) + pictures(M), M)
    assert isinstance(open_source(str(bag), ManualClock()), BagSource)
    sdk()
    assert isinstance(open_source("realsense:12", ManualClock()), RealsenseSource)


def test_a_camera_file_can_be_named(tmp_path):
    """For a folder that has none."""
    folder = tum(tmp_path / "rec")
    (folder / "camera.json").rename(tmp_path / "other.json")
    source = open_recorded(str(folder), tmp_path / "other.json")
    assert source.camera.to_json() == CAMERA.to_json()
    with pytest.raises(SourceError, match=r"holds no camera\.json; name one with --camera"):
        open_recorded(str(folder))


def test_what_is_no_source_is_told_with_what_is_one(tmp_path):
    """Missing, empty, of another kind."""
    known = r"a source is a folder in TUM RGB-D layout \(rgb\.txt\), a ROS 2 bag"
    with pytest.raises(SourceError, match=f"no such file or folder; {known}"):
        open_recorded(str(tmp_path / "no"))
    with pytest.raises(SourceError, match=f"nothing in it that is known; {known}"):
        open_recorded(str(tmp_path))
    (tmp_path / "film.mp4").write_bytes(b"ftyp")
    with pytest.raises(SourceError, match="nothing in it that is known"):
        open_recorded(str(tmp_path / "film.mp4"))


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.bag"])
@pytest.mark.parametrize("data", [b"", b"nonsense" * 100])
def test_a_file_that_only_looks_like_a_bag_is_told(tmp_path, name, data):
    """Empty, or something else."""
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SourceError, match=f"{name}: holds no message") as caught:
        open_recorded(str(tmp_path / name))
    assert "\n" not in str(caught.value)


def test_a_folder_of_a_broken_bag_is_told(tmp_path):
    """Metadata alone."""
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 99}\n")
    with pytest.raises(SourceError, match="no bag that can be read"):
        open_recorded(str(tmp_path))


def test_a_camera_is_no_recording():
    """And the other way round."""
    assert is_live("realsense")
    assert is_live("realsense:1")
    assert not is_live("./realsense")
    with pytest.raises(SourceError, match="is a camera, no recording"):
        open_recorded("realsense")
    with pytest.raises(SourceError, match="zed: no camera that is known; try realsense"):
        open_live("zed", ManualClock())


def test_the_serial_of_the_text_goes_before_the_settings():
    """So that one settings file serves two cameras."""
    sdk()
    source = open_live("realsense:77", ManualClock(), RealsenseSettings(serial="5"))
    assert source._settings.serial == "77"
    source = open_live("realsense", ManualClock(), RealsenseSettings(serial="5"))
    assert source._settings.serial == "5"


def test_a_missing_extra_is_one_line(tmp_path, monkeypatch):
    """A bag, and nothing to read it with."""
    bag = write_ros2(tmp_path / "bag", camera_messages(M) + pictures(M), M)
    monkeypatch.delitem(sys.modules, "drone_client.source.rosbag", raising=False)
    monkeypatch.setitem(sys.modules, "apsw", None)
    with pytest.raises(SourceError, match=r"package apsw is missing: install .*\[bags\]"):
        open_recorded(str(bag))


def test_a_recording_of_the_sdk_is_played_by_the_sdk(tmp_path):
    """As a bag it has no stamps of the camera; the line says what to do."""
    path = sdk_recording(tmp_path / "sdk.db3", 3)
    with pytest.raises(SourceError, match="of the RealSense SDK.*record OUT --source realsense:"):
        open_recorded(str(path))
    source = open_source(f"realsense:{path}", ManualClock())
    assert isinstance(source, RealsenseSource)


def test_a_camera_file_can_be_named_for_a_camera(tmp_path):
    """Read before anything is started."""
    sdk()
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    source = open_live("realsense", ManualClock(), camera=tmp_path / "camera.json")
    assert source._settings.camera.to_json() == CAMERA.to_json()
    with pytest.raises(CameraFileError, match="No such file"):
        open_live("realsense", ManualClock(), camera=tmp_path / "none.json")
