"""Recordings on disk: read as they are; one line with file and line where they are not."""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drone_client.errors import SourceError
from drone_client.source import replay
from drone_client.source.replay import ReplaySource, open_recording
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.errors import CameraFileError
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import CAMERA, HEIGHT, INTRINSICS, WIDTH, frame, rotation_of

T0 = 1_700_000_000


def color_of(number: int) -> np.ndarray:
    """A picture that tells its number and its channels apart."""
    return np.full((HEIGHT, WIDTH, 3), (200, 100, number), np.uint8)


def write(folder: Path, colors: list[str], depths: list[str], truth: str | None = None) -> Path:
    """A recording whose pictures have the given times; picture i holds the number i."""
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    for number, t in enumerate(colors):
        cv2.imwrite(str(folder / f"rgb/{t}.png"), color_of(number)[..., ::-1])
    for number, t in enumerate(depths):
        depth = np.full((HEIGHT, WIDTH), 1000 + number, np.uint16)
        cv2.imwrite(str(folder / f"depth/{t}.png"), depth)
    for name, times in (("rgb", colors), ("depth", depths)):
        lines = ["# timestamp filename", "", *(f"{t} {name}/{t}.png" for t in times)]
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    if truth is not None:
        (folder / "groundtruth.txt").write_text(truth)
    (folder / "camera.json").write_text(json.dumps(CAMERA.to_json()))
    return folder


@pytest.fixture
def recording(tmp_path) -> Path:
    """Two frames with depth and a trajectory."""
    return write(
        tmp_path / "rec",
        [f"{T0}.0", f"{T0}.1"],
        [f"{T0}.0", f"{T0}.1"],
        f"# time tx ty tz qx qy qz qw\n{T0} 0 0 0 0 0 0 1\n{T0}.1 1 2 3 0 0 1 0\n",
    )


def refusal(folder: Path, camera: RgbdCamera = CAMERA) -> str:
    """The line with which a recording is refused, at the start or while it plays."""
    with pytest.raises(SourceError) as caught:
        list(ReplaySource(folder, camera).captures())
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_reads_pictures_as_they_are(recording):
    """Red is the first channel, depth keeps its 16 bits, times their nanoseconds."""
    source = open_recording(recording)
    assert len(source) == 2
    first, second = source.captures()
    np.testing.assert_array_equal(first.color_rgb, color_of(0))
    np.testing.assert_array_equal(second.color_rgb, color_of(1))
    assert (second.depth_units == 1001).all()
    assert second.depth_units.dtype == np.uint16
    assert (first.t_source_ns, second.t_source_ns) == (T0 * 10**9, T0 * 10**9 + 10**8)
    assert second.name == f"{T0}.1.png"


def test_reads_the_trajectory_in_the_order_of_the_format(recording):
    """Quaternions come as x y z w; between two poses it interpolates, outside it knows nothing."""
    source = open_recording(recording)
    at_end = source.world_from_camera(T0 * 10**9 + 10**8)
    np.testing.assert_allclose(at_end.translation, (1, 2, 3))
    assert (rotation_of(at_end) * Rotation.from_quat((0, 0, 1, 0)).inv()).magnitude() < 1e-9
    np.testing.assert_allclose(
        source.world_from_camera(T0 * 10**9 + 5 * 10**7).translation, (0.5, 1, 1.5)
    )
    assert source.world_from_camera((T0 + 1) * 10**9) is None


def test_without_a_trajectory_the_pose_is_unknown(recording):
    """groundtruth.txt may be missing."""
    (recording / "groundtruth.txt").unlink()
    assert open_recording(recording).world_from_camera(T0 * 10**9) is None


def test_without_depth_there_are_only_colours(recording):
    """depth.txt may be missing."""
    (recording / "depth.txt").unlink()
    assert [c.depth_units for c in open_recording(recording).captures()] == [None, None]


def test_depth_belongs_to_the_colour_that_is_nearest_in_time(tmp_path):
    """Not to the one of the same number; past 20 ms it belongs to none."""
    folder = write(
        tmp_path / "rec",
        [f"{T0}.100", f"{T0}.200", f"{T0}.300", f"{T0}.400"],
        # one too early for any, one nearest to the first, one nearest to the third, 21 ms off
        [f"{T0}.000", f"{T0}.110", f"{T0}.290", f"{T0}.421"],
    )
    depths = [c.depth_units for c in open_recording(folder).captures()]
    assert [None if d is None else int(d[0, 0]) - 1000 for d in depths] == [1, None, 2, None]


def test_a_depth_picture_belongs_to_one_colour(tmp_path):
    """Twice as many colours, as TUM's own associate.py has it: the nearest takes it."""
    folder = write(
        tmp_path / "rec",
        [f"{T0}.100", f"{T0}.116", f"{T0}.133", f"{T0}.150"],
        [f"{T0}.104", f"{T0}.137"],
    )
    depths = [c.depth_units for c in open_recording(folder).captures()]
    assert [None if d is None else int(d[0, 0]) - 1000 for d in depths] == [0, None, 1, None]


