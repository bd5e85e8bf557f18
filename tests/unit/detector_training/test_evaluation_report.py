"""An evaluation's groups, its worst cases, its folder and the plot of a fly-by."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from detector_training.commands import evaluate
from detector_training.datasets.sample import Sample, load_dataset
from detector_training.errors import DatasetError, EvaluationError
from detector_training.evaluation.fly_by import (
    fly_by,
    intervals_in_view,
    load_recording,
    plot_fly_by,
)
from detector_training.evaluation.groups import SIZES_PX, By, bin_name, groups
from detector_training.evaluation.matching import Counting, candidate_outcome, true_targets
from detector_training.evaluation.report import write_report
from detector_training.evaluation.run import run_detector
from detector_training.evaluation.scores import score
from detector_training.evaluation.worst import page, worst_cases
from edge_service.detector.files import DEFAULT_WEIGHTS
from target_pose.candidate import Box, Candidate, Detections
from target_pose.target import Level, load_target
from tests.unit.detector_training.tiny import write_tiny


def _sample(boxes, classes, visible=None, kind="scene", **more):
    boxes = np.array(boxes, np.float32).reshape(-1, 4)
    seen = np.ones(len(boxes), np.float32) if visible is None else np.array(visible, np.float32)
    where = Path("x.jpg")
    return Sample(where, 640, 480, kind, (), boxes, np.array(classes, np.int64), seen, **more)


@given(value=st.floats(0, 1e4))
def test_every_value_is_in_the_bin_that_is_named_after_its_ends(value):
    """The lower end belongs to a bin, the upper one to the next."""
    name = bin_name(value, SIZES_PX)
    if name.startswith(">"):
        assert value >= float(name[1:])
    else:
        low, high = map(float, name.split("-"))
        assert low <= value < high


def test_pictures_are_grouped_by_what_their_labels_say():
    """Negatives are in no bin; a picture without a distance is in one of size alone."""
    made = [
        _sample([[0, 0, 30, 30]], [0], distance_m=2.5, recipe="far"),
        _sample([[0, 0, 100, 90]], [0]),
        _sample([], [], kind="negative"),
    ]
    found = groups(made)
    assert found[By.CONDITION] == {"all": [0, 1, 2], "negative": [2]}
    assert found[By.RECIPE] == {"far": [0]}
    assert found[By.DISTANCE] == {"2-3": [0]}
    assert found[By.SIZE] == {"28-40": [0], "80-160": [1]}


def test_boxes_of_two_targets_are_told_apart_where_levels_are_missing():
    """By who lies in whom, not by their order."""
    sample = _sample(
        [[130, 10, 150, 30], [20, 20, 80, 80], [0, 0, 100, 100], [40, 40, 60, 60]], [1, 1, 0, 2]
    )
    assert true_targets(sample) == [[2, 1, 3], [0]]
    candidate = Candidate({Level.BETTER: Box(131, 10, 150, 30, 0.9)}, 0.5)
    outcome = candidate_outcome(sample, (candidate,), Counting())
    assert outcome.counts.tolist() == [True, True]
    assert outcome.overlaps[0, 0] == 0
    assert outcome.overlaps[0, 1] > 0.9


@pytest.mark.parametrize(
    ("counting", "counts"),
    [
        (Counting(14, 0.5), [True]),
        (Counting(31, 0.5), [False]),
        (Counting(14, 0.9), [False]),
        (Counting(0, 0.0), [True]),
    ],
)
def test_what_counts_can_be_chosen(counting, counts):
    """A board of 30 px of which 60 % are to be seen."""
    sample = _sample([[0, 0, 30, 30], [4, 4, 26, 26]], [0, 1], [0.6, 0.6])
    assert candidate_outcome(sample, (), counting).counts.tolist() == counts


@pytest.mark.parametrize("numbers", [(-1.0, 0.5), (float("nan"), 0.5), (14.0, 1.5)])
def test_counting_refuses_numbers_that_make_no_sense(numbers):
    """And names the option."""
    with pytest.raises(EvaluationError, match="--min-"):
        Counting(*numbers)


@pytest.fixture
def finds(tmp_path):
    """The tiny set, looked at by one that misses the first target and sees one beside the last."""
    folder = tmp_path / "tiny"
    folder.mkdir()
    samples = load_dataset(write_tiny(folder))
    answers = iter(samples)

    def detect(picture):
        sample = next(answers)
        if sample is samples[0]:
            return Detections(dict.fromkeys(Level, ()))
        rows = zip(Level, sample.boxes.tolist(), strict=True)
        return Detections({level: (Box(*box, 0.9),) for level, box in rows})

    found = run_detector(detect, samples, load_target())
    ghost = Candidate({Level.GOOD: Box(5, 5, 30, 30, 0.8)}, 0.8)
    last = type(found[-1])(found[-1].sample, found[-1].detections, (*found[-1].candidates, ghost))
    return (*found[:-1], last)


def test_the_worst_cases_are_the_false_target_and_the_miss(finds):
    """Both, with what and where in the caption, and the page has a tile for each."""
    cases = worst_cases(finds, Counting())
    assert [(c.what, c.find.sample.image.stem) for c in cases] == [
        ("false", "000003"),
        ("miss", "000000"),
    ]
    assert cases[0].caption == "false score 0.80: far"
    assert cases[1].caption == "miss 80 px: far"
    assert page(cases).shape[2] == 3
    assert page(()).std() > 0  # says that there is nothing
    assert len(worst_cases(finds, Counting(), most=1)) == 1


def test_a_report_is_a_whole_folder(finds, tmp_path):
    """Numbers, tables, four figures, the worst cases; no part files."""
    report = score(finds, resamples=20)
    write_report(tmp_path / "report", report, finds, {"weights": "w"})
    names = {str(p.relative_to(tmp_path / "report")) for p in (tmp_path / "report").rglob("*")}
    assert names == {
        "report.json",
        "report.md",
        "pr_curves.png",
        "recall_by_distance.png",
        "recall_by_size.png",
        "worst.png",
        "worst",
        "worst/01-false-000003.png",
        "worst/02-miss-000000.png",
    }
    plain = json.loads((tmp_path / "report/report.json").read_text())
    recall = plain["rows"]["all"]["candidate"]["recall"]
    assert recall["value"] == 0.75
    assert recall["low"] < 0.75 < recall["high"]
    assert plain["by_board_px"]["80-160"]["candidate"]["truths"] == 4
    text = (tmp_path / "report/report.md").read_text()
    assert "| all | candidate | 4 | 4 | 0.750 [" in text
    assert "000000.jpg: miss 80 px: far" in text
    assert not list(tmp_path.glob("*.part"))


def test_a_report_never_replaces_what_is_there(finds, tmp_path):
    """Nothing is written then."""
    (tmp_path / "report").mkdir()
    (tmp_path / "report/mine").touch()
    with pytest.raises(DatasetError, match="holds something already"):
        write_report(tmp_path / "report", score(finds, resamples=5), finds, {})
    assert [p.name for p in (tmp_path / "report").iterdir()] == ["mine"]


def _recording(folder, visible):
    (folder / "rgb").mkdir(parents=True)
    lines, truth = ["# time file"], []
    for k, share in enumerate(visible):
        cv2.imwrite(str(folder / f"rgb/{k}.png"), np.full((64, 64, 3), 40 * (share > 0), np.uint8))
        lines.append(f"{1000 + k / 10:.6f} rgb/{k}.png")
        truth.append({"t": 1000 + k / 10, "visible": share})
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n")
    (folder / "truth.json").write_text(json.dumps(truth))
    return folder


def test_intervals_in_view_are_where_the_board_is_to_be_seen(tmp_path):
    """Two of them, from half a frame before to half a frame after; nothing is found elsewhere."""
    frames = load_recording(_recording(tmp_path / "r", [0, 0, 1, 1, 0.2, 0, 0.9, 1]))
    run = fly_by(lambda rgb: Detections({}), frames, load_target())
    assert intervals_in_view(run) == [
        pytest.approx((0.15, 0.35)),
        pytest.approx((0.55, 0.75)),
    ]
    assert run.as_json() == {
        "frames": 8,
        "in_view": 4,
        "found_in_view": 0,
        "found_out_of_view": 0,
        "detections": {level.value: 0 for level in Level},
    }
    assert plot_fly_by(run, "r").startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda r: (r / "truth.json").unlink(), "has no truth.json or targets.json"),
        (lambda r: (r / "truth.json").write_text("[{}]"), "truth.json: an entry lacks t"),
        (lambda r: (r / "truth.json").write_text("{"), "truth.json: Expecting"),
        (lambda r: (r / "rgb.txt").write_text("x\n"), "rgb.txt line 1: want 'seconds file'"),
        (lambda r: (r / "rgb.txt").write_text("5 rgb/0.png\n"), "no frame is within 0.02 s"),
        (lambda r: (r / "rgb.txt").unlink(), "rgb.txt: No such file"),
        (lambda r: (r / "rgb/0.png").write_bytes(b"no"), "0.png cannot be decoded"),
    ],
)
def test_a_recording_that_cannot_be_used_is_named(spoil, says, tmp_path):
    """The file, and the line where it is a list."""
    recording = _recording(tmp_path / "r", [1, 1])
    spoil(recording)
    with pytest.raises(EvaluationError, match=says):
        fly_by(lambda rgb: Detections({}), load_recording(recording), load_target())


APP = typer.Typer()
evaluate.register(APP)
APP.command("other")(lambda: None)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--min-px", "-3"), "--min-px -3.0"),
        (("--fp-per-1000", "-1"), "--fp-per-1000 -1"),
        (("--fly-by", "plot.pdf"), "must end in .png"),
        (("--fly-by", "plot.png", "--out", "x"), "leave out --out"),
        (("--engine", "abacus"), "engine 'abacus'"),
    ],
)
def test_options_that_make_no_sense_are_one_line_and_exit_code_2(options, says, tmp_path):
    """And nothing is written."""
    folder = tmp_path / "tiny"
    folder.mkdir()
    arguments = ["evaluate", str(DEFAULT_WEIGHTS), str(write_tiny(folder)), *options]
    result = CliRunner().invoke(APP, arguments)
    assert result.exit_code == 2
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
