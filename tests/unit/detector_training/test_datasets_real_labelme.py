"""The real labelme opens what we write, shows it where we mean it, and saves it without loss.

labelme is no dependency of ours: without it these are skipped.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

from detector_training.datasets.convert import write_labelme
from detector_training.datasets.load import load_dataset
from detector_training.datasets.sample import LabelBox, make_sample
from target_pose.target import Level

pytestmark = pytest.mark.skipif(find_spec("labelme") is None, reason="labelme is not installed")

# In a process of its own: labelme starts Qt, which stays, and warns of its own affairs.
SAVE = """
import sys
from PyQt5 import QtWidgets
from labelme.app import MainWindow

app = QtWidgets.QApplication(sys.argv)
window = MainWindow(config_overrides={"auto_save": False, "with_image_data": False})
for path in sys.argv[1:]:
    window._load_file(path)
    window._save_label_file()
    print("saved", window._label_file_path == path)
"""
OPEN = """
import sys
from labelme._label_file import LabelFile

for path in sys.argv[1:]:
    file = LabelFile(path)
    print(file.image_path, sorted(k for k, v in file.flags.items() if v), len(file.shapes))
"""


@pytest.fixture
def written(tmp_path):
    """Two pictures, one turned by its EXIF note, with boxes over the border and inside."""
    plain = tmp_path / "plain.png"
    cv2.imwrite(str(plain), np.full((48, 64, 3), 90, np.uint8))
    turned = tmp_path / "turned.jpg"
    note = pytest.importorskip("PIL.Image")
    exif = note.Exif()
    exif[0x112] = 6
    note.new("RGB", (64, 48), (90, 90, 90)).save(turned, exif=exif)
    boxes = (
        LabelBox(Level.GOOD, (-7.25, 4.5, 80.125, 44.5), 0.625),
        LabelBox(Level.BEST, (10.0, 12.5, 30.25, 33.5), 1.0),
    )
    samples = [
        make_sample(plain, (64, 48), boxes, ("blur", "rain"), distance_m=2.5, recipe="blur"),
        make_sample(turned, (48, 64), boxes[1:], ("far",)),
    ]
    write_labelme(samples, tmp_path / "out")
    return samples, tmp_path / "out"


def labelme(script, *paths):
    env = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "HOME": str(paths[0].parent.parent)}
    command = [sys.executable, "-c", script, *map(str, paths)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_labelme_reads_our_labels(written):
    """Its own reader, which checks the size of the picture as well."""
    _, out = written
    told = labelme(OPEN, out / "plain.json", out / "turned.json").splitlines()
    assert told == ["plain.png ['blur', 'rain'] 2", "turned.jpg ['far'] 1"]


def test_labelme_saves_our_labels_without_loss(written):
    """Opened in its window and saved: boxes, flags and our own keys come back."""
    samples, out = written
    paths = out / "plain.json", out / "turned.json"
    before = [p.read_text() for p in paths]
    assert labelme(SAVE, *paths).count("saved True") == 2
    assert [p.read_text() for p in paths] != before  # it is labelme's own text now
    for mine, back in zip(samples, load_dataset(out), strict=True):
        assert np.allclose(back.boxes, mine.boxes, atol=1e-3)
        assert back.classes.tolist() == mine.classes.tolist()
        assert back.visible.tolist() == mine.visible.tolist()
        assert back.conditions == mine.conditions
        assert (back.distance_m, back.recipe) == (mine.distance_m, mine.recipe)