def test_a_recording_of_tums_own_making(tmp_path):
    """Three lines of comment, 4 digits in the truth, 5000 units a metre, sensors out of step."""
    comment = "# color images\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n# timestamp filename\n"
    colors = ["1305031102.175304", "1305031102.211214", "1305031102.243211"]
    depths = ["1305031102.160407", "1305031102.226738", "1305031102.262886"]
    folder = write(
        tmp_path / "rec",
        colors,
        depths,
        comment
        + "1305031102.1758 1.3405 0.6266 1.6575 0.6574 0.6126 -0.2949 -0.3248\n"
        + "1305031102.2758 1.3303 0.6256 1.6464 0.6579 0.6161 -0.2932 -0.3189\n",
    )
    for name in ("rgb.txt", "depth.txt"):
        (folder / name).write_text(comment + (folder / name).read_text())
    (folder / "accelerometer.txt").write_text("# not ours\n")
    camera = RgbdCamera(INTRINSICS, INTRINSICS, 1 / 5000, Pose.identity())
    assert camera.aligned
    source = ReplaySource(folder, camera)
    got = [c.depth_units for c in source.captures()]
    # 14.9, 15.5 and 19.7 ms off: as TUM's associate.py pairs them
    assert [None if d is None else int(d[0, 0]) - 1000 for d in got] == [0, 1, 2]
    at = source.world_from_camera(1305031102225800000)
    np.testing.assert_allclose(at.translation, (1.3354, 0.6261, 1.65195), atol=1e-9)
    assert source.notes == ()


@given(st.integers(0, 9_999_999_999), st.integers(0, 999_999_999))
def test_times_keep_every_nanosecond(seconds, ns):
    """Text to integer, without a float between."""
    assert replay._time_ns("x", f"{seconds}.{ns:09d}") == seconds * 10**9 + ns


@pytest.mark.parametrize(
    ("name", "line", "says"),
    [
        ("rgb.txt", "12.5", "expected 'timestamp filename', got 1 fields"),
        ("rgb.txt", "12.5 a.png b.png", "got 3 fields"),
        ("rgb.txt", "noon a.png", "'noon' is not a time"),
        ("rgb.txt", "1e9 a.png", "'1e9' is not a time"),
        ("rgb.txt", "-3.0 a.png", "'-3.0' is not a time"),
        ("rgb.txt", "nan a.png", "'nan' is not a time"),
        ("rgb.txt", "1.2.3 a.png", "'1.2.3' is not a time"),
        ("rgb.txt", "12345678901.0 a.png", "before the year 2286"),
        ("rgb.txt", f"{T0}.0 a.png", "time does not go forward"),
        ("rgb.txt", f"{T0 + 9} ../../secret.png", "lies outside the recording"),
        ("rgb.txt", f"{T0 + 9} /etc/passwd", "lies outside the recording"),
        ("rgb.txt", f"{T0 + 9} a\0b.png", "is not a file name"),
        ("rgb.txt", f"{T0 + 9} \x1b[2Jb.png", "is not a file name"),
        ("depth.txt", "12.5", "expected 'timestamp filename', got 1 fields"),
        ("depth.txt", f"{T0 + 9} rgb/../../x.png", "lies outside the recording"),
        ("groundtruth.txt", f"{T0 + 9} 0 0 0 0 0 0", "got 7 fields"),
        ("groundtruth.txt", f"{T0 + 9} 0 0 zero 0 0 0 1", "could not convert"),
        ("groundtruth.txt", f"{T0 + 9} 0 0 nan 0 0 0 1", "finite"),
        ("groundtruth.txt", f"{T0 + 9} 0 0 inf 0 0 0 1", "finite"),
        ("groundtruth.txt", f"{T0 + 9} 0 0 0 0 0 0 0", "unit length"),
        ("groundtruth.txt", f"{T0} 0 0 0 0 0 0 1", "time does not go forward"),
    ],
)
def test_a_malformed_line_is_told_with_file_and_number(recording, name, line, says):
    """The line at the end of each list is at fault."""
    path = recording / name
    text = path.read_text()
    path.write_text(text + line + "\n")
    number = len(text.splitlines()) + 1
    got = refusal(recording)
    assert got.startswith(f"{path} line {number}: ")
    assert says in got


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "groundtruth.txt"])
def test_a_list_that_is_no_text_is_told(recording, name):
    """Binary where text should be."""
    (recording / name).write_bytes(b"\xff\xfe\x00\x01")
    assert refusal(recording) == f"{recording / name}: not a text file"


