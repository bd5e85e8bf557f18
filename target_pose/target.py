"""What a target looks like: a board with discs or labelled points, described by a TOML file."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

from target_pose.errors import TargetFileError
from target_pose.points import BoardPoint, parse_points

DEFAULT_TARGET = "bullseye-400"
MIN_CONTRAST = 4.5
"""Least contrast of the two printed colours: what WCAG 2.2 asks of text (success criterion 1.4.3),
and about what is left of black and white in the worst prints that the detector was trained on."""


class Level(StrEnum):
    """The paper's labels (Section II-B), from the outermost box to the innermost."""

    GOOD = "T_good"
    BETTER = "T_better"
    BEST = "T_best"


class Shade(StrEnum):
    """What a region of the target is printed in."""

    BLACK = "black"
    WHITE = "white"


PURE_COLOURS: Mapping[Shade, str] = MappingProxyType(
    {Shade.BLACK: "#000000", Shade.WHITE: "#ffffff"}
)


@dataclass(frozen=True, slots=True)
class Disc:
    """One disc in the centre of the board."""

    diameter_m: float
    shade: Shade


@dataclass(frozen=True, slots=True)
class Target:
    """A square board with concentric discs, from the outside in, or with labelled points, or both.

    Frame ``target``: origin in the common centre, x out of the board towards the viewer, z up
    along the board, y = z x x (the viewer's right; left for one who looks along x).
    """

    name: str
    board_side_m: float
    board_shade: Shade
    discs: tuple[Disc, ...]
    level_m: dict[Level, float]
    """Side of the square that each level's box circumscribes when seen head-on."""
    colours: dict[Shade, str] = field(default_factory=lambda: dict(PURE_COLOURS))
    """What a printer lays down for each shade, as sRGB ``#rrggbb``."""
    points: tuple[BoardPoint, ...] = ()
    """In the order in which a net that finds them gives them."""


def packaged_targets() -> tuple[str, ...]:
    """Names of the targets that come with this package, sorted."""
    packaged = resources.files("target_pose") / "targets"
    return tuple(sorted(f.name[:-5] for f in packaged.iterdir() if f.name.endswith(".toml")))


def target_file(name_or_path: str | Path) -> Path:
    """The TOML file of a packaged target's name, or the path itself where it ends in ``.toml``.

    Raises:
        TargetFileError: no target of that name is packaged.
    """
    text_name = str(name_or_path)
    if text_name.endswith(".toml"):
        return Path(text_name)
    known = packaged_targets()
    if text_name not in known:
        raise TargetFileError(
            f"no target {text_name!r}; packaged: {', '.join(known)}, "
            "or give the path of a .toml file"
        )
    return Path(str(resources.files("target_pose") / "targets" / f"{text_name}.toml"))


