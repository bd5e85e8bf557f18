"""Video files, decoded again."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
import time
from collections import namedtuple
from pathlib import Path

import cv2
import numpy as np
import pytest

from contact_sim.errors import FilmError
from contact_sim.recording import encoder
from contact_sim.recording.encoder import PICTURE, VideoFile

WIDTH, HEIGHT, FRAMES = 160, 96, 12


def picture(i: int) -> np.ndarray:
    """A bright square that moves over dark red, (HEIGHT, WIDTH, 3) RGB."""
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    image[..., 0] = 90
    image[30:60, 8 * i : 8 * i + 30] = (240, 240, 60)
    return image


def read(path: Path) -> tuple[list[np.ndarray], cv2.VideoCapture]:
    video, found = cv2.VideoCapture(str(path)), []
    while (answer := video.read())[0]:
        found.append(cv2.cvtColor(answer[1], cv2.COLOR_BGR2RGB))
    return found, video


@pytest.mark.parametrize(("suffix", "codec"), [(".mp4", b"vp09"), (".webm", b"V_VP8")])
def test_a_film_is_decoded_again(tmp_path: Path, suffix: str, codec: bytes):
    """Every picture, in order, in its colours; nothing else is left in the folder."""
    path = tmp_path / f"a{suffix}"
    with VideoFile(path, WIDTH, HEIGHT, 25.0) as video:
        for i in range(FRAMES):
            video.add(picture(i))
    assert list(tmp_path.iterdir()) == [path]
    found, capture = read(path)
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(25.0)
    assert codec in path.read_bytes()
    assert len(found) == FRAMES
    for i, image in enumerate(found):
        assert np.abs(image.astype(int) - picture(i)).mean() < 12


def test_a_suffix_that_is_none_is_told(tmp_path: Path):
    """With those that are."""
    with pytest.raises(FilmError, match=r"a film is called \.mp4 or \.webm"):
        VideoFile(tmp_path / "a.avi", WIDTH, HEIGHT, 25.0)


def test_a_folder_that_is_not_there_is_told(tmp_path: Path):
    """Before anything is drawn."""
    with pytest.raises(FilmError, match="cannot be written: no such folder"):
        VideoFile(tmp_path / "nowhere" / "a.webm", WIDTH, HEIGHT, 25.0)


def test_a_film_that_is_broken_off_leaves_nothing(tmp_path: Path):
    """An earlier file of that name stays as it was."""
    path = tmp_path / "a.webm"
    path.write_bytes(b"earlier")

    def half() -> None:
        with VideoFile(path, WIDTH, HEIGHT, 25.0) as video:
            video.add(picture(0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        half()
    assert [p.name for p in tmp_path.iterdir()] == ["a.webm"]
    assert path.read_bytes() == b"earlier"


def test_a_film_is_given_up_at_once(tmp_path: Path):
    """VP9 holds 25 pictures back, which would take it ten seconds; nobody waits for them."""
    noise = np.random.default_rng(0).integers(0, 255, (720, 1280, 3), dtype=np.uint8)
    begun: list[subprocess.Popen[bytes]] = []

    def half() -> None:
        with VideoFile(tmp_path / "a.mp4", 1280, 720, 25.0) as video:
            for i in range(8):
                video.add(np.roll(noise, i, axis=1))
            begun.append(video._process)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        half()
    assert begun[0].returncode == -signal.SIGKILL
    assert list(tmp_path.iterdir()) == []


def test_an_encoder_that_dies_is_told_and_nobody_waits_for_it(tmp_path: Path):
    """Whatever it died of."""
    path = tmp_path / "a.webm"

    def filming() -> None:
        with VideoFile(path, WIDTH, HEIGHT, 25.0) as video:
            video.add(picture(0))
            video._process.kill()
            while True:
                video.add(picture(1))

    with pytest.raises(FilmError, match=r"a\.webm could not be encoded: the encoder has ended"):
        filming()
    assert list(tmp_path.iterdir()) == []


def test_an_encoder_that_dies_at_the_end_is_told(tmp_path: Path):
    """A film that is not whole has no name."""

    def filming() -> None:
        with VideoFile(tmp_path / "a.webm", WIDTH, HEIGHT, 25.0) as video:
            video.add(picture(0))
            video._process.kill()

    with pytest.raises(FilmError, match="the encoder has ended"):
        filming()
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_ends_it_early(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Not after minutes of encoding."""
    full = namedtuple("Usage", "free")(10_000)
    monkeypatch.setattr(encoder.shutil, "disk_usage", lambda folder: full)
    frame = PICTURE + picture(0).tobytes()
    words = io.BytesIO()
    path = tmp_path / ".a.part.webm"
    assert encoder.encode(path, WIDTH, HEIGHT, 25.0, io.BytesIO(50 * frame), words) == 1
    assert words.getvalue() == b"rthe disk is full"
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from contact_sim.recording.encoder import VideoFile
video = VideoFile(Path(sys.argv[1]), 160, 96, 25.0)
video.add(np.zeros((96, 160, 3), dtype=np.uint8))
print(video._process.pid, flush=True)
os._exit(9)
"""


def test_who_is_killed_leaves_no_encoder_and_no_half_film(tmp_path: Path):
    """It ends with whoever sends the pictures."""
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path / "a.webm")],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 9, done.stderr
    give_up = time.monotonic() + 20.0
    while list(tmp_path.iterdir()):
        assert time.monotonic() < give_up
        time.sleep(0.05)


FULL = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from contact_sim.errors import FilmError
from contact_sim.recording.encoder import VideoFile
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
noise = np.random.default_rng(0)
try:
    with VideoFile(Path(sys.argv[1]), 320, 240, 25.0) as video:
        for _ in range(20):
            video.add(noise.integers(0, 255, (240, 320, 3), dtype=np.uint8))
except FilmError as error:
    print(error)
    sys.exit(7)
"""


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_a_disk_that_is_full_is_told(tmp_path: Path, suffix: str):
    """OpenCV says nothing of it; no half film is left."""
    path = tmp_path / f"a{suffix}"
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 7, done.stderr
    assert "came out broken: is the disk full?" in done.stdout
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []
