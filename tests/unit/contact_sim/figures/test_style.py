"""A figure gets to disk whole, with its caption, or not at all."""

from __future__ import annotations

import pytest
from PIL import Image

from contact_sim.errors import FigureError
from contact_sim.figures.style import caption_of, finish, mark_phases, new_figure, save
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
    save(a_figure()[0], path, "h ≥ 3 mm")
    assert caption_of(path) == "h ≥ 3 mm"
    with Image.open(path) as picture:
        assert picture.width == 1000
    assert [p.name for p in path.parent.iterdir()] == ["a.png"]


def test_a_folder_that_is_a_file_is_said(tmp_path):
    """It names the path."""
    (tmp_path / "file").write_text("")
    with pytest.raises(FigureError, match="file/a.png"):
        save(a_figure()[0], tmp_path / "file" / "a.png", "words")


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
