"""The print as shapes: true scale, nothing over the paper's edge, nothing near the discs."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from detector_training.errors import TargetPrintError
from detector_training.targets.drawing import draw
from detector_training.targets.layout import SIZE_MM, Paper, lay_out
from detector_training.targets.reach import reach
from detector_training.targets.shapes import Circle, Line, Polygon, Rectangle, Text
from detector_training.targets.tiles import MAX_PAGES, OVERLAP_MM
from target_pose.target import Disc, Level, Shade, Target, load_target

PAPERS = [paper for paper in Paper if paper is not Paper.FIT]


@st.composite
def targets(draw_, largest_m=10.0):
    """Any target that a file can describe."""
    side = draw_(st.floats(0.02, largest_m))
    shades = [Shade.BLACK, Shade.WHITE]
    first = draw_(st.integers(0, 1))
    shares = sorted(
        draw_(st.lists(st.floats(0.06, 0.99), min_size=1, max_size=8, unique=True)), reverse=True
    )
    discs = tuple(Disc(side * s, shades[(first + i + 1) % 2]) for i, s in enumerate(shares))
    levels = {level: side / 2**i for i, level in enumerate(Level)}
    name = draw_(st.text(min_size=1, max_size=64))
    return Target(name, side, shades[first], discs, levels)


def extent(shape):
    """(x0, y0, x1, y1) of a shape that is no text; of a text as wide as it may become."""
    match shape:
        case Rectangle(x, y, w, h):
            return x, y, x + w, y + h
        case Circle(x, y, d):
            return x - d / 2, y - d / 2, x + d / 2, y + d / 2
        case Polygon(corners):
            xs, ys = zip(*corners, strict=True)
            return min(xs), min(ys), max(xs), max(ys)
        case Line(x0, y0, x1, y1):
            return min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)
        case Text(x, y, text, size, _, anchor):
            width = 0.66 * size * len(text)
            left = x - {"start": 0, "middle": width / 2, "end": width}[anchor]
            return left, y - size, left + width, y + 0.3 * size
    raise AssertionError(shape)


@given(targets(), st.booleans())
def test_the_board_is_there_at_true_scale(target, side_marks):
    """Board and discs measure in millimetres what the file says in metres, about one centre."""
    sheet = draw(target, "0" * 12, side_marks)
    (board,) = (s for s in sheet.shapes if isinstance(s, Rectangle))
    circles = [s for s in sheet.shapes if isinstance(s, Circle)]
    assert board.width_mm == board.height_mm == pytest.approx(1000 * target.board_side_m)
    centre = (board.x_mm + board.width_mm / 2, board.y_mm + board.height_mm / 2)
    for circle, disc in zip(circles, target.discs, strict=True):
        assert (circle.x_mm, circle.y_mm) == pytest.approx(centre, abs=1e-6)
        assert circle.diameter_mm == pytest.approx(1000 * disc.diameter_m)
        assert circle.fill == target.colours[disc.shade]


@given(targets(), st.booleans())
def test_nothing_sticks_out_of_the_sheet(target, side_marks):
    """Every mark and every caption lies within the size that the drawing claims."""
    sheet = draw(target, "0" * 12, side_marks)
    for shape in sheet.shapes:
        x0, y0, x1, y1 = extent(shape)
        assert x0 >= -1e-6, shape
        assert y0 >= -1e-6, shape
        assert x1 <= sheet.width_mm + 2, shape  # half of the ruler's last figure
        assert y1 <= sheet.height_mm + 1e-6, shape


@given(targets())
def test_nothing_is_printed_near_the_discs(target):
    """Whatever is written on the board stays 2 % of its side away from the outermost disc."""
    sheet = draw(target, "0" * 12)
    (board,) = (s for s in sheet.shapes if isinstance(s, Rectangle))
    cx, cy = board.x_mm + board.width_mm / 2, board.y_mm + board.height_mm / 2
    radius = 500 * target.discs[0].diameter_m
    for shape in sheet.shapes:
        if isinstance(shape, Text | Polygon):
            x0, y0, x1, y1 = extent(shape)
            gap = math.hypot(max(x0 - cx, cx - x1, 0), max(y0 - cy, cy - y1, 0)) - radius
            on_board = y1 > board.y_mm and y0 < board.y_mm + board.height_mm
            assert gap >= (0.02 * board.width_mm if on_board else 0)


def test_the_ruler_has_a_tick_for_each_millimetre():
    """101 strokes, 1 mm apart from the first to the last, longer at 5 and at 10."""
    sheet = draw(load_target(), "0" * 12)
    ticks = [
        s for s in sheet.shapes if isinstance(s, Line) and s.width_mm == 0.15 and s.x0_mm == s.x1_mm
    ]
    assert len(ticks) == 101
    assert [t.x0_mm - ticks[0].x0_mm for t in ticks] == pytest.approx(list(range(101)))
    assert {t.y1_mm - t.y0_mm for t in ticks[::10]} == {ticks[0].y1_mm - ticks[0].y0_mm}


@given(targets(1.0), st.sampled_from(PAPERS), st.floats(0, 20), st.booleans())
def test_it_fits_or_another_paper_is_named(target, paper, margin, tiles):
    """Pages have the paper's size and keep its margin; what does not fit is told."""
    pages, told = (), ""
    try:
        pages = lay_out(target, "0" * 12, paper, margin, tiles)
    except TargetPrintError as error:
        told = str(error)
    assert pages or (f"more than {MAX_PAGES}" if tiles else "--tiles") in told
    assert tiles or len(pages) <= 1
    for page in pages:
        assert sorted((page.width_mm, page.height_mm)) == sorted(SIZE_MM[paper])
        seen = [page.window] if page.window else list(page.shapes)
        for shape in (*seen, *page.marks):
            x0, y0, x1, y1 = extent(shape)
            assert min(x0, y0) >= margin - 1e-6
            assert x1 <= page.width_mm - margin + 2
            assert y1 <= page.height_mm - margin + 1e-6


