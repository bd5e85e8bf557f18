"""Every format, written and read again: what it holds comes back, half a pixel is never lost."""

from __future__ import annotations

import json
import random
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from detector_training.datasets import yolo
from detector_training.datasets.coco import KEYS
from detector_training.datasets.convert import WRITERS
from detector_training.datasets.lines import line_of
from detector_training.datasets.load import Format, load_dataset, read_entries, recognise
from detector_training.datasets.names import LabelNames
from detector_training.datasets.sample import LabelBox, make_sample
from detector_training.errors import DatasetError
from target_pose.target import Level

WIDTH, HEIGHT = 64, 48
in_tmp = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)


def picture(path: Path, size=(WIDTH, HEIGHT)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((size[1], size[0], 3), 120, np.uint8))
    return path


def labelme_json(folder: Path, name: str, shapes, **change) -> Path:
    """A label as labelme writes it, with a picture beside it."""
    picture(folder / f"{name}.png")
    raw = {
        "version": "5.5.0",
        "flags": {},
        "shapes": shapes,
        "imagePath": f"{name}.png",
        "imageData": None,
        "imageHeight": HEIGHT,
        "imageWidth": WIDTH,
    }
    path = folder / f"{name}.json"
    path.write_text(json.dumps({k: v for k, v in (raw | change).items() if v != "gone"}))
    return path


def shape(kind, *points, label="T_good"):
    return {"label": label, "points": [list(p) for p in points], "shape_type": kind, "flags": {}}


corner = st.floats(-30, 90, width=32).map(lambda v: round(v, 3))
boxes_st = st.lists(
    st.builds(
        lambda level, x, y, w, h, visible: LabelBox(level, (x, y, x + w, y + h), visible),
        st.sampled_from(Level),
        corner,
        corner,
        st.floats(0.5, 80),
        st.floats(0.5, 80),
        st.floats(0, 1).map(lambda v: round(v, 3)),
    ),
    max_size=4,
)


@in_tmp
@given(
    boxes_st,
    st.sampled_from(Format),
    st.lists(st.sampled_from(["blur", "far", "rain"]), unique=True),
    st.none() | st.floats(0.1, 50),
)
def test_what_is_written_comes_back(tmp_path_factory, boxes, kind, conditions, distance):
    """Boxes within 0.001 px, classes, visible share, conditions and distance; YOLO clips."""
    tmp_path = tmp_path_factory.mktemp("d")
    image = picture(tmp_path / "a.png")
    sample = make_sample(
        image, (WIDTH, HEIGHT), boxes, tuple(conditions), distance_m=distance, split="val"
    )
    written = WRITERS[kind]([sample], tmp_path / "out")
    (back,) = load_dataset(tmp_path / "out")
    assert back.image.read_bytes() == image.read_bytes()
    assert (back.width, back.height, back.split) == (WIDTH, HEIGHT, "val")
    low, high = np.full(4, -0.5), np.array([WIDTH, HEIGHT, WIDTH, HEIGHT]) - 0.5
    expected = sample.boxes
    keep = np.ones(len(boxes), bool)
    if kind is Format.YOLO:
        expected = np.clip(sample.boxes, low, high)
        keep = (expected[:, 2:] > expected[:, :2]).all(1)
        assert written.dropped == (~keep).sum()
        assert written.clipped == (np.abs(expected - sample.boxes).max(1) > 0)[keep].sum()
    else:
        assert sorted(back.conditions) == sorted(conditions)
        assert back.distance_m == distance
        assert back.visible == pytest.approx(sample.visible, abs=1e-3)
    assert written.boxes == keep.sum()
    assert back.classes.tolist() == sample.classes[keep].tolist()
    assert np.allclose(back.boxes, expected[keep], atol=2e-3)


