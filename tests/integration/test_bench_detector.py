"""The detector's bench with tiny counts: it compares like with like, and keeps what it renders."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from detector_training.scenes.printed import Paint
from detector_training.scenes.recipe import Recipe
from tests.perf import bench_detector
from tests.perf.bench_detector_markers import FINDERS, is_found
from tests.perf.bench_detector_prints import APRILTAG, ARUCO, BLANK, OURS, PRINTS
from tests.perf.bench_detector_real import painted_over
from tests.perf.bench_detector_scenes import SceneSet, rendered, test_backgrounds
from tests.perf.bench_detector_speed import PLAIN, Times, _row, measure
from tests.perf.bench_detector_table import report_text

PAINT = Paint(np.full(3, 0.8, np.float32), np.full(3, 0.05, np.float32))
MARKERS = (APRILTAG, ARUCO)
test_backgrounds.__test__ = False  # its name is what it gives


def _finder(name):
    if name == APRILTAG:
        pytest.importorskip("pupil_apriltags")
    return FINDERS[name]()


@pytest.mark.parametrize("name", MARKERS)
@pytest.mark.parametrize("side_px", [8, 10, 64, 301])
def test_a_marker_has_a_white_margin_and_both_paints(name, side_px):
    """At any size, in the paints that it is given, with a mean that does not hang on the size."""
    albedo = PRINTS[name](side_px, PAINT)
    assert albedo.shape == (side_px, side_px, 3)
    assert albedo.dtype == np.float32
    assert albedo.min() >= 0.05 - 1e-6
    assert albedo.max() <= 0.8 + 1e-6
    modules = PRINTS[name].modules()
    assert (modules[[0, -1]] == 1).all()
    assert (modules[:, [0, -1]] == 1).all()
    want = 0.05 + 0.75 * modules.mean()
    assert albedo.mean() == pytest.approx(want, abs=0.01)


@pytest.mark.parametrize("name", MARKERS)
def test_a_marker_is_found_by_its_own_library_and_nothing_on_a_blank_board(name):
    """Head-on, at its true centre."""
    find = _finder(name)
    picture = np.full((480, 640, 3), 120, np.uint8)
    picture[100:300, 200:400] = np.rint(PRINTS[name](200, PAINT) * 255).astype(np.uint8)
    assert find(picture) == pytest.approx(np.array([[299.5, 199.5]]), abs=1.0)
    picture[100:300, 200:400] = np.rint(PRINTS[BLANK](200, PAINT) * 255).astype(np.uint8)
    assert len(find(picture)) == 0


def _render(tmp_path, printed, count=2, recipe=Recipe.NOMINAL):
    backgrounds = test_backgrounds(tmp_path, ())
    return rendered(SceneSet(recipe, printed, 5, count), tmp_path / "cache", backgrounds, 1)


def test_prints_share_pose_light_and_background(tmp_path):
    """The labels are the same; away from the board the pictures differ by JPEG alone."""
    sets = {name: _render(tmp_path, name) for name in PRINTS}
    for name in (*MARKERS, BLANK):
        for ours, theirs in zip(sets[OURS], sets[name], strict=True):
            assert (ours.boxes == theirs.boxes).all()
            assert ours.conditions == theirs.conditions
            x0, y0, x1, y1 = ours.boxes[0].round().astype(int)
            away = np.ones((ours.height, ours.width), bool)
            away[max(0, y0 - 24) : y1 + 24, max(0, x0 - 24) : x1 + 24] = False
            gap = np.abs(ours.read()[away].astype(int) - theirs.read()[away])
            assert np.median(gap) <= 1


def test_what_was_rendered_is_kept_and_more_goes_on_from_there(tmp_path):
    """The same files, untouched; a picture that is missing is rendered again, to the same bytes."""
    first = _render(tmp_path, OURS)
    before = [(s.image.read_bytes(), s.image.stat().st_mtime_ns) for s in first]
    more = _render(tmp_path, OURS, count=3)
    assert [(s.image.read_bytes(), s.image.stat().st_mtime_ns) for s in more[:2]] == before
    (first[0].image.parent.parent / "labels/000000.json").unlink()
    again = _render(tmp_path, OURS)
    assert [s.image.read_bytes() for s in again] == [b for b, _ in before]


def test_found_means_near_the_true_centre(tmp_path):
    """A quarter of the board's side is the limit."""
    sample = _render(tmp_path, OURS, count=1)[0]
    side = float(np.sqrt(np.prod(sample.boxes[0, 2:] - sample.boxes[0, :2])))
    centre = (sample.boxes[-1, :2] + sample.boxes[-1, 2:]) / 2
    assert is_found(sample, np.array([centre + (0.24 * side, 0)]))
    assert not is_found(sample, np.array([centre + (0.26 * side, 0)]))
    assert not is_found(sample, np.zeros((0, 2)))


