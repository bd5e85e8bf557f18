"""Truth files, and the errors that are told against them."""

import json
import math

import numpy as np
import pytest
from hypothesis import given

from drone_client import truth
from drone_client.errors import SourceError
from drone_client.truth import load_truth, normal_error_rad, position_error_m
from tests.unit.drone_client.builders import pose, poses, rotation_of

SEEN = pose((0.1, 0.2, 2.0), (0, 1, 0))
GOOD = {"t": 1.0, "camera_from_target": SEEN.matrix.tolist(), "visible": 0.75, "more": 1}


def test_reads_poses_and_visibility(tmp_path):
    """Other fields may stand beside them."""
    path = tmp_path / "truth.json"
    path.write_text(json.dumps([GOOD, {**GOOD, "visible": 0}]))
    first, second = load_truth(path, captures=2)
    np.testing.assert_allclose(first.camera_from_target.matrix, SEEN.matrix, atol=1e-12)
    assert (first.visible, second.visible) == (0.75, 0.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("{}", "must be a list of frames"),
        ("[]", "0 frames, but the recording has 1"),
        (json.dumps([GOOD, GOOD]), "2 frames, but the recording has 1"),
        ("[3]", "frame 0: must hold camera_from_target"),
        (json.dumps([{"visible": 1}]), "frame 0: must hold camera_from_target"),
        (json.dumps([{**GOOD, "visible": None}]), "frame 0: must hold"),
        (json.dumps([{**GOOD, "visible": "much"}]), "frame 0: could not convert"),
        (json.dumps([{**GOOD, "camera_from_target": [[1, 0], [0]]}]), "frame 0: "),
        (json.dumps([{**GOOD, "camera_from_target": np.eye(3).tolist()}]), "(4, 4)"),
        (json.dumps([{**GOOD, "camera_from_target": (2 * np.eye(4)).tolist()}]), "rigid"),
        (json.dumps([{**GOOD, "camera_from_target": [[math.nan] * 4] * 4}]), "finite"),
    ],
)
def test_a_wrong_file_gives_one_line_with_its_name(tmp_path, text, says):
    """With the frame at fault, where it is one."""
    path = tmp_path / "truth.json"
    path.write_text(text)
    with pytest.raises(SourceError) as caught:
        load_truth(path, captures=1)
    assert str(caught.value).startswith(f"truth file {path}: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_or_huge_file_is_not_read(tmp_path, monkeypatch):
    """Bounded before it is read."""
    path = tmp_path / "truth.json"
    with pytest.raises(SourceError, match="No such file"):
        load_truth(path, captures=1)
    path.write_text(json.dumps([GOOD]))
    monkeypatch.setattr(truth, "MAX_TRUTH_BYTES", 10)
    with pytest.raises(SourceError, match="over 10 bytes"):
        load_truth(path, captures=1)


@given(poses, poses)
def test_errors_agree_with_scipy(a, b):
    """Distance of the origins; angle between the x axes, whatever the roll about them."""
    assert position_error_m(a, b) == pytest.approx(math.dist(a.translation, b.translation))
    x_a, x_b = (rotation_of(p).apply((1, 0, 0)) for p in (a, b))
    expected = math.atan2(np.linalg.norm(np.cross(x_a, x_b)), x_a @ x_b)
    assert normal_error_rad(a, b) == pytest.approx(expected, abs=1e-6)
    rolled = b @ pose((0, 0, 0), (1.234, 0, 0))
    assert normal_error_rad(a, rolled) == pytest.approx(expected, abs=1e-6)
