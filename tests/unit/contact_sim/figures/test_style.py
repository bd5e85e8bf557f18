"""A figure gets to disk whole, with its caption, or not at all."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from PIL import Image

from contact_sim.errors import FigureError
from contact_sim.figures.style import (
    caption_of,
    check_writable,
    command_of,
    finish,
    mark_phases,
    new_figure,
    save,
)
from drone_client.mission import Phase


def a_figure():
    figure = new_figure(3.0)
    axes = figure.subplots()
    axes.plot([0.0, 10.0], [0.0, 1.0])
    finish(axes, "a title", "time [s]", "h [m]")
    return figure, axes


def test_a_figure_carries_its_caption_and_is_wide_enough(tmp_path):
    """What the page says of it is inside it; at 1000 px it is still sharp at 800."""
    path = tmp_path / "new" / "a.png"
    save(a_figure()[0], path, "h ≥ 3 mm", "scripts/figures a --quick")
    assert caption_of(path) == "h ≥ 3 mm"
    assert command_of(path) == "scripts/figures a --quick"
    with Image.open(path) as picture:
        assert picture.width == 1000
    assert [p.name for p in path.parent.iterdir()] == ["a.png"]


def test_a_folder_that_is_a_file_is_said(tmp_path):
    """It names the path."""
    (tmp_path / "file").write_text("")
    with pytest.raises(FigureError, match="file/a.png"):
        save(a_figure()[0], tmp_path / "file" / "a.png", "words", "command")


def test_a_disk_that_is_full_leaves_nothing(tmp_path, monkeypatch):
    """And what was there stays."""

    def full(self, path, **_):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    path = tmp_path / "a.png"
    path.write_bytes(b"earlier")
    figure, _ = a_figure()
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    monkeypatch.setattr(figure, "savefig", lambda file, **_: file.write(drawn.getvalue()))
    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(FigureError, match="No space left"):
        save(figure, path, "words", "command")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.png": b"earlier"}


def test_a_folder_that_takes_nothing_is_known_early(tmp_path):
    """One that can be made is made, and nothing is left in it."""
    check_writable(tmp_path / "new" / "a.png")
    assert list((tmp_path / "new").iterdir()) == []
    for path in (Path("/proc/x/a.png"), tmp_path / "new"):
        with pytest.raises(FigureError, match=f"cannot write {path}: "):
            check_writable(path)


def test_what_is_no_figure_of_ours_is_said(tmp_path):
    """No PNG, no file, and a PNG of somebody else."""
    (tmp_path / "text.png").write_text("no picture")
    Image.new("RGB", (4, 4)).save(tmp_path / "foreign.png")
    for name in ("text.png", "none.png", "foreign.png"):
        with pytest.raises(FigureError, match=name):
            caption_of(tmp_path / name)


def test_phases_are_named_where_there_is_room():
    """Every one has its line; one that lasts no time has no name, for names must not overlap."""
    _, axes = a_figure()
    axes.set_xlim(0.0, 10.0)
    starts = [(0.0, Phase.HOLD), (0.1, Phase.ALIGN), (6.0, Phase.CONTACT), (11.0, Phase.DONE)]
    lines = len(axes.lines)
    mark_phases(axes, starts)
    assert [text.get_text() for text in axes.texts] == ["align", "contact"]
    assert len(axes.lines) - lines == 3


def test_no_curve_runs_through_a_name():
    """Names stand above the axes, and below the title."""
    figure, axes = a_figure()
    axes.set_xlim(0.0, 10.0)
    mark_phases(axes, [(0.0, Phase.APPROACH), (5.0, Phase.RETREAT)])
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    inside, title = axes.get_window_extent(renderer), axes._left_title.get_window_extent(renderer)
    for text in axes.texts:
        box = text.get_window_extent(renderer)
        assert inside.y1 <= box.y0 < box.y1 <= title.y0


def test_a_short_phase_has_its_name_where_the_axes_are_wide():
    """A quarter of the figure's width has less room."""
    names = []
    for wide in (False, True):
        _, axes = a_figure()
        axes.set_xlim(0.0, 30.0)
        mark_phases(axes, [(0.0, Phase.HOLD), (0.9, Phase.ALIGN)], wide=wide)
        names.append([text.get_text() for text in axes.texts])
    assert names == [["align"], ["hold", "align"]]
