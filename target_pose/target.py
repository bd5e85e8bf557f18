"""What a printed target looks like: a board with concentric discs, described by a TOML file."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Any

from target_pose.errors import TargetFileError

DEFAULT_TARGET = "bullseye-400"


class Level(StrEnum):
    """The paper's labels (Section II-B), from the outermost box to the innermost."""

    GOOD = "T_good"
    BETTER = "T_better"
    BEST = "T_best"


class Shade(StrEnum):
    """What a region of the target is printed in."""

    BLACK = "black"
    WHITE = "white"


@dataclass(frozen=True, slots=True)
class Disc:
    """One disc in the centre of the board."""

    diameter_m: float
    shade: Shade


@dataclass(frozen=True, slots=True)
class Target:
    """A square board with concentric discs, from the outside in.

    Frame ``target``: origin in the common centre, x out of the board towards the viewer, z up
    along the board, y = z x x (the viewer's right; left for one who looks along x).
    """

    name: str
    board_side_m: float
    board_shade: Shade
    discs: tuple[Disc, ...]
    level_m: dict[Level, float]
    """Side of the square that each level's box circumscribes when seen head-on."""


def load_target(name_or_path: str | Path = DEFAULT_TARGET) -> Target:
    """Load a packaged target by its name, or one's own by the path of its TOML file.

    Raises:
        TargetFileError: the file is missing or describes no target; says which field and why.
    """
    text_name = str(name_or_path)
    packaged = resources.files("target_pose") / "targets"
    if text_name.endswith(".toml"):
        source = Path(text_name)
    else:
        known = sorted(f.name[:-5] for f in packaged.iterdir() if f.name.endswith(".toml"))
        if text_name not in known:
            raise TargetFileError(
                f"no target {text_name!r}; packaged: {', '.join(known)}, "
                "or give the path of a .toml file"
            )
        source = Path(str(packaged / f"{text_name}.toml"))
    try:
        raw = tomllib.loads(source.read_text(encoding="utf-8"))
        return _target(raw)
    except OSError as error:
        raise TargetFileError(f"target file {source}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, TargetFileError) as error:
        raise TargetFileError(f"target file {source}: {error}") from None
    except KeyError as error:
        raise TargetFileError(f"target file {source}: lacks {error.args[0]}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise TargetFileError(f"target file {source}: {error}") from None


def _target(raw: dict[str, Any]) -> Target:
    side = _length("board.side_m", raw["board"]["side_m"])
    discs = tuple(
        Disc(_length("discs.diameter_m", d["diameter_m"]), Shade(d["shade"])) for d in raw["discs"]
    )
    if not 1 <= len(discs) <= 8:
        raise TargetFileError(f"a target has 1 to 8 discs, not {len(discs)}")
    shade = Shade(raw["board"]["shade"])
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
    levels = {Level(k): _length(f"levels.{k}", v) for k, v in raw["levels"].items()}
    sizes = [levels[level] for level in Level]
    if sizes != sorted(sizes, reverse=True) or len(set(sizes)) != len(sizes):
        raise TargetFileError(f"levels must shrink from {Level.GOOD} to {Level.BEST}: {sizes}")
    name = raw["name"]
    if not isinstance(name, str) or not 1 <= len(name) <= 64:
        raise TargetFileError("name must be a string of 1 to 64 characters")
    return Target(name, side, shade, discs, levels)


def _length(where: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TargetFileError(f"{where} must be a length in metres, not {value!r}")
    if not (math.isfinite(value) and 0.001 <= value <= 10):
        raise TargetFileError(f"{where} = {value} m is not in [0.001, 10]")
    return float(value)