def test_painting_over_removes_the_target_and_leaves_the_rest():
    """A black square on grey."""
    picture = np.full((120, 160, 3), 128, np.uint8)
    picture[40:80, 60:100] = 0
    bare = painted_over(picture, [60.0, 40.0, 100.0, 80.0])
    assert (np.abs(bare.astype(int) - 128) <= 2).all()


def test_ratio_and_percentiles_are_of_the_rounds():
    """Twice as fast in one round, four times in the other."""
    plain = Times({}, [10.0, 40.0], [], [10.0, 40.0])
    row = _row("x", Times({}, [5.0, 10.0], [6.0, 12.0], [5.0, 10.0]), plain)
    assert (row.ratio, row.ratio_low, row.ratio_high) == (3.0, 2.0, 4.0)
    assert (row.net_p50_ms, row.detect_p50_ms) == (7.5, 9.0)


def test_an_engine_that_does_not_start_is_told_and_the_others_go_on(capfd):
    """Each engine is a process: one may fail."""
    rows, failed = measure(("abacus",), None, rounds=2, pictures=1)
    capfd.readouterr()
    assert [r.engine for r in rows] == [PLAIN]
    assert rows[0].ratio == 1.0
    assert rows[0].about["precision"] == "fp32"
    assert failed == ["abacus did not start: exit status 1"]


@pytest.mark.timeout(600)
def test_the_whole_bench_writes_its_table(tmp_path, monkeypatch, capsys):
    """Two pictures of each, JSON on the output and Markdown in the file, verdicts in it."""
    for name in ("pupil_apriltags", "onnxruntime", "openvino"):
        if not _is_installed(name):
            pytest.skip(f"{name} is not installed")
    out = tmp_path / "detector.md"
    options = ["--count", "2", "--negatives", "3", "--rounds", "1", "--pictures-a-round", "1"]
    options += ["--cache", str(tmp_path / "cache"), "--package-root", str(tmp_path), "--jobs", "1"]
    monkeypatch.setattr(sys, "argv", ["bench", *options, "--json", "--out", str(out)])
    bench_detector.main()
    result = json.loads(capsys.readouterr().out)
    assert set(result["recall"]["conditions"]) == {
        "nominal", "blur", "low_light", "obstruction", "distortion", "far", "orientation",
        "flare", "close", "over_exposed", "glossy", "scratched",
    }  # fmt: skip
    assert result["recall"]["negatives"]["hard negatives"]["pictures"] == 3
    assert result["recall"]["operating_point"]["pictures"] == 2 + 2 + 3
    assert set(result["markers"]["far"]["recall"]) == {OURS, APRILTAG, ARUCO}
    assert [row["engine"] for row in result["speed"]["rows"]][0] == PLAIN
    text = out.read_text()
    assert text == report_text(result)
    assert "| far |" in text
    assert not list(tmp_path.glob("*.part"))


def _is_installed(name):
    import importlib.util

    return importlib.util.find_spec(name) is not None


def test_help_teaches(capsys):
    """What it does, and each option."""
    with pytest.raises(SystemExit) as ended:
        bench_detector.parse(["--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "scripts/bench detector --package-root" in text
    assert "--pictures-a-round" in text