def test_a_shape_that_fills_the_picture_has_the_same_box_in_every_format(tmp_path):
    """Corner to corner is (0, 0, W, H) there and (-0.5, -0.5, W - 0.5, H - 0.5) here."""
    labelme_json(tmp_path / "labelme", "a", [shape("rectangle", (WIDTH, HEIGHT), (0, 0))])
    picture(tmp_path / "yolo" / "images" / "a.png")
    (tmp_path / "yolo" / "labels").mkdir()
    (tmp_path / "yolo" / "labels" / "a.txt").write_text("0 0.5 0.5 1 1\n")
    (tmp_path / "yolo" / "data.yaml").write_text("train: images\nnames: [T_good]\n")
    picture(tmp_path / "coco" / "a.png")
    coco(tmp_path / "coco")
    for kind in ("labelme", "yolo", "coco"):
        (sample,) = load_dataset(tmp_path / kind)
        assert sample.boxes.tolist() == [[-0.5, -0.5, WIDTH - 0.5, HEIGHT - 0.5]]
        assert sample.visible.tolist() == [1.0]


def coco(folder: Path, name="coco.json", **change) -> Path:
    raw = {
        "images": [{"id": 7, "file_name": "a.png", "width": WIDTH, "height": HEIGHT}],
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 3, "bbox": [0, 0, WIDTH, HEIGHT]},
            {"id": 2, "image_id": 7, "category_id": 3, "bbox": [0, 0, 9, 9], "iscrowd": 1},
        ],
        "categories": [{"id": 3, "name": "T_good"}, {"id": 4, "name": "person"}],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(raw | change))
    return folder / name


@pytest.mark.parametrize(
    ("drawn", "box"),
    [
        (shape("rectangle", (30, 5), (10, 25)), (9.5, 4.5, 29.5, 24.5)),
        (shape("circle", (20, 20), (23, 24)), (14.5, 14.5, 24.5, 24.5)),
        (shape("polygon", (1, 2), (9, 4), (5, 12)), (0.5, 1.5, 8.5, 11.5)),
        (
            shape("oriented_rectangle", (5, 0), (10, 5), (5, 10), (0, 5)),
            (-0.5, -0.5, 9.5, 9.5),
        ),
    ],
)
def test_labelme_shapes_become_the_box_around_them(tmp_path, drawn, box):
    """Rectangles from any corner, circles by centre and rim, polygons."""
    labelme_json(tmp_path / "flight 1" / "deep", "a", [drawn], flags={"blur": True, "far": False})
    (sample,) = load_dataset(tmp_path)
    assert sample.boxes[0].tolist() == pytest.approx(box)
    assert sample.conditions == ("blur",)


