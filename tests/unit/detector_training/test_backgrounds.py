"""Background pictures: where they come from, what is refused, and the two splits."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from detector_training.backgrounds import (
    DEBIAN_SOURCES,
    Background,
    Kind,
    Split,
    advice,
    find_backgrounds,
    load_rgb,
    of_split,
)
from detector_training.errors import BackgroundsError


def write_photo(path, size=(400, 300), seed=0):
    """A picture with as many colours as a photograph."""
    path.parent.mkdir(parents=True, exist_ok=True)
    coarse = np.random.default_rng(seed).integers(0, 255, (9, 12, 3), dtype=np.uint8)
    cv2.imwrite(str(path), cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC))


def test_no_file_is_in_two_splits(tmp_path):
    """Every picture is in exactly one split, each split gets some, wheels alone suffice."""
    for i in range(120):
        write_photo(tmp_path / "mine" / f"{'abcdefghij'[i % 10]}{'klmnopqrstuv'[i // 10]}_view.png")
    found = find_backgrounds([tmp_path / "mine"], tmp_path)
    parts = {split: of_split(found, split) for split in Split}
    assert sorted(b.path for part in parts.values() for b in part) == [b.path for b in found]
    assert all(parts.values())
    assert len(parts[Split.TRAIN]) > len(parts[Split.VAL]) + len(parts[Split.TEST])
    assert any(b.source == "scikit-image" for b in found)


def test_one_picture_in_several_files_stays_in_one_split():
    """Sizes of a wallpaper and both views of a stereo pair share a key, other files do not."""

    def key(path):
        return Background(Path(path), Kind.PHOTO, "x").key

    kay = "/usr/share/wallpapers/Kay/contents/images"
    assert key(f"{kay}/1080x1920.png") == key(f"{kay}/5120x2880.png")
    assert key("/a/motorcycle_left.png") == key("/a/motorcycle_right.png")
    assert key("/a/aloeL.jpg") == key("/a/aloeR.jpg")
    assert key("/a/cat.jpg") != key("/a/dog.jpg")


def test_debian_packages_are_found_below_another_root(tmp_path):
    """Unpacked packages are found with their name; maps of normals and others' files are not."""
    textures = tmp_path / "usr/share/games/supertuxkart/data/textures"
    write_photo(textures / "bricks_wall.jpg")
    write_photo(textures / "bricks_normal.jpg")
    write_photo(tmp_path / "usr/share/backgrounds/gnome/hill.jpg")
    found = {b.path.name: b for b in find_backgrounds((), tmp_path)}
    assert found["bricks_wall.jpg"].kind is Kind.TEXTURE
    assert found["bricks_wall.jpg"].source == "supertuxkart-data"
    assert found["hill.jpg"].source == "gnome-backgrounds"
    assert "bricks_normal.jpg" not in found


def test_few_photographs_are_answered_with_one_line_of_advice(tmp_path):
    """The line names the packages to install; with enough photographs there is none."""
    line = advice(find_backgrounds((), tmp_path))
    assert line is not None
    assert "\n" not in line
    assert all(s.package in line for s in DEBIAN_SOURCES)
    many = [Background(Path(f"/p/{i}.jpg"), Kind.PHOTO, "x") for i in range(50)]
    assert advice(many) is None


def test_a_folder_that_cannot_serve_is_named(tmp_path):
    """Missing and empty folders are errors with their path."""
    with pytest.raises(BackgroundsError, match="no such folder"):
        find_backgrounds([tmp_path / "none"], tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "notes.txt").write_text("x" * 20_000)
    with pytest.raises(BackgroundsError, match="no picture in it"):
        find_backgrounds([tmp_path / "empty"], tmp_path)


def test_only_photographs_are_loaded(tmp_path):
    """Photographs come as RGB and shrunk; drawings, normal maps and broken files are refused."""
    big = tmp_path / "big.png"
    write_photo(big, (2400, 1200))
    rgb = load_rgb(big)
    assert rgb is not None
    assert rgb.shape == (550, 1100, 3)
    red = np.zeros((300, 300, 3), dtype=np.uint8)
    red[:, :150, 2] = 200
    cv2.imwrite(str(tmp_path / "drawing.png"), red)
    assert load_rgb(tmp_path / "drawing.png") is None
    rng = np.random.default_rng(0)
    normal = np.dstack([np.full((300, 300), 250), *rng.integers(90, 166, (2, 300, 300))])
    cv2.imwrite(str(tmp_path / "bumps.png"), normal.astype(np.uint8))
    assert load_rgb(tmp_path / "bumps.png") is None
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8" + bytes(9000))
    assert load_rgb(tmp_path / "broken.jpg") is None
    assert load_rgb(tmp_path / "missing.jpg") is None
