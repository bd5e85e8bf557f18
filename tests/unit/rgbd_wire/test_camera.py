"""The camera model and its JSON: bounds, one-line errors that name the field, round trip."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.camera import (
    MAX_CAMERA_JSON_BYTES,
    CameraIntrinsics,
    RgbdCamera,
    camera_from_json,
    load_camera,
)
from rgbd_wire.errors import CameraFileError, GeometryError
from rgbd_wire.geometry import Pose

GOOD = {
    "color": {"width": 640, "height": 480, "fx": 600.0, "fy": 601.0, "cx": 319.5, "cy": 240},
    "depth": {
        "width": 848,
        "height": 480,
        "fx": 420.0,
        "fy": 420.0,
        "cx": 424.0,
        "cy": 240.0,
        "model": "brown_conrady",
        "coefficients": [0.1, -0.05, 0.001, -0.002, 0.0],
    },
    "depth_scale_m": 0.001,
    "depth_lattice_m": 1276.8,
    "color_from_depth": {"translation_m": [-0.059, 0.0, 0.0004], "q_wxyz": [1, 0, 0, 0]},
}


def changed(*path, to):
    """The good camera JSON with one value replaced; ``to=...`` (Ellipsis) takes it out."""
    raw = copy.deepcopy(GOOD)
    node = raw
    for key in path[:-1]:
        node = node[key]
    if to is ...:
        del node[path[-1]]
    else:
        node[path[-1]] = to
    return json.dumps(raw)


def complaint_of(text):
    with pytest.raises(CameraFileError) as caught:
        camera_from_json(text)
    return str(caught.value)


def test_good_json():
    """Every field lands where it belongs."""
    camera = camera_from_json(json.dumps(GOOD))
    assert camera.color == CameraIntrinsics(640, 480, 600.0, 601.0, 319.5, 240.0)
    assert camera.depth.model == "brown_conrady"
    assert camera.depth.coefficients == (0.1, -0.05, 0.001, -0.002, 0.0)
    assert (camera.depth_scale_m, camera.depth_lattice_m) == (0.001, 1276.8)
    np.testing.assert_array_equal(camera.color_from_depth.translation, [-0.059, 0.0, 0.0004])
    assert not camera.aligned


def test_only_the_colour_camera_and_the_scale_are_required():
    """Without a depth camera the depth picture lies on the colour pixels."""
    camera = camera_from_json(json.dumps({"color": GOOD["color"], "depth_scale_m": 0.0002}))
    assert camera.aligned
    assert camera.depth == camera.color
    assert camera.depth_lattice_m == 0.0


def test_k_maps_the_axis_to_the_centre():
    """``image_from_camera`` projects a point to u = fx x/z + cx, v = fy y/z + cy."""
    camera = CameraIntrinsics(640, 480, 600.0, 610.0, 319.5, 239.5)
    u, v, w = camera.image_from_camera @ [0.5, -0.25, 2.0]
    assert (u / w, v / w) == (600 * 0.25 + 319.5, -610 * 0.125 + 239.5)


intrinsics = st.builds(
    lambda w, h, f, c, model, ks: CameraIntrinsics(
        w, h, f * max(w, h), 1.01 * f * max(w, h), c * w, (1 - c) * h, model, tuple(ks)
    ),
    st.integers(1, 4096),
    st.integers(1, 2048),
    st.floats(0.1, 90),
    st.floats(-1, 2),
    st.sampled_from(["none", "brown_conrady", "inverse_brown_conrady"]),
    st.lists(st.floats(-100, 100), min_size=5, max_size=5),
)


@given(
    intrinsics,
    intrinsics,
    st.floats(1e-5, 0.1),
    st.floats(0, 1e5),
    st.lists(st.floats(-10, 10), min_size=3, max_size=3),
)
def test_json_round_trip(color, depth, scale_m, lattice_m, t):
    """What ``to_json`` writes, ``camera_from_json`` reads: the same camera to the last bit.

    A lens without a model has no coefficients to carry.
    """
    pose = Pose(np.array(t), np.array([0.5, -0.5, 0.5, -0.5]))
    camera = RgbdCamera(color, depth, scale_m, pose, lattice_m)
    again = camera_from_json(json.dumps(camera.to_json()))
    assert again.to_json() == camera.to_json()
    for name in ("color", "depth"):
        was, now = getattr(camera, name), getattr(again, name)
        assert (was.width, was.height, was.fx, was.model) == (
            now.width,
            now.height,
            now.fx,
            now.model,
        )
        if was.model != "none":
            assert was.coefficients == now.coefficients


@pytest.mark.parametrize(
    ("path", "to"),
    [
        *[(("color", k), ...) for k in GOOD["color"]],
        *[(("color", "width"), w) for w in (0, -640, 4097, 640.0, "640", True, None, 10**300)],
        *[(("depth", "height"), h) for h in (0, 4097, [480])],
        *[
            (("color", "fx"), f)
            for f in (0, -600.0, 1.0, 1e6, float("nan"), float("inf"), "600", True, None, 10**400)
        ],
        (("depth", "fy"), 0.0),
        (("depth", "fy"), float("nan")),
        (("color", "cx"), 1e7),
        (("color", "cy"), -float("inf")),
        (("depth", "model"), "fisheye"),
        (("depth", "model"), ["none"]),
        (("depth", "model"), "none\nmodel"),
        (("depth", "coefficients"), [0.0] * 4),
        (("depth", "coefficients"), 0.1),
        (("depth", "coefficients"), [0.0, 0.0, 0.0, 0.0, 101.0]),
        (("depth", "coefficients"), [0.0, 0.0, 0.0, 0.0, float("nan")]),
        (("depth_scale_m",), ...),
        *[(("depth_scale_m",), s) for s in (0, 1.0, -0.001, "1mm", float("nan"), None)],
        *[(("depth_lattice_m",), a) for a in (-1.0, 1e6, float("inf"), "1276.8", [])],
        (("color_from_depth",), [0, 0, 0]),
        (("color_from_depth", "q_wxyz"), ...),
        (("color_from_depth", "q_wxyz"), [1, 0, 0]),
        (("color_from_depth", "q_wxyz"), [0, 0, 0, 0]),
        (("color_from_depth", "q_wxyz"), [2, 0, 0, 0]),
        (("color_from_depth", "q_wxyz"), [float("nan"), 0, 0, 0]),
        (("color_from_depth", "q_wxyz"), ["1", "0", "0", "0"]),
        (("color_from_depth", "translation_m"), [[0], [0], [0]]),
        (("color_from_depth", "translation_m"), [59, 0, 0]),  # millimetres
        (("color_from_depth", "translation_m"), "left"),
    ],
)
def test_each_error_names_its_field_on_one_line(path, to):
    """Whoever wrote the file learns where to look, and the terminal is not flooded."""
    complaint = complaint_of(changed(*path, to=to))
    assert path[0] in complaint
    assert "\n" not in complaint
    assert len(complaint) < 250
    if path[0] != "color_from_depth":
        assert path[-1] in complaint or "distortion" in complaint


@pytest.mark.parametrize("key", ["colour", "two\nlines", "x" * 10_000])
def test_an_unknown_field_is_named_and_the_known_ones_listed(key):
    """A typing mistake is no silently ignored setting."""
    complaint = complaint_of(changed(key, to=1))
    assert "unknown" in complaint
    assert "depth_lattice_m" in complaint
    assert "\n" not in complaint
    assert len(complaint) < 250


@pytest.mark.parametrize("lacking", ["depth", "color_from_depth"])
def test_a_depth_camera_and_its_place_come_together(lacking):
    """One without the other cannot be aligned."""
    assert "belong together" in complaint_of(changed(lacking, to=...))


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", "3", '"color"', b"\xff\xfe\xfd", "[" * 50_000, "NaN", '{"a": 1}'],
)
def test_what_is_no_camera_json_at_all(text):
    """Empty, cut off, of another shape, not UTF-8, nested without end: one line each."""
    complaint = complaint_of(text)
    assert "\n" not in complaint
    assert len(complaint) < 250


def test_a_huge_file_is_not_read():
    """The size is looked at first."""
    assert str(MAX_CAMERA_JSON_BYTES) in complaint_of(" " * (MAX_CAMERA_JSON_BYTES + 1))


scalars = st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5)
json_values = (
    scalars | st.lists(scalars, max_size=7) | st.dictionaries(st.text(max_size=3), scalars)
)


@given(
    st.sampled_from(
        [(k,) for k in GOOD]
        + [("color", k) for k in GOOD["color"]]
        + [("depth", "model"), ("depth", "coefficients")]
        + [("color_from_depth", k) for k in GOOD["color_from_depth"]]
    ),
    json_values,
)
def test_any_value_anywhere_is_read_or_refused(path, value):
    """Nothing but ``CameraFileError`` comes out, whatever stands in a field."""
    complaint = ""
    try:
        camera_from_json(changed(*path, to=value))
    except CameraFileError as error:
        complaint = str(error)
    assert "\n" not in complaint


def test_load_camera_says_which_file(tmp_path):
    """A missing file, a folder and a bad file: the path and the reason, on one line."""
    bad = tmp_path / "camera.json"
    bad.write_text(changed("color", "fx", to=0), encoding="utf-8")
    for path, why in (
        (tmp_path / "none.json", "No such file"),
        (tmp_path, "directory"),
        (bad, "fx"),
    ):
        with pytest.raises(CameraFileError) as caught:
            load_camera(path)
        assert str(path) in str(caught.value)
        assert why in str(caught.value)


def test_load_camera_reads_a_file(tmp_path):
    """A good file gives its camera."""
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(GOOD), encoding="utf-8")
    assert load_camera(path).color.width == 640


def test_the_largest_picture():
    """Sides up to 4096 px, eight megapixels in all."""
    CameraIntrinsics(4096, 2048, 4000.0, 4000.0, 2048.0, 1024.0)
    with pytest.raises(GeometryError, match="pixels"):
        CameraIntrinsics(4096, 2049, 4000.0, 4000.0, 2048.0, 1024.0)


@pytest.mark.parametrize(
    ("t", "q", "aligned"),
    [
        ((0, 0, 0), (1, 0, 0, 0), True),
        ((0, 0, 0), (-1, 0, 0, 0), True),
        ((1e-3, 0, 0), (1, 0, 0, 0), False),
        ((0, 0, 0), (np.cos(1e-3), np.sin(1e-3), 0, 0), False),
    ],
)
def test_aligned_means_the_same_camera_in_the_same_place(t, q, aligned):
    """Depth lies on the colour pixels only if nothing moves and the lens is the same."""
    lens = CameraIntrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)
    other = CameraIntrinsics(640, 480, 601.0, 600.0, 320.0, 240.0)
    pose = Pose(np.array(t, float), np.array(q, float))
    assert RgbdCamera(lens, lens, 0.001, pose).aligned is aligned
    assert not RgbdCamera(lens, other, 0.001, pose).aligned