@pytest.mark.parametrize(
    ("shapes", "change", "says"),
    [
        ([shape("linestrip", (1, 1), (2, 2))], {}, "'linestrip' has no box; draw one of circle"),
        ([shape("point", (1, 1))], {}, "'point' has no box"),
        ([shape("rectangle", (1, 1), (1, 9))], {}, "T_good has no area"),
        ([shape("rectangle", (1, 1))], {}, "rectangle has 2 points"),
        ([shape("circle", (1, 1))], {}, "a circle has a centre"),
        ([shape("polygon", (1, 1), (2, 2))], {}, "polygon has 3 points"),
        ([shape("rectangle", (1, 1), (2, "3"))], {}, "y must be a number"),
        ([shape("rectangle", (1, 1), (2, 3), label="dog")], {}, "'dog' is not one of T_good, "),
        ([{"label": "T_good"}], {}, "lacks points"),
        ([3], {}, "a shape must be a JSON object"),
        ([], {"imagePath": "../../b.png"}, "leaves"),
        ([], {"imagePath": "/etc/passwd"}, "not relative"),
        ([], {"imagePath": "C:\\a\\b.png"}, "not relative"),
        ([], {"imagePath": "gone"}, "lacks imagePath"),
        ([], {"imageWidth": 1e6}, "imageWidth must be 1 to 8192"),
        ([], {"flags": {"blur": "yes"}}, "flag 'blur' must be true or false"),
        ([], {"distance_m": -2}, "distance_m"),
    ],
)
def test_a_wrong_label_of_labelme_is_named(tmp_path, shapes, change, says):
    """The file and what to do about it."""
    path = labelme_json(tmp_path, "a", shapes, **change)
    with pytest.raises(DatasetError, match=says) as caught:
        load_dataset(tmp_path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_wrong_shape_is_found_at_once(tmp_path):
    """Whoever mends labels wants the whole list."""
    drawn = [shape("point", (1, 1)), shape("rectangle", (1, 1), (5, 5)), shape("line", (1, 1))]
    labelme_json(tmp_path, "a", drawn)
    labelme_json(tmp_path, "b", [])
    entries = list(read_entries(recognise(tmp_path), LabelNames()))
    assert [isinstance(e, DatasetError) for e in entries] == [True, True, False]


def test_a_picture_of_another_machine_is_found_beside_its_label(tmp_path):
    """An absolute path of labelme's, size left out: both are looked up."""
    change = {"imagePath": "C:\\me\\a.png", "imageWidth": None, "imageHeight": None}
    labelme_json(tmp_path, "a", [], **change)
    (sample,) = load_dataset(tmp_path)
    assert (sample.image, sample.width) == (tmp_path / "a.png", WIDTH)
    labelme_json(tmp_path / "labels", "b", [], imagePath="..\\pictures\\b.png")
    picture(tmp_path / "pictures" / "b.png")
    assert load_dataset(tmp_path)[1].image == tmp_path / "pictures" / "b.png"


def test_labels_of_another_target_are_mapped_or_ignored(tmp_path):
    """--map and --ignore, in all formats that have names of their own."""
    names = LabelNames.parse(["board=T_good"], ["dog"])
    drawn = [shape("rectangle", (1, 1), (9, 9), label=name) for name in ("board", "dog")]
    labelme_json(tmp_path / "labelme", "a", drawn)
    picture(tmp_path / "yolo" / "a.png")
    (tmp_path / "yolo" / "a.txt").write_text("0 .5 .5 .1 .1\n1 .5 .5 .1 .1\n")
    (tmp_path / "yolo" / "classes.txt").write_text("board\ndog\n")
    picture(tmp_path / "coco" / "images" / "a.png")
    coco(tmp_path / "coco", categories=[{"id": 3, "name": "board"}])
    for kind in ("labelme", "yolo", "coco"):
        with pytest.raises(DatasetError, match="'board' is not one of .* --map board=T_good"):
            load_dataset(tmp_path / kind)
        (sample,) = load_dataset(tmp_path / kind, names)
        assert [b.level for b in sample.labels] == [Level.GOOD]


@pytest.mark.parametrize(
    ("maps", "ignores", "says"),
    [
        (["board"], [], "NAME=LEVEL"),
        (["board=T_worst"], [], "'T_worst' is not one of"),
        (["a=T_good", "a=T_best"], [], "mapped to T_good already"),
        (["a=T_good"], ["a"], "both mapped and ignored"),
    ],
)
def test_impossible_mappings_are_refused(maps, ignores, says):
    """With the option as it was typed."""
    with pytest.raises(DatasetError, match=says):
        LabelNames.parse(maps, ignores)


YOLO_LAYOUTS = {
    "images and labels": ("images/train/a.png", "labels/train/a.txt", "train: images/train\n"),
    "roboflow": ("train/images/a.png", "train/labels/a.txt", "train: ../train/images\n"),
    "beside": ("pictures/a.png", "pictures/a.txt", "train: pictures\n"),
    "a list": ("images/train/a.png", "labels/train/a.txt", "train: list.txt\n"),
    "lists of folders": ("images/x/a.png", "labels/x/a.txt", "train: [images/x]\nval: images/x\n"),
    "a path": ("in/images/a.png", "in/labels/a.txt", "path: in\ntrain: images\n"),
    "a path elsewhere": ("images/a.png", "labels/a.txt", "path: /no/such\ntrain: images\n"),
}


@pytest.mark.parametrize("layout", YOLO_LAYOUTS)
def test_yolo_is_read_in_all_its_layouts(tmp_path, layout):
    """Boxes and polygons; numbers of classes from a list or a mapping."""
    image, label, description = YOLO_LAYOUTS[layout]
    picture(tmp_path / image)
    (tmp_path / "list.txt").write_text(image + "\n")
    (tmp_path / label).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / label).write_text("2 0.25 0.5 0.5 0.5\n\n0 0 0 1 0 0.5 1\n")
    names = (
        "names:\n  0: T_good\n  2: T_best\n" if layout == "beside" else "names: [T_good, x, T_best]"
    )
    (tmp_path / "data.yaml").write_text(description + names)
    (sample,) = load_dataset(tmp_path)
    assert sample.boxes.tolist() == [[-0.5, 11.5, 31.5, 35.5], [-0.5, -0.5, 63.5, 47.5]]
    assert [b.level for b in sample.labels] == [Level.BEST, Level.GOOD]
    assert sample.split == "train"


