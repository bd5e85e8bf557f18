"""How all figures look, and how one gets to disk: whole, or not at all."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from contact_sim.errors import FigureError
from drone_client.mission import Phase

WIDTH_IN: Final = 8.0
DPI: Final = 125
"""1000 px wide: at 800 px a text of 9 points is still 10 px high."""
# Okabe and Ito's colours, which differ for every kind of sight
BLUE: Final = "#0072B2"
ORANGE: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#CC79A7"
SKY: Final = "#56B4E9"
AMBER: Final = "#E69F00"
YELLOW: Final = "#F0E442"
GRAY: Final = "#777777"
AXES: Final = (BLUE, ORANGE, GREEN)
"""Of x, y and z."""
RUNS: Final = (BLUE, ORANGE)
"""Of run 1 and run 2."""
_LINES: Final = (BLUE, ORANGE, GREEN, PURPLE, SKY, AMBER, YELLOW, GRAY, "#ffffff", "#000000")
CAPTION_KEY: Final = "Description"
COMMAND_KEY: Final = "Command"
NAMES_PT: Final = 44.0
"""Room above the axes for the names of phases: no curve runs through them there."""
NAMED_SHARE: Final = 0.035
"""A phase that lasts less than this share of an axis of half the width has no room for a name."""


def new_figure(height_in: float) -> Any:
    """An empty figure of the common width."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finish(axes: Any, title: str, x_label: str, y_label: str) -> None:
    """Title, labels with their units, and a grid that keeps back."""
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x_label, fontsize=9)
    axes.set_ylabel(y_label, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)


def legend(axes: Any, **where: Any) -> None:
    """A small legend inside the axes, where there is most room unless told otherwise."""
    axes.legend(fontsize=8, framealpha=0.9, **({"loc": "best"} | where))


def mark_phases(
    axes: Any, starts: Sequence[tuple[float, Phase]], *, named: bool = True, wide: bool = False
) -> None:
    """A dotted line where the mission went into another phase, with its name above the axes.

    Args:
        axes: time in seconds along x; finished, with its title.
        starts: when each phase began.
        named: False: the lines alone.
        wide: the axes are as wide as the figure.
    """
    low, high = axes.get_xlim()
    share = NAMED_SHARE / 2 if wide else NAMED_SHARE
    if named:
        axes.set_title(axes.get_title(loc="left"), fontsize=10, loc="left", pad=NAMES_PT)
    ends = [at_s for at_s, _ in starts[1:]] + [high]
    for (at_s, phase), end_s in zip(starts, ends, strict=True):
        if not low <= at_s <= high:
            continue
        axes.axvline(at_s, color=GRAY, ls=":", lw=0.9)
        if named and end_s - at_s > share * (high - low):
            axes.annotate(
                phase.value,
                (at_s, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, 3),
                textcoords="offset points",
                rotation=90,
                va="bottom",
                ha="center",
                fontsize=7.5,
                color="#444444",
            )


def save(figure: Any, path: Path, caption: str, command: str) -> None:
    """Write the PNG, with its caption inside it, and the command that draws it again.

    Raises:
        FigureError: it cannot be written.
    """
    from PIL import Image  # matplotlib brings it
    from PIL.PngImagePlugin import PngInfo

    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=DPI, format="png")
    words = PngInfo()
    words.add_text(CAPTION_KEY, caption)
    words.add_text(COMMAND_KEY, command)
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with Image.open(drawn) as picture:
            full = picture.convert("RGB")
        # 256 colours, lines in their own: nobody sees it, and it is a third of the bytes
        palette = Image.new("P", (1, 1))
        common = (full.quantize(256 - len(_LINES)).getpalette() or [])[: 3 * (256 - len(_LINES))]
        palette.putpalette(common + [v for line in _LINES for v in bytes.fromhex(line[1:])])
        few = full.quantize(palette=palette, dither=Image.Dither.NONE)
        few.save(part, format="PNG", pnginfo=words, optimize=True)
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise FigureError(f"cannot write {path}: {error.strerror or error}") from None


def check_writable(path: Path) -> None:
    """See early whether a file could be written: nobody flies for minutes to hear that not.

    Raises:
        FigureError: there is no such folder and it cannot be made, or it takes no file.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.touch()
        part.unlink()
    except OSError as error:
        raise FigureError(f"cannot write {path}: {error.strerror}") from None
    if path.is_dir():
        raise FigureError(f"cannot write {path}: it is a folder")


def caption_of(path: Path) -> str:
    """The caption inside a figure.

    Raises:
        FigureError: there is no such figure, or it has none.
    """
    return _words_of(path, CAPTION_KEY)


def command_of(path: Path) -> str:
    """The command that draws a figure again.

    Raises:
        FigureError: there is no such figure, or it does not say it.
    """
    return _words_of(path, COMMAND_KEY)


def _words_of(path: Path, key: str) -> str:
    from PIL import Image, UnidentifiedImageError  # matplotlib brings it

    try:
        with Image.open(path) as picture:
            words = picture.info.get(key)
    except (OSError, UnidentifiedImageError) as error:
        raise FigureError(f"cannot read figure {path}: {error}") from None
    if not isinstance(words, str) or not words:
        raise FigureError(
            f"{path} has no {key.lower()}: it is no figure of scripts/figures, or an old one"
        )
    return words
