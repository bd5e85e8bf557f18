"""Data sets on disk, and the command that makes them."""

from __future__ import annotations

import json
import sys

import cv2
import numpy as np
import pytest

from detector_training.backgrounds import Split
from detector_training.commands import app
from detector_training.errors import DatasetError, SceneError
from detector_training.scenes import DatasetRequest, write_dataset


def request(count=5, seed=3, split=Split.TRAIN):
    """A small request without photographs."""
    return DatasetRequest(count, seed, split, "bullseye-400", ())


def read(folder):
    """Labels and pictures of a data set."""
    labels = [json.loads(line) for line in (folder / "labels.jsonl").read_text().splitlines()]
    return labels, [(folder / label["image"]).read_bytes() for label in labels]


def test_a_data_set_holds_what_its_description_says(tmp_path):
    """Pictures, labels, description and contact sheet agree with each other."""
    seen = []
    description = write_dataset(tmp_path / "d", request(), "the command", on_progress=seen.append)
    labels, pictures = read(tmp_path / "d")
    assert seen == [1, 2, 3, 4, 5]
    assert len(labels) == len(pictures) == description["count"] == 5
    assert description == json.loads((tmp_path / "d" / "dataset.json").read_text())
    assert sum(description["kinds"].values()) == 5
    assert description["command"] == "the command"
    for label in labels:
        assert set(label) == {
            "image", "width", "height", "kind", "recipe", "conditions", "distance_m", "boxes",
        }  # fmt: skip
        for box in label["boxes"]:
            assert 0 <= box["visible"] <= 1
            assert box["xyxy"][0] < box["xyxy"][2]
    assert cv2.imread(str(tmp_path / "d" / "contact_sheet.png")).shape == (180, 5 * 240, 3)
    assert not list((tmp_path / "d").glob("*.part"))


def test_processes_do_not_change_the_data(tmp_path):
    """Two processes write the same bytes as one; the other split other ones."""
    write_dataset(tmp_path / "one", request(5), "")
    write_dataset(tmp_path / "two", request(5), "", jobs=2)
    assert read(tmp_path / "one") == read(tmp_path / "two")
    write_dataset(tmp_path / "val", request(1, split=Split.VAL), "")
    assert read(tmp_path / "val")[1][0] != read(tmp_path / "one")[1][0]


def test_pictures_of_the_users_own_stay(tmp_path):
    """Not even --overwrite takes what another program put there; a part of a data set is told."""
    (tmp_path / "images").mkdir()
    mine = tmp_path / "images" / "holiday.jpg"
    mine.write_bytes(b"mine")
    write_dataset(tmp_path, request(1), "", overwrite=True)
    assert mine.read_bytes() == b"mine"
    (tmp_path / "labels.jsonl").unlink()
    with pytest.raises(DatasetError, match="a part of one"):
        write_dataset(tmp_path, request(1), "")


def test_a_data_set_is_replaced_only_when_asked(tmp_path):
    """The second run refuses, with --overwrite it leaves nothing of the first behind."""
    write_dataset(tmp_path, request(3), "")
    with pytest.raises(DatasetError, match="holds a data set already"):
        write_dataset(tmp_path, request(1), "")
    write_dataset(tmp_path, request(1), "", overwrite=True)
    assert len(list((tmp_path / "images").iterdir())) == 1


@pytest.mark.parametrize(
    ("count", "seed", "text"), [(0, 1, "--count 0"), (-3, 1, "--count -3"), (5, -1, "--seed -1")]
)
def test_impossible_numbers_are_refused(count, seed, text):
    """The error names the option and its value."""
    with pytest.raises(SceneError, match=text):
        request(count, seed)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--count", "0"], "--count 0"),
        (["--jobs", "0"], "--jobs 0"),
        (["--backgrounds", "/no/such/folder"], "/no/such/folder: no such folder"),
        (["--target", "dartboard"], "no target 'dartboard'"),
    ],
)
def test_bad_arguments_give_one_line(tmp_path, monkeypatch, capsys, arguments, text):
    """The command ends with status 2 and one line that says what, where and what to do."""
    out = str(tmp_path / "out")
    command = ["detector_training", "scenes", out, "--package-root", str(tmp_path), *arguments]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        app.main()
    assert end.value.code == 2
    errors = [li for li in capsys.readouterr().err.splitlines() if li.startswith("error:")]
    assert len(errors) == 1
    assert text in errors[0]


def test_a_place_that_cannot_be_written_is_named(tmp_path, monkeypatch, capsys):
    """A file where the folder should be: one line with its path."""
    (tmp_path / "file").write_text("")
    command = ["detector_training", "scenes", str(tmp_path / "file" / "out"), "--count", "1"]
    monkeypatch.setattr(sys, "argv", [*command, "--package-root", str(tmp_path), "--jobs", "1"])
    with pytest.raises(SystemExit) as end:
        app.main()
    assert end.value.code == 2
    assert f"cannot write to {tmp_path / 'file' / 'out'}" in capsys.readouterr().err


def test_own_photographs_end_up_in_the_pictures(tmp_path, monkeypatch):
    """Scenes with a folder of the user's differ from those without, and name its files."""
    folder = tmp_path / "mine"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for name in range(12):
        picture = cv2.resize(rng.integers(0, 255, (12, 16, 3), dtype=np.uint8), (640, 480))
        cv2.imwrite(str(folder / f"photo {name}abc.png"), picture)
    command = ["detector_training", "scenes", str(tmp_path / "d"), "--count", "4", "--jobs", "1"]
    command += ["--package-root", str(tmp_path), "--backgrounds", str(folder)]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        app.main()
    assert end.value.code == 0
    names = json.loads((tmp_path / "d" / "dataset.json").read_text())["backgrounds"][str(folder)]
    assert names
    assert all(n.startswith("photo ") for n in names)