def test_one_split_of_a_yolo_data_set_can_be_asked_for(tmp_path):
    """By its folder of pictures; the names come from above."""
    samples = [
        make_sample(picture(tmp_path / f"{s}.png"), (WIDTH, HEIGHT), [], split=s)
        for s in ("train", "val")
    ]
    box = LabelBox(Level.GOOD, (1.0, 1.0, 5.0, 5.0), 1.0)
    samples.append(make_sample(picture(tmp_path / "c.png"), (WIDTH, HEIGHT), [box], split="val"))
    WRITERS[Format.YOLO](samples, tmp_path / "out")
    (tmp_path / "out" / "labels" / "val" / "val.txt").unlink()  # no text file: no target
    assert len(load_dataset(tmp_path / "out")) == 3
    held_out = load_dataset(tmp_path / "out" / "images" / "val")
    assert [(s.image.name, len(s.boxes), s.split) for s in held_out] == [
        ("c.png", 1, "val"),
        ("val.png", 0, "val"),
    ]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("0 .5 .5 .1 .1 .9", "6 numbers.*confidence"),
        ("0 .5 .5", "3 numbers"),
        ("7 .5 .5 .1 .1", "class 7 is not one of the 1"),
        ("0 .5 .5 0 .1", "no area"),
        ("0 320 240 50 50", "share of the picture's side"),
        ("0 nan .5 .1 .1", "must be finite"),
        ("zero .5 .5 .1 .1", "must be numbers"),
        ("0 .5 .5 .1 .1\n" * 300, "over 256 boxes"),
    ],
)
def test_a_wrong_line_of_yolo_is_named(tmp_path, line, says):
    """File and line."""
    picture(tmp_path / "images" / "a.png")
    (tmp_path / "labels").mkdir()
    (tmp_path / "labels" / "a.txt").write_text(line)
    (tmp_path / "data.yaml").write_text("train: images\nnames: [T_good]")
    with pytest.raises(DatasetError, match=rf"a\.txt line \d+: .*{says}"):
        load_dataset(tmp_path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("names: [a\n", "no YAML"),
        ("- a\n", "must be a mapping"),
        ("train: images\n", "names must list"),
        ("names: {a: b}\ntrain: images\n", "names must list"),
        ("names: [T_good]\ntrain: elsewhere\n", "'elsewhere' is not there"),
        ("names: [T_good]\ntrain: {a: b}\n", "must be a path"),
        ("names: [T_good]\ntrain: images\n", "no picture has a label"),
        ("[" * 5000, "nested too deeply|no YAML"),
    ],
)
def test_a_wrong_description_of_yolo_is_named(tmp_path, text, says):
    """data.yaml and what it lacks."""
    picture(tmp_path / "images" / "a.png")
    (tmp_path / "data.yaml").write_text(text)
    with pytest.raises(DatasetError, match=rf"data\.yaml.*({says})"):
        load_dataset(tmp_path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"images": {}}, "images must be a list"),
        ({"images": [{"id": 7}]}, "image 7: lacks file_name"),
        ({"images": [{"id": 7, "file_name": "/a", "width": 1, "height": 1}]}, "leaves"),
        ({"images": [{"id": 7}, {"id": 7}]}, "two of the image ids are 7"),
        ({"images": []}, "annotation 1: no image has the id 7"),
        ({"annotations": [{"image_id": 7, "category_id": 9}]}, "category_id 9 is not"),
        ({"annotations": [{"image_id": 7, "category_id": 4}]}, "'person' is not one of"),
        ({"annotations": [{"image_id": 7, "category_id": 3}]}, r"\(a.png\): lacks bbox"),
        ({"annotations": [{"image_id": 7, "category_id": 3, "bbox": [1, 2, 3]}]}, "bbox must be"),
        ({"annotations": [{"image_id": 7, "category_id": 3, "bbox": [1, 2, 0, 3]}]}, "no area"),
        ({"annotations": [{"image_id": [], "category_id": 3}]}, "an id must be"),
    ],
)
def test_a_wrong_entry_of_coco_is_named(tmp_path, change, says):
    """File, entry and what is wrong with it."""
    picture(tmp_path / "a.png")
    path = coco(tmp_path, **change)
    with pytest.raises(DatasetError, match=says) as caught:
        load_dataset(tmp_path)
    assert str(path) in str(caught.value)


