"""Target files: what they say, and that a wrong one is told in one sentence."""

import math
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.geometry import Pose
from target_pose.candidate import Box, Candidate
from target_pose.errors import TargetFileError
from target_pose.localisation import Localisation
from target_pose.localise import localise
from target_pose.target import (
    MIN_CONTRAST,
    Level,
    Shade,
    Target,
    load_target,
    packaged_targets,
    parse_target,
    target_file,
)
from tests.unit.target_pose.render import (
    Look,
    facing_pose,
    render_color,
    render_depth,
    true_box,
)

TEXT = target_file("bullseye-400").read_text()
WORDS = st.sampled_from(
    ["name", "board", "discs", "levels", "colours", "side_m", "shade", "diameter_m", "black", "x"]
)
VALUES = st.recursive(
    st.sampled_from(
        ["0.3", "1e400", "-inf", "nan", "1" * 400, "true", '"black"', '"#000000"', "1979-05-27"]
    ),
    lambda inner: (
        st.lists(inner, max_size=3).map(lambda v: f"[{', '.join(v)}]")
        | st.dictionaries(WORDS, inner, max_size=3).map(
            lambda d: "{" + ", ".join(f"{k} = {v}" for k, v in d.items()) + "}"
        )
    ),
    max_leaves=6,
)


def refused_or_target(text):
    """What the text describes, or None when it was refused in the way that it should be."""
    try:
        target = parse_target(text)
    except TargetFileError:
        return None
    assert isinstance(target, Target)
    return target


@given(st.text())
def test_any_text_is_a_target_or_refused(text):
    """Whatever a file holds, the answer is a target or the one error."""
    refused_or_target(text)


@given(st.data())
def test_a_damaged_file_is_a_target_or_refused(data):
    """A line of a good file replaced by anything that is TOML: a target or the one error."""
    lines = TEXT.splitlines()
    at = data.draw(st.integers(0, len(lines) - 1))
    lines[at] = f"{data.draw(WORDS)} = {data.draw(VALUES)}"
    target = refused_or_target("\n".join(lines))
    if target is not None:
        sizes = [target.board_side_m, *(d.diameter_m for d in target.discs)]
        assert sizes == sorted(sizes, reverse=True)
        assert all(math.isfinite(s) for s in sizes)


@given(st.dictionaries(WORDS, VALUES, max_size=6))
def test_tables_of_anything_are_refused(tables):
    """TOML with our keys and other values is refused without another exception."""
    refused_or_target("\n".join(f"{k} = {v}" for k, v in tables.items()))


@given(st.integers(0, 0xFFFFFF), st.integers(0, 0xFFFFFF))
def test_colours_are_kept_or_too_alike(black, white):
    """A pair of colours is refused exactly where its contrast, from 8-bit tables, is too low."""

    def luminance(colour):
        parts = [(colour >> shift & 255) / 255 for shift in (16, 8, 0)]
        linear = [p / 12.92 if p < 0.04045 else math.pow((p + 0.055) / 1.055, 2.4) for p in parts]
        return sum(w * p for w, p in zip((0.2126, 0.7152, 0.0722), linear, strict=True))

    text = f'{TEXT}\n[colours]\nblack = "#{black:06x}"\nwhite = "#{white:06X}"\n'
    target = refused_or_target(text)
    contrast = (luminance(white) + 0.05) / (luminance(black) + 0.05)
    assert (target is not None) == (contrast >= MIN_CONTRAST)
    if target is not None:
        assert target.colours == {Shade.BLACK: f"#{black:06x}", Shade.WHITE: f"#{white:06x}"}


def test_packaged_targets():
    """Every packaged target loads, is named as its file, and is black and white by default."""
    assert packaged_targets() == ("bullseye-200", "bullseye-400")
    for name in packaged_targets():
        target = load_target(name)
        assert target.name == name
        assert target.colours == {Shade.BLACK: "#000000", Shade.WHITE: "#ffffff"}


def test_the_small_one_is_half_of_the_large_one():
    """bullseye-200 is bullseye-400 with every length halved, so the detector knows it."""
    small, large = load_target("bullseye-200"), load_target("bullseye-400")
    assert 2 * small.board_side_m == large.board_side_m
    assert [2 * d.diameter_m for d in small.discs] == [d.diameter_m for d in large.discs]
    assert [d.shade for d in small.discs] == [d.shade for d in large.discs]
    assert {lv: 2 * small.level_m[lv] for lv in Level} == large.level_m


@pytest.mark.parametrize("depth", [True, False])
def test_half_the_target_is_found_at_half_the_distance(depth):
    """No stage assumes 0.4 m: the same picture read as the small target gives half the distance."""
    small, large = load_target("bullseye-200"), load_target("bullseye-400")
    camera = CameraIntrinsics(320, 240, 300.0, 300.0, 161.0, 119.0)
    found = []
    for target, scale in ((large, 1.0), (small, 0.5)):
        rig = RgbdCamera(camera, camera, 0.0005 * scale, Pose(np.zeros(3), [1.0, 0, 0, 0]))
        pose = facing_pose(scale * np.array([0.1, -0.05, 1.2]), 0.5, 0.8, 0.1)
        look = Look(wall_gap_m=0.3 * scale)
        boxes = {
            level: Box(
                *true_box(target, pose, camera, target.level_m[level], level is Level.GOOD), 0.9
            )
            for level in Level
        }
        units = render_depth(target, rig, pose, look) if depth else None
        color = render_color(target, camera, pose, look)
        answer = localise(color, units, rig, Candidate(boxes, 0.9), target)
        assert isinstance(answer, Localisation), answer
        found.append(answer.camera_from_target)
        assert found[-1].translation == pytest.approx(pose.translation, rel=0.02)
    assert 2 * found[1].translation == pytest.approx(found[0].translation, rel=0.01)
    assert found[1].rotation == pytest.approx(found[0].rotation, abs=0.02)


@pytest.mark.parametrize(
    ("extra", "told"),
    [
        ('[colors]\nblack = "#000000"', "unknown 'colors'"),
        ('[colours]\nred = "#ff0000"', "unknown 'red'"),
        ('[colours]\nblack = "black"', "colours.black must be sRGB"),
        ("[colours]\nwhite = 255", "colours.white must be sRGB"),
        ('[colours]\nblack = "#ffffff"\nwhite = "#000000"', "must be clearly darker"),
        ('[colours]\nblack = "#909090"', "contrast is 3.2"),
    ],
)
def test_wrong_colours_are_told(extra, told):
    """A colour that is misspelt or too light is named."""
    with pytest.raises(TargetFileError, match=told):
        parse_target(f"{TEXT}\n{extra}\n")


def test_deep_nesting_is_refused():
    """A file that nests thousands of arrays is refused, not a crash."""
    with pytest.raises(TargetFileError, match="deep"):
        parse_target("a = " + "[" * 20_000 + "]" * 20_000)


def test_the_file_is_named(tmp_path):
    """What is wrong comes with the file that it is in."""
    path = tmp_path / "mine.toml"
    with pytest.raises(TargetFileError, match=r"mine\.toml: No such file"):
        load_target(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(TargetFileError, match=r"mine\.toml"):
        load_target(path)
    with pytest.raises(TargetFileError, match="packaged: bullseye-200, bullseye-400"):
        load_target("bullseye-999")
    with pytest.raises(TargetFileError, match="embedded null"):
        load_target("a\0.toml")
    raw = tomllib.loads(TEXT)
    assert load_target().name == raw["name"]