@given(targets(1.0), st.sampled_from(PAPERS), st.floats(0, 20))
def test_the_named_paper_is_right(target, paper, margin):
    """The paper that the error names takes the target, and no smaller one does."""
    try:
        lay_out(target, "0" * 12, paper, margin)
        assume(False)
    except TargetPrintError as error:
        named = str(error).split("use --paper ")[1].split()[0]
    assert len(lay_out(target, "0" * 12, Paper(named), margin)) == 1
    for smaller in PAPERS[: PAPERS.index(Paper(named))] if named != "fit" else PAPERS:
        with pytest.raises(TargetPrintError):
            lay_out(target, "0" * 12, smaller, margin)


@given(targets(1.0), st.sampled_from(PAPERS), st.floats(0, 20))
def test_tiles_cover_the_whole_and_overlap(target, paper, margin):
    """Windows, moved to where they belong, cover the sheet without a gap and share 10 mm."""
    try:
        pages = lay_out(target, "0" * 12, paper, margin, tiles=True)
    except TargetPrintError:
        assume(False)
    assume(len(pages) > 1)
    sheets = [draw(target, "0" * 12, side_marks) for side_marks in (True, False)]
    sheet = next(s for s in sheets if len(s.shapes) == len(pages[0].shapes))
    first = sheet.shapes[0].corners_mm[0]
    spans = set()
    for page in pages:
        dx, dy = (page.shapes[0].corners_mm[0][i] - first[i] for i in (0, 1))
        x, y = page.window.x_mm - dx, page.window.y_mm - dy
        spans.add(("x", round(x, 6), round(x + page.window.width_mm, 6)))
        spans.add(("y", round(y, 6), round(y + page.window.height_mm, 6)))
    for axis, length in (("x", sheet.width_mm), ("y", sheet.height_mm)):
        along = sorted(s[1:] for s in spans if s[0] == axis)
        assert along[0][0] == 0
        assert along[-1][1] >= length - 1e-5
        for before, after in zip(along, along[1:], strict=False):
            assert before[1] - after[0] == pytest.approx(OVERLAP_MM, abs=1e-5)


def test_papers():
    """The small target fits on A4 and on letter, upright; the large one needs A2."""
    for paper in (Paper.A4, Paper.LETTER):
        (page,) = lay_out(load_target("bullseye-200"), "0" * 12, paper, 5.0)
        assert page.width_mm < page.height_mm
    with pytest.raises(TargetPrintError, match="does not fit on A3.*--paper A2 or --tiles"):
        lay_out(load_target(), "0" * 12, Paper.A3, 5.0)
    with pytest.raises(TargetPrintError, match="name a --paper"):
        lay_out(load_target(), "0" * 12, Paper.FIT, 5.0, tiles=True)
    with pytest.raises(TargetPrintError, match="margin of nan"):
        lay_out(load_target(), "0" * 12, Paper.A4, math.nan)


def test_tiles_take_the_fewest_pages():
    """The large target on A3 is two lying pages without side marks, not four upright ones."""
    pages = lay_out(load_target(), "0" * 12, Paper.A3, 5.0, tiles=True)
    assert [(p.width_mm, p.height_mm) for p in pages] == [(420, 297)] * 2


def test_reach():
    """By similar triangles: 0.4 m at fx = 700 px is 14 px at 20 m and 350 px at 0.8 m."""
    assert reach(load_target(), 700, 640, 350) == pytest.approx((20.0, 0.8))