def test_coco_pictures_are_found_in_the_usual_places(tmp_path):
    """annotations/instances_val.json belongs to val/."""
    path = coco(tmp_path / "annotations", "instances_val.json")
    image = picture(tmp_path / "val" / "a.png")
    assert load_dataset(tmp_path)[0].image == image
    assert load_dataset(path)[0].image == image


def test_a_folder_without_or_with_two_data_sets_is_refused(tmp_path):
    """Says what was looked for, or what was found."""
    for path, says in ((tmp_path / "no", "no such folder"), (tmp_path, "looked for labels.jsonl")):
        with pytest.raises(DatasetError, match=f"no data set in .*{says}"):
            load_dataset(path)
    coco(tmp_path)
    label = labelme_json(tmp_path, "a", [])
    with pytest.raises(
        DatasetError, match="holds 2 data sets: coco .*, labelme .*the one you mean"
    ):
        load_dataset(tmp_path)
    assert len(load_dataset(tmp_path / "coco.json")) == 1
    with pytest.raises(DatasetError, match="one label of labelme; give its folder"):
        load_dataset(label)
    with pytest.raises(DatasetError, match=r"a\.png is no data set"):
        load_dataset(tmp_path / "a.png")


def test_yolo_labels_without_names_are_told_apart_from_nothing(tmp_path):
    """What is missing is the file with the names."""
    picture(tmp_path / "a.png")
    (tmp_path / "a.txt").write_text("0 .5 .5 .1 .1\n")
    with pytest.raises(DatasetError, match=r"YOLO labels, but no data\.yaml"):
        load_dataset(tmp_path)


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.just("a.png"),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                [
                    *KEYS,
                    "shapes",
                    "imagePath",
                    "imageWidth",
                    "flags",
                    "label",
                    "points",
                    "id",
                    "level",
                ]
                + [
                    "image_id",
                    "category_id",
                    "bbox",
                    "file_name",
                    "width",
                    "height",
                    "name",
                    "boxes",
                ]
            )
            | st.text(max_size=4),
            inner,
            max_size=5,
        )
    ),
    max_leaves=25,
)


def spoiled(value, chance: random.Random, by):
    """A copy of a JSON value with one part replaced."""
    if isinstance(value, dict) and value and chance.random() < 0.8:
        key = chance.choice(sorted(value))
        return value | {key: spoiled(value[key], chance, by)}
    if isinstance(value, list) and value and chance.random() < 0.8:
        at = chance.randrange(len(value))
        return [*value[:at], spoiled(value[at], chance, by), *value[at + 1 :]]
    return by


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300)
@given(
    json_values, st.randoms(use_true_random=False), st.sampled_from(["labelme", "coco", "lines"])
)
def test_spoiled_json_raises_nothing_but_dataset_errors(tmp_path, by, chance, kind):
    """One part of a good file replaced by anything: read, or refused in one line."""
    folder = tmp_path / kind
    if kind == "labelme":
        path = labelme_json(folder, "a", [shape("rectangle", (1, 1), (9, 9))], distance_m=2)
        good = json.loads(path.read_text())
    elif kind == "coco":
        good = json.loads((path := coco(folder)).read_text())
    else:
        box = LabelBox(Level.GOOD, (1, 2, 3, 4), 1)
        folder.mkdir(exist_ok=True)
        path = folder / "labels.jsonl"
        sample = make_sample(picture(folder / "images" / "a.png"), (9, 9), [box], ("far",))
        good = json.loads(line_of(sample, "a.png"))
    path.write_text(json.dumps(spoiled(good, chance, by)))
    try:
        for sample in load_dataset(folder):
            assert (sample.boxes[:, :2] < sample.boxes[:, 2:]).all()
            assert np.isfinite(sample.boxes).all()
    except DatasetError as error:
        assert "\n" not in str(error)  # noqa: PT017 - either outcome is right


