"""Keep-outs as a user writes them: what is right is taken, what is wrong is named."""

from __future__ import annotations

import contextlib
import inspect
import math
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.cbf import KeepOut, PlaneFrame, keep_outs_from
from drone_client.cbf import keep_out_table as module

EXAMPLE = inspect.cleandoc(module.__doc__.split("::", 1)[1])
PART = {"name": "body", "center_body_m": [0, 0, 0.0], "radius_m": 0.2}


def test_the_example_of_the_module_is_read() -> None:
    """Two planes: the board's for all parts with every default, and a floor of the world."""
    wall, floor = keep_outs_from(tomllib.loads(EXAMPLE))
    assert wall == KeepOut("wall", wall.parts)
    assert (floor.frame, floor.normal, floor.offset_m) == (PlaneFrame.WORLD, (0.0, 0.0, 1.0), -0.1)
    (part,) = floor.parts
    assert part.center_body == (0.2, 0.2, 0.06)
    assert (part.radius_m, part.axis_body) == (0.19, (0.0, 0.0, 1.0))


def test_no_tables_are_no_keep_outs() -> None:
    """Neither planes nor parts are needed."""
    assert keep_outs_from({}) == ()
    assert keep_outs_from({"part": [PART]}) == ()


def test_a_direction_may_have_any_length() -> None:
    """It is the direction that counts."""
    (wall,) = keep_outs_from({"part": [PART], "keep_out": [{"name": "w", "normal": [3, 0, 4]}]})
    assert wall.normal == pytest.approx((0.6, 0.0, 0.8))


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"name": ""}, "1 to 40 characters"),
        ({"name": "a\x1bb"}, "1 to 40 characters"),
        ({"radius_m": "wide"}, "part 'body': radius_m = 'wide' must be a number"),
        ({"radius_m": True}, "must be a number"),
        ({"radius_m": math.nan}, "radius_m = nan is not within"),
        ({"radius_m": -0.1}, "part 'body': .*radius_m = -0.1 is not in"),
        ({"center_body_m": [0, 0]}, "must be three numbers"),
        ({"center_body_m": None}, "must be three numbers"),
        ({"center_body_m": [9, 0, 0]}, "center_body"),
        ({"axis_body": [0, 0, 0]}, "has no direction"),
        ({"colour": "red"}, "unknown 'colour'; known: name, center_body_m"),
    ],
)
def test_a_wrong_part_is_named(part, message) -> None:
    """With its name, the field and what it may be."""
    with pytest.raises(ValueError, match=message):
        keep_outs_from({"part": [PART | part]})


@pytest.mark.parametrize(
    ("keep_out", "message"),
    [
        ({"parts": ["arm"]}, r"keep_out 'wall': parts has 'arm'; known: body"),
        ({"parts": "body"}, "parts has 'body'"),
        ({"parts": ["body", ["body"]]}, r"parts has \['body'\]"),
        ({"parts": []}, "0 parts"),
        ({"frame": "moon"}, "must be target or world"),
        ({"normal": [0, 0]}, "three numbers"),
        ({"offset_m": math.inf}, "offset_m = inf is not within"),
        ({"clearance_m": 5.0}, "clearance_m = 5.0 is not in"),
        ({"height": 1}, "unknown 'height'"),
    ],
)
def test_a_wrong_plane_is_named(keep_out, message) -> None:
    """With its name, the field and what it may be."""
    with pytest.raises(ValueError, match=message):
        keep_outs_from({"part": [PART], "keep_out": [{"name": "wall"} | keep_out]})


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"part": [PART, PART]}, "'body' is there twice"),
        ({"part": PART}, r"must be a list of tables, \[\[part\]\]"),
        ({"part": [1]}, "list of tables"),
        ({"part": [PART | {"name": str(i)} for i in range(33)]}, "at most 32"),
        ({"keep_out": [{"name": str(i)} for i in range(7)]}, "at most 6"),
        ({"keep_out": [{"name": "wall"}]}, "0 parts"),
    ],
)
def test_wrong_tables_are_named(tables, message) -> None:
    """Twice the same, no list, too many, or a plane without parts."""
    with pytest.raises(ValueError, match=message):
        keep_outs_from(tables)


junk = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=10,
)
parts = st.dictionaries(st.sampled_from(["radius_m", "center_body_m", "axis_body"]), junk)
planes = st.dictionaries(st.sampled_from(["normal", "parts", "frame", "offset_m"]), junk)
parts = st.lists(parts.map(lambda changes: PART | changes), max_size=2)
planes = st.lists(planes.map(lambda changes: {"name": "wall"} | changes), max_size=2)


@given(st.fixed_dictionaries({"part": st.just([PART]) | parts | junk, "keep_out": planes | junk}))
def test_whatever_is_written_there_is_an_answer_or_a_reason(tables) -> None:
    """Keep-outs, or a ValueError; never another error."""
    with contextlib.suppress(ValueError):
        assert isinstance(keep_outs_from(tables), tuple)
