"""``dataset`` as people and machines call it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from detector_training.commands import app
from detector_training.datasets.convert import write_labelme
from detector_training.datasets.load import Format, load_dataset
from detector_training.datasets.sample import LabelBox, make_sample
from target_pose.target import Level


@pytest.fixture
def data(tmp_path):
    """Eight pictures of eight places, one box over the border."""
    samples = []
    for i in range(8):
        small = np.random.default_rng(i).integers(0, 255, (12, 16, 3), dtype=np.uint8)
        path = tmp_path / "src" / f"{i}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), cv2.resize(small, (320, 240)))
        box = LabelBox(Level.GOOD, (-10, 50, 90, 150), 0.9)
        samples.append(make_sample(path, (320, 240), [box], ("blur",), distance_m=2.5))
    write_labelme(samples, tmp_path / "data")
    return tmp_path / "data"


@pytest.fixture
def run(monkeypatch, capsys):
    def call(*words):
        monkeypatch.setattr(sys, "argv", ["detector_training", "dataset", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            app.main()
        told = capsys.readouterr()
        return end.value.code, told.out, told.err

    return call


def test_check_ends_with_one_when_something_is_wrong(data, run, tmp_path):
    """A line a finding, a sheet to look at, and JSON."""
    assert run("check", data)[0] == 0
    raw = json.loads((data / "3.json").read_text())
    raw["shapes"] *= 2
    (data / "3.json").write_text(json.dumps(raw))
    code, out, _ = run("check", data, "--sheet", tmp_path / "sheet.png")
    assert code == 1
    assert f"wrong  {data / '3.json'} (3.png): T_good is labelled twice" in out
    assert "(labelme): 8 labelled pictures, 1 duplicate" in out
    assert cv2.imread(str(tmp_path / "sheet.png")) is not None
    code, out, _ = run("check", data, "--json", "--against", data)
    report = json.loads(out)
    assert code == 1
    assert report["wrong"] == 9  # and every picture is in the other one
    assert {f["kind"] for f in report["findings"]} == {"duplicate", "leak"}


def test_stats_and_card(data, run, tmp_path):
    """For people, for machines and for a report."""
    code, out, _ = run("stats", data, "--plot", tmp_path / "p.svg")
    assert code == 0
    assert "8 pictures, 8 with a target" in out
    assert "distance [m]" in out
    assert (tmp_path / "p.svg").read_text().startswith("<?xml")
    assert json.loads(run("stats", data, "--json")[1])["conditions"]["blur"] == 8
    assert run("card", data)[0] == 0
    assert "# Data set data" in (data / "DATASET_CARD.md").read_text()


def test_licences_stay_with_what_is_made_from_a_data_set(data, run, tmp_path):
    """Converted, split: the card still tells them."""
    (data / "dataset.json").write_text('{"licences": {"mine": "CC0"}, "seed": 3}')
    assert run("convert", data, tmp_path / "a", "--to", "yolo")[0] == 0
    assert run("split", tmp_path / "a", tmp_path / "b")[0] == 0
    assert run("card", tmp_path / "b" / "val")[0] == 0
    card = (tmp_path / "b" / "val" / "DATASET_CARD.md").read_text()
    assert "| mine | CC0 | - |" in card
    assert f"made_from: `{tmp_path / 'a'}`" in card


@pytest.mark.parametrize("kind", Format)
def test_convert_and_split(data, run, tmp_path, kind):
    """Each format comes out as itself, and both sides of a split can be read."""
    code, _, err = run("convert", data, tmp_path / "out", "--to", kind)
    assert code == 0
    assert ("8 boxes clipped" in err) == (kind is Format.YOLO)
    assert len(load_dataset(tmp_path / "out")) == 8
    code, _, err = run("split", data, tmp_path / "halves", "--val", "0.25", "--to", kind)
    assert code == 0
    where = tmp_path / "halves" / ("images" if kind is Format.YOLO else "")
    assert f"6 pictures in {where / 'train'}, 2 in {where / 'val'}" in err
    sides = [load_dataset(where / side) for side in ("train", "val")]
    assert [len(s) for s in sides] == [6, 2]
    assert not {s.image.name for s in sides[0]} & {s.image.name for s in sides[1]}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["check", "DATA", "--sheet", "x.gif"], "--sheet x.gif: name a .png file"),
        (["stats", "DATA", "--plot", "x.exe"], "--plot x.exe: the name must end in .pdf, "),
        (["stats", "/no/such"], "no data set in /no/such"),
        (["stats", "DATA", "--map", "a"], "--map a: write"),
        (["convert", "DATA", "DATA", "--to", "coco"], "holds something already"),
        (["convert", "DATA", "IN", "--to", "coco"], "lies in the data set itself"),
        (["split", "DATA", "OUT", "--val", "2"], "--val 2.0: give the share"),
        (["check", "DATA", "--target", "dartboard"], "no target 'dartboard'"),
    ],
)
def test_what_the_user_got_wrong_is_one_line(data, run, tmp_path, words, says):
    """With status 2, and nothing is left behind."""
    names = {"DATA": data, "OUT": tmp_path / "out", "IN": data / "in"}
    code, _, err = run(*[names.get(w, w) for w in words])
    assert code == 2
    errors = [line for line in err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert says in errors[0]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "src"]


def test_labels_of_another_name_are_mapped(data, run):
    """The error says how, and doing so works."""
    for path in Path(data).glob("*.json"):
        path.write_text(path.read_text().replace("T_good", "board"))
    code, _, err = run("stats", data)
    assert code == 2
    assert "--map board=T_good" in err
    assert run("stats", data, "--map", "board=T_good")[0] == 0
    assert json.loads(run("stats", data, "--ignore", "board", "--json")[1])["negatives"] == 8


@pytest.mark.parametrize("command", ["check", "stats", "card", "convert", "split"])
def test_help_has_an_example(run, command):
    """One that can be typed."""
    code, out, _ = run(command, "--help")
    assert code == 0
    assert "Example: python -m detector_training dataset" in " ".join(out.split())