@in_tmp
@given(st.binary(max_size=300), st.sampled_from(["data.yaml", "labels/a.txt", "labels.jsonl"]))
def test_bytes_in_place_of_a_label_raise_nothing_but_dataset_errors(tmp_path, noise, name):
    """YAML, text and lines alike."""
    picture(tmp_path / "images" / "a.png")
    (tmp_path / "labels").mkdir(exist_ok=True)
    good = {"data.yaml": b"train: images\nnames: [T_good]", "labels/a.txt": b"0 .5 .5 .1 .1"}
    for file in (*good, "labels.jsonl"):
        (tmp_path / file).unlink(missing_ok=True)
    if name in good:
        for file, data in good.items():
            (tmp_path / file).write_bytes(data)
    (tmp_path / name).write_bytes(noise)
    try:
        load_dataset(tmp_path)
    except DatasetError as error:
        assert "\n" not in str(error)  # noqa: PT017 - either outcome is right


def test_pictures_of_one_name_do_not_overwrite_each_other(tmp_path):
    """Nested folders, and one stem with two suffixes: labels are named by the stem."""
    paths = ["one/a.png", "two/a.png", "two/a.bmp", "two/b.png"]
    samples = [make_sample(picture(tmp_path / p), (WIDTH, HEIGHT), []) for p in paths]
    WRITERS[Format.LABELME](samples, tmp_path / "out")
    back = load_dataset(tmp_path / "out")
    assert len({s.image.stem for s in back}) == 4


@pytest.mark.parametrize("kind", Format)
def test_nothing_half_written_is_left(tmp_path, kind):
    """A picture that is missing ends the conversion, and the folder is not there."""
    good = make_sample(picture(tmp_path / "a.png"), (WIDTH, HEIGHT), [])
    missing = make_sample(tmp_path / "b.png", (WIDTH, HEIGHT), [])
    with pytest.raises(DatasetError, match=r"b\.png: No such file"):
        WRITERS[kind]([good, missing], tmp_path / "out")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png"]
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "x").touch()
    with pytest.raises(DatasetError, match="holds something already"):
        WRITERS[kind]([good], tmp_path / "taken")


def test_pictures_that_are_turned_stay_so(tmp_path):
    """The bytes are copied, and the number is told: some YOLO and COCO tools do not turn them."""
    exif = Image.Exif()
    exif[0x112] = 8
    Image.new("RGB", (WIDTH, HEIGHT)).save(tmp_path / "a.jpg", exif=exif)
    sample = make_sample(tmp_path / "a.jpg", (HEIGHT, WIDTH), [])
    for kind, write in WRITERS.items():
        assert write([sample], tmp_path / kind).turned == 1
        assert load_dataset(tmp_path / kind)[0].read().shape == (WIDTH, HEIGHT, 3)


@pytest.mark.parametrize("name", ["a\nb.png", "\ud800.png", "a\0.png", "x" * 300, ""])
def test_names_that_no_file_can_have_are_refused_in_one_line(tmp_path, name):
    """Line ends, halves of characters, NUL, too long, none."""
    picture(tmp_path / "a.png")
    images = [{"id": 7, "file_name": name, "width": 1, "height": 1}]
    coco(tmp_path / "coco", images=images)
    labelme_json(tmp_path / "labelme", "a", [], imagePath=name)
    for kind in ("coco", "labelme"):
        with pytest.raises(DatasetError, match="printable characters") as caught:
            load_dataset(tmp_path / kind)
        assert str(caught.value).isprintable()


def test_linked_folders_are_followed_once(tmp_path):
    """Pictures often lie on another disk; links that lead in a circle end."""
    labelme_json(tmp_path / "elsewhere", "a", [])
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "flight").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "back").symlink_to(tmp_path / "data")
    assert [s.image.name for s in load_dataset(tmp_path / "data")] == ["a.png"]


def test_text_files_without_a_picture_are_found(tmp_path):
    """In folders called labels, the list of classes aside."""
    picture(tmp_path / "images" / "a.png")
    (tmp_path / "labels").mkdir()
    for name in ("a.txt", "gone.txt", "classes.txt"):
        (tmp_path / "labels" / name).touch()
    found = list(yolo.labels_without_picture(tmp_path))
    assert found == [tmp_path / "labels" / "gone.txt"]
