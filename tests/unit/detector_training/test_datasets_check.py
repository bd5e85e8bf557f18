"""What is wrong with a data set is found, said with its file, and nothing else is."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from detector_training.datasets.check import Kind, check_sample
from detector_training.datasets.convert import write_labelme, write_lines, write_yolo
from detector_training.datasets.fingerprint import difference, link_alike, look_of, nearest_alike
from detector_training.datasets.inspection import inspect_dataset
from detector_training.datasets.sample import LabelBox, make_sample, share_inside
from detector_training.datasets.sheet import draw_sheet
from detector_training.errors import DatasetError
from detector_training.scenes.projection import circle_box, image_from_board, square_box
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose
from target_pose.target import Level, load_target

TARGET = load_target()
SIZE = (640, 480)


def nested(x=300.0, y=200.0, side=120.0) -> list[LabelBox]:
    """The three boxes of a target that faces the camera."""
    halves = {
        level: side / 2 * m / TARGET.level_m[Level.GOOD] for level, m in TARGET.level_m.items()
    }
    return [LabelBox(k, (x - h, y - h, x + h, y + h), 1.0) for k, h in halves.items()]


def findings(boxes, conditions=(), **kw):
    sample = make_sample(Path("a.jpg"), SIZE, boxes, conditions)
    return [(f.kind, f.text) for f in check_sample(sample, TARGET, **kw) if f.wrong]


@given(
    st.floats(-60, 700),
    st.floats(-60, 540),
    st.floats(10, 900),
    st.booleans(),
    st.sets(st.sampled_from(Level), min_size=1),
)
@example(0.0, 0.0, 316.0, True, {Level.BEST})  # the second one's inner discs lie outside
def test_true_labels_are_left_alone(x, y, side, second, levels):
    """A target anywhere, over the border, with levels missing; two targets in one picture."""
    boxes = [b for b in nested(x, y, side) if b.level in levels]
    if second:
        boxes += nested(x + 2.2 * side, y, side)
    boxes = [b for b in boxes if share_inside(b.xyxy, SIZE) > 0]
    assert findings(boxes) == []


@settings(max_examples=150)
@given(
    st.floats(-65, 65),
    st.floats(-180, 180),
    st.floats(-0.4, 0.4),
    st.floats(-0.3, 0.3),
    st.floats(0.5, 8),
    st.booleans(),
)
def test_projected_targets_nest(tilt_deg, turn_deg, bearing_x, bearing_y, distance_m, clipped):
    """Tilted and turned in perspective, as the generator labels them, and clipped as YOLO does."""
    camera = CameraIntrinsics(*SIZE, 390.0, 390.0, 319.5, 239.5)
    tilt, turn = np.radians([tilt_deg, turn_deg])
    facing = np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0]], float)  # target x looks at the camera
    around = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    lean = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    centre = distance_m * np.array([bearing_x, bearing_y, 1.0])
    pose = Pose.from_rotation(around @ lean @ facing, centre)
    matrix = image_from_board(camera, pose)
    boxes = []
    for level, side in TARGET.level_m.items():
        board = level is Level.GOOD
        xyxy = np.array(square_box(matrix, side) if board else circle_box(matrix, side / 2))
        if clipped:
            xyxy = np.clip(xyxy, -0.5, np.tile(SIZE, 2) - 0.5)
        if share_inside(xyxy, SIZE) > 0:
            boxes.append(LabelBox(level, tuple(xyxy), 1.0))
    assert [f for f in findings(boxes) if f[0] is Kind.NESTING] == []


def moved(box, dx=0.0, scale=1.0, level=None):
    x0, y0, x1, y1 = box.xyxy
    w, h = (x1 - x0) * (scale - 1) / 2, (y1 - y0) * (scale - 1) / 2
    return LabelBox(level or box.level, (x0 + dx - w, y0 - h, x1 + dx + w, y1 + h), 1.0)


def wrong_boxes():
    good, better, best = nested()
    return {
        "shifted": ([good, better, moved(best, dx=30)], Kind.NESTING, "T_best .* does not nest"),
        "names swapped": (
            [good, moved(best, level=Level.BETTER), moved(better, level=Level.BEST)],
            Kind.NESTING,
            "T_best .* does not nest in T_better",
        ),
        "too large": (
            [good, moved(better, scale=1.4)],
            Kind.NESTING,
            "that is 1.33 times as large",
        ),
        "elsewhere": ([good, better, moved(best, dx=250)], Kind.NESTING, "lies in no T_good"),
        "outside": ([moved(good, dx=900)], Kind.OUTSIDE, "outside of its 640x480 px"),
        "twice": ([good, better, best, moved(good, dx=1)], Kind.DUPLICATE, "T_good .* twice"),
    }


@pytest.mark.parametrize("case", wrong_boxes())
def test_a_wrong_box_is_found(case):
    """And the text says which, and what is wrong with it."""
    boxes, kind, says = wrong_boxes()[case]
    found = findings(boxes)
    assert {k for k, _ in found} == {kind}
    assert any(re.search(says, text) for _, text in found)


def test_a_tiny_box_is_a_note_and_an_unknown_flag_is_wrong():
    """Flags of one's own can be made known; a far target's dot may be tiny."""
    sample = make_sample(Path("a.jpg"), SIZE, nested(side=8), ("far", "blurr", "rain"))
    found = {f.kind: f for f in check_sample(sample, TARGET, {"rain"})}
    assert not found[Kind.TINY].wrong
    assert "'blurr' is not a known one" in found[Kind.FLAG].text
    assert len(found) == 2


def photo(path: Path, seed: int, shift=0) -> Path:
    """A picture with structure; ``shift`` moves the camera by so many pixels."""
    small = np.random.default_rng(seed).integers(0, 255, (16, 22, 3), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    big = cv2.resize(small, (740, 480), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(path), np.ascontiguousarray(big[:, shift : shift + 640]))
    return path


def dataset(folder: Path, count=4, first_seed=0, write=write_lines) -> Path:
    """A data set without fault."""
    samples = [
        make_sample(photo(folder / "src" / f"{i}.png", first_seed + i), SIZE, nested())
        for i in range(count)
    ]
    write(samples, folder / "out")
    return folder / "out"


def kinds(report):
    return sorted(str(f.kind) for f in report.findings)


def test_a_data_set_without_fault_has_no_findings(tmp_path):
    """In all its pictures, against another one too; progress ends at all pictures."""
    seen = []
    mine, other = dataset(tmp_path / "a"), dataset(tmp_path / "b", first_seed=50)
    report = inspect_dataset(
        mine, TARGET, against=other, on_progress=lambda *done: seen.append(done)
    )
    assert report.findings == ()
    assert seen[-1] == (8, 8)
    assert draw_sheet(report.samples, report.findings) is None


def test_wrong_pictures_are_found_each_with_its_file(tmp_path):
    """Missing, empty, cut off, of another size, there twice, without a label."""
    folder = dataset(tmp_path, 6)
    images = folder / "images"
    (images / "0.png").unlink()
    (images / "1.png").write_bytes(b"")
    (images / "2.png").write_bytes((images / "2.png").read_bytes()[:2000])
    cv2.imwrite(str(images / "3.png"), np.zeros((10, 10, 3), np.uint8))
    shutil.copy(images / "4.png", images / "5.png")
    photo(images / "6.png", 6)
    report = inspect_dataset(folder, TARGET)
    found = {(str(f.kind), Path(f.file).name): f.text for f in report.findings}
    assert set(found) == {
        ("no picture", "0.png"),
        ("picture", "1.png"),
        ("picture", "2.png"),
        ("picture", "3.png"),
        ("twice", "5.png"),
        ("no label", "6.png"),
    }
    assert found["no picture", "0.png"] == "No such file or directory"
    assert "10x10" in found["picture", "3.png"]
    assert found["twice", "5.png"].endswith("4.png")
    assert report.wrong == 6
    assert json.loads(json.dumps(report.as_json()))["wrong"] == 6


def test_wrong_labels_do_not_end_the_check(tmp_path):
    """Each broken labelme file is a finding, and so is a picture that nobody labelled."""
    folder = dataset(tmp_path, 4, write=write_labelme)
    (folder / "0.json").write_text('{"shapes": [')
    raw = json.loads((folder / "1.json").read_text())
    raw["shapes"][0]["label"] = raw["shapes"][1]["label"] = "dog"
    (folder / "1.json").write_text(json.dumps(raw))
    (folder / "2.json").unlink()
    report = inspect_dataset(folder, TARGET)
    assert kinds(report) == ["label", "label", "label", "no label"]
    assert {Path(f.file.split()[0]).name for f in report.findings} == {"0.json", "1.json", "2.png"}
    assert all(f.file.startswith(str(folder)) for f in report.findings)


def test_a_yolo_label_without_a_picture_is_found(tmp_path):
    """The text file is named."""
    folder = dataset(tmp_path, write=write_yolo)
    (folder / "images" / "train" / "0.png").unlink()
    (folder / "labels" / "train" / "1.txt").unlink()
    finding, note = inspect_dataset(folder, TARGET).findings
    assert (note.wrong, Path(note.file).name) == (False, "1.png")
    assert (finding.kind, Path(finding.file).name) == (Kind.NO_PICTURE, "0.txt")


def test_a_picture_in_training_and_test_is_a_leak(tmp_path):
    """Byte for byte it is wrong; one that looks the same is a note."""
    mine, other = dataset(tmp_path / "a"), dataset(tmp_path / "b", first_seed=50)
    shutil.copy(other / "images" / "3.png", mine / "images" / "0.png")
    again = cv2.imread(str(other / "images" / "2.png"))
    cv2.imwrite(str(mine / "images" / "1.png"), cv2.convertScaleAbs(again, alpha=0.9, beta=9))
    report = inspect_dataset(mine, TARGET, against=other)
    leaks = [(Path(f.file).name, f.wrong) for f in report.findings if f.kind is Kind.LEAK]
    assert leaks == [("0.png", True), ("1.png", False)]


def test_the_sheet_shows_the_worst_pictures(tmp_path):
    """One tile a picture with findings, a missing one too."""
    samples = [
        make_sample(photo(tmp_path / "a.png", 1), SIZE, [*nested(), moved(nested()[0], dx=1)]),
        make_sample(tmp_path / "gone.png", SIZE, [moved(nested()[0], dx=900)]),
    ]
    found = [f for i, s in enumerate(samples) for f in check_sample(s, TARGET, index=i)]
    sheet = draw_sheet(samples, found)
    assert sheet.shape == (364, 800, 3)
    assert (sheet[:300] == (80, 220, 80)).all(-1).any()  # the box of T_good


def test_looks_tell_pictures_apart():
    """The same under another light, half different for another picture, none for a flat one."""
    rng = np.random.default_rng(0)
    a, b = (cv2.resize(rng.integers(0, 255, (9, 12, 3), np.uint8), SIZE) for _ in range(2))
    darker = cv2.convertScaleAbs(a, alpha=0.7)
    looks = [look_of(p) for p in (a, b, darker, np.full((9, 9, 3), 7, np.uint8))]
    assert looks[3] is None
    assert difference(looks[0], looks[2]) < 8
    assert difference(looks[0], looks[1]) > 60
    assert nearest_alike(looks, looks[1:]) == [1, 0, 1, None]
    assert nearest_alike(looks, [None]) == [None] * 4
    assert list(link_alike(looks)) == [[0, 2]]
    assert list(link_alike([None])) == []


@given(st.lists(st.integers(0, 2**16 - 1), max_size=24), st.integers(0, 4))
def test_linked_looks_are_the_components_of_a_graph(values, most_bits):
    """Found again by walking from each picture to all that are near, step by step."""
    looks = [np.array([v, 0, 0, 0], np.uint64) for v in values]
    expected = set()
    for i in range(len(values)):
        reached, edge = {i}, [i]
        while edge:
            k = edge.pop()
            near = {j for j, v in enumerate(values) if (v ^ values[k]).bit_count() <= most_bits}
            edge += near - reached
            reached |= near
        if len(reached) > 1:
            expected.add(frozenset(reached))
    assert {frozenset(g) for g in link_alike(looks, most_bits)} == expected


def test_no_data_set_is_one_error(tmp_path):
    """Not a finding: there is nothing to check."""
    with pytest.raises(DatasetError, match="no data set in"):
        inspect_dataset(tmp_path, TARGET)