def load_target(name_or_path: str | Path = DEFAULT_TARGET) -> Target:
    """Load a packaged target by its name, or one's own by the path of its TOML file.

    Raises:
        TargetFileError: the file is missing or describes no target; says which field and why.
    """
    source = target_file(name_or_path)
    try:
        return parse_target(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise TargetFileError(f"target file {source}: {error.strerror}") from None
    except (ValueError, TargetFileError) as error:  # a path with a NUL; no UTF-8
        raise TargetFileError(f"target file {source}: {error}") from None


def load_round_target(name_or_path: str | Path = DEFAULT_TARGET) -> Target:
    """As ``load_target``, for whatever draws a target, trains on it or looks for its circles.

    Raises:
        TargetFileError: as there, or the target has no discs.
    """
    target = load_target(name_or_path)
    if not target.discs:
        raise TargetFileError(
            f"target {target.name} has [[points]] and no [[discs]]: what it looks like is not "
            "known, so it cannot be drawn, trained on or found by circles here; see 'targets that "
            "are not circles' in docs/localisation.md"
        )
    return target


def parse_target(text: str) -> Target:
    """The target that a TOML text describes.

    Raises:
        TargetFileError: it describes none; says which field and why.
    """
    try:
        return _target(tomllib.loads(text))
    except KeyError as error:
        raise TargetFileError(f"lacks {error.args[0]}") from None
    except RecursionError:
        raise TargetFileError("nests too deeply") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise TargetFileError(str(error)) from None


def _target(raw: dict[str, Any]) -> Target:
    _only("a target", raw, ("name", "board", "discs", "levels", "colours", "points"))
    side = _length("board.side_m", raw["board"]["side_m"])
    shade = Shade(raw["board"]["shade"])
    points = parse_points(raw["points"], side) if "points" in raw else ()
    discs: tuple[Disc, ...] = ()
    if "discs" in raw or not points:
        discs = _discs(raw["discs"], side, shade)
    name = raw["name"]
    if not isinstance(name, str) or not 1 <= len(name) <= 64:
        raise TargetFileError("name must be a string of 1 to 64 characters")
    levels = _levels(raw["levels"]) if discs else _lone_level(raw.get("levels"), side)
    return Target(name, side, shade, discs, levels, _colours(raw.get("colours", {})), points)


def _discs(raw: list[dict[str, Any]], side: float, shade: Shade) -> tuple[Disc, ...]:
    discs = tuple(
        Disc(_length("discs.diameter_m", d["diameter_m"]), Shade(d["shade"])) for d in raw
    )
    if not 1 <= len(discs) <= 8:
        raise TargetFileError(f"a target has 1 to 8 discs, not {len(discs)}")
    outer, outer_shade = side, shade
    for disc in discs:
        if disc.diameter_m >= outer:
            raise TargetFileError(
                f"discs go from the outside in: {disc.diameter_m} m does not fit inside {outer} m"
            )
        if disc.shade == outer_shade:
            raise TargetFileError(
                f"the disc of {disc.diameter_m} m has the shade of what it lies on"
            )
        outer, outer_shade = disc.diameter_m, disc.shade
    return discs


def _levels(raw: dict[str, Any]) -> dict[Level, float]:
    levels = {Level(k): _length(f"levels.{k}", v) for k, v in raw.items()}
    sizes = [levels[level] for level in Level]
    if sizes != sorted(sizes, reverse=True) or len(set(sizes)) != len(sizes):
        raise TargetFileError(f"levels must shrink from {Level.GOOD} to {Level.BEST}: {sizes}")
    return levels


def _lone_level(raw: dict[str, Any] | None, side: float) -> dict[Level, float]:
    """Nothing nests without discs: the one box of a target of points."""
    if raw is None:
        return {Level.GOOD: side}
    if set(raw) != {Level.GOOD}:
        raise TargetFileError(
            f"a target without discs has one level, {Level.GOOD}, not {', '.join(raw)[:60]}"
        )
    return {Level.GOOD: _length(f"levels.{Level.GOOD}", raw[Level.GOOD])}


def _only(what: str, table: dict[str, Any], known: tuple[str, ...]) -> None:
    # a misspelt [colors] would otherwise print in black and white without a word
    for key in table:
        if key not in known:
            raise TargetFileError(f"unknown {key!r}; {what} has {', '.join(known)}")


def _colours(raw: dict[str, Any]) -> dict[Shade, str]:
    _only("[colours]", raw, tuple(Shade))
    colours = {shade: raw.get(shade.value, PURE_COLOURS[shade]) for shade in Shade}
    for shade, value in colours.items():
        if not isinstance(value, str) or not re.fullmatch("#[0-9a-fA-F]{6}", value):
            raise TargetFileError(f"colours.{shade} must be sRGB as '#rrggbb', not {value!r}")
    dark, light = (_luminance(colours[shade]) for shade in (Shade.BLACK, Shade.WHITE))
    contrast = (light + 0.05) / (dark + 0.05)  # WCAG 2.2, "contrast ratio"
    if contrast < MIN_CONTRAST:
        raise TargetFileError(
            f"colours.black {colours[Shade.BLACK]} must be clearly darker than colours.white "
            f"{colours[Shade.WHITE]}: their contrast is {contrast:.1f}, not {MIN_CONTRAST} or more"
        )
    return {shade: value.lower() for shade, value in colours.items()}


def _luminance(colour: str) -> float:
    """Relative luminance of an sRGB colour in [0, 1] (IEC 61966-2-1)."""
    linear = [
        v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4
        for v in (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _length(where: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TargetFileError(f"{where} must be a length in metres, not {value!r}")
    # compared first: an integer may be too large for isfinite
    if not (0.001 <= value <= 10 and math.isfinite(value)):
        raise TargetFileError(f"{where} = {value} m is not in [0.001, 10]")
    return float(value)