def test_a_list_that_is_a_folder_is_told(recording):
    """In the words of the operating system."""
    (recording / "rgb.txt").unlink()
    (recording / "rgb.txt").mkdir()
    assert refusal(recording) == f"{recording / 'rgb.txt'}: Is a directory"


def test_a_list_that_is_too_long_is_not_read(recording, monkeypatch):
    """Bounded in bytes and in lines."""
    monkeypatch.setattr(replay, "MAX_LINES", 3)
    assert refusal(recording) == f"{recording / 'rgb.txt'}: over 3 lines"
    monkeypatch.setattr(replay, "MAX_LIST_BYTES", 10)
    assert refusal(recording) == f"{recording / 'rgb.txt'}: over 10 bytes"


def test_a_list_without_a_picture_is_told(recording):
    """Only comments."""
    (recording / "rgb.txt").write_text("# timestamp filename\n")
    assert refusal(recording) == f"{recording / 'rgb.txt'}: lists no picture"


def test_a_missing_list_or_folder_is_told(recording):
    """What is missing is named."""
    (recording / "rgb.txt").unlink()
    assert refusal(recording) == f"{recording / 'rgb.txt'}: No such file or directory"
    assert refusal(recording / "no") == f"recording {recording / 'no'}: no such folder"


def test_a_missing_camera_file_says_what_to_do(recording):
    """The folder's own, or one that was named."""
    (recording / "camera.json").unlink()
    with pytest.raises(SourceError, match=r"holds no camera\.json; name one with --camera"):
        open_recording(recording)
    with pytest.raises(SourceError, match="no such folder"):
        open_recording(recording / "no")
    with pytest.raises(CameraFileError, match=r"other\.json: No such file"):
        open_recording(recording, recording / "other.json")


def huge_png() -> bytes:
    """A valid head that claims 60000 x 60000 pixels."""
    head = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))
    return b"\x89PNG\r\n\x1a\n" + chunk


def png(picture: np.ndarray) -> bytes:
    """A picture as PNG."""
    return cv2.imencode(".png", picture)[1].tobytes()


@pytest.mark.parametrize(
    "data",
    [b"", b"no picture", huge_png(), png(color_of(0))[:60]],
    ids=["empty", "text", "huge", "cut off"],
)
@pytest.mark.parametrize("kind", ["rgb", "depth"])
def test_a_picture_that_cannot_be_read_is_told(recording, kind, data):
    """Empty, something else, cut off, or far larger than any camera."""
    path = recording / f"{kind}/{T0}.1.png"
    path.write_bytes(data)
    assert refusal(recording) == f"{path}: no picture that can be read"


@pytest.mark.parametrize("kind", ["rgb", "depth"])
def test_a_missing_picture_is_told(recording, kind, capfd):
    """By the system's words, and OpenCV adds none of its own."""
    path = recording / f"{kind}/{T0}.1.png"
    path.unlink()
    assert refusal(recording) == f"{path}: No such file or directory"
    assert capfd.readouterr().err == ""


def test_a_picture_of_unusual_size_is_not_read_into_memory(recording, monkeypatch):
    """Bounded in bytes before it is decoded."""
    monkeypatch.setattr(replay, "MAX_PICTURE_BYTES", 50)
    assert "no picture that can be read" in refusal(recording)


def test_the_wrong_first_picture_shows_before_anything_flies(recording):
    """The constructor reads it."""
    (recording / f"rgb/{T0}.0.png").write_bytes(b"")
    with pytest.raises(SourceError, match="no picture"):
        ReplaySource(recording, CAMERA)


def test_a_camera_of_another_size_is_told_with_both_sizes(recording):
    """For colour and for depth."""
    wide = CameraIntrinsics(WIDTH + 1, HEIGHT, 20.0, 20.0, 7.5, 5.5)
    got = refusal(recording, RgbdCamera(wide, wide, 0.001, Pose.identity()))
    assert got.endswith("is 16x12, the camera file says 17x12")
    got = refusal(recording, RgbdCamera(INTRINSICS, wide, 0.001, Pose.identity()))
    assert got.endswith("is 16x12, the camera file says 17x12 for depth")


@pytest.mark.parametrize("picture", [frame().color_rgb, frame().color_rgb[..., 0]])
def test_depth_that_is_not_16_bit_grey_is_told(recording, picture):
    """A colour-mapped or an 8-bit depth picture holds no metres."""
    (recording / f"depth/{T0}.0.png").write_bytes(png(picture))
    assert refusal(recording).endswith("depth must be a 16-bit grey PNG")


def test_a_picture_that_may_not_be_opened_is_told(recording):
    """A link that leads to itself."""
    path = recording / f"rgb/{T0}.1.png"
    path.unlink()
    os.symlink(path.name, path)
    assert refusal(recording) == f"{path}: Too many levels of symbolic links"
