"""Values out of files that somebody else wrote: checked, bounded, and never any other error."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from detector_training.errors import DatasetError

MAX_JSON_BYTES = 256 << 20
"""labelme may embed a picture; a COCO file holds a whole data set."""
MAX_COORDINATE_PX = 1e5
MAX_SIDE_PX = 8192
MAX_BOXES = 256
MAX_DISTANCE_M = 1e4
MAX_NAME = 256


def read_text(path: Path, most_bytes: int) -> str:
    """A text file.

    Raises:
        DatasetError: it cannot be read, is over ``most_bytes`` or is not UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    if len(data) > most_bytes:
        raise DatasetError(f"{path} is over {most_bytes} bytes")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path} is no UTF-8 text: byte {error.start}") from None


def parse_json(text: str) -> Any:
    """The value that a JSON text holds.

    Raises:
        DatasetError: it is no JSON, nested too deeply or a number has too many digits.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise DatasetError("JSON nested too deeply") from None
    except ValueError as error:
        raise DatasetError(f"no JSON: {error}") from None


def read_json(path: Path) -> Any:
    """The value in a JSON file.

    Raises:
        DatasetError: it cannot be read, is too large or no JSON; names the file.
    """
    text = read_text(path, MAX_JSON_BYTES)
    try:
        return parse_json(text)
    except DatasetError as error:
        raise DatasetError(f"{path}: {error}") from None


def as_object(raw: Any, what: str) -> dict[str, Any]:
    """A JSON object.

    Raises:
        DatasetError: ``raw`` is none.
    """
    if not isinstance(raw, dict):
        raise DatasetError(f"{what} must be a JSON object, not {shown(raw)}")
    return raw


def as_list(raw: Any, what: str, most: int | None = None) -> list[Any]:
    """A JSON list of at most ``most`` entries.

    Raises:
        DatasetError: ``raw`` is none, or too long.
    """
    if not isinstance(raw, list):
        raise DatasetError(f"{what} must be a list, not {shown(raw)}")
    if most is not None and len(raw) > most:
        raise DatasetError(f"{what} must be a list of at most {most}, not {len(raw)}")
    return raw


def as_text(raw: Any, what: str) -> str:
    """A string of 1 to ``MAX_NAME`` characters that can be shown on one line.

    Raises:
        DatasetError: ``raw`` is none.
    """
    if not isinstance(raw, str) or not 0 < len(raw) <= MAX_NAME or not raw.isprintable():
        raise DatasetError(
            f"{what} must be a text of 1 to {MAX_NAME} printable characters, not {shown(raw)}"
        )
    return raw


def as_number(raw: Any, what: str, most: float = MAX_COORDINATE_PX) -> float:
    """A finite number within +- ``most``.

    Raises:
        DatasetError: ``raw`` is none.
    """
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise DatasetError(f"{what} must be a number, not {shown(raw)}")
    # an int may be too large for a float: compare first
    if not -most <= raw <= most:
        raise DatasetError(f"{what} must be finite and within +-{most:g}, not {shown(raw)}")
    return float(raw)


def as_side(raw: Any, what: str) -> int:
    """Width or height of a picture [px].

    Raises:
        DatasetError: ``raw`` is no whole number, or a picture of no or excessive size.
    """
    value = as_number(raw, what, math.inf)
    if not (1 <= value <= MAX_SIDE_PX and value == int(value)):
        raise DatasetError(f"{what} must be 1 to {MAX_SIDE_PX} whole pixels, not {shown(raw)}")
    return int(value)


def as_key(raw: dict[str, Any], key: str) -> Any:
    """The value of a key that must be there.

    Raises:
        DatasetError: it is not.
    """
    if key not in raw:
        raise DatasetError(f"lacks {key}")
    return raw[key]


def as_distance(raw: Any) -> float | None:
    """Distance to the target [m], where one is given.

    Raises:
        DatasetError: it is not positive, or farther than any camera sees.
    """
    if raw is None:
        return None
    distance = as_number(raw, "distance_m", math.inf)
    if not 0 < distance < MAX_DISTANCE_M:
        raise DatasetError(f"distance_m = {distance} is not in (0, {MAX_DISTANCE_M:g})")
    return distance


def as_share(raw: Any, what: str) -> float:
    """A number in [0, 1].

    Raises:
        DatasetError: ``raw`` is none.
    """
    value = as_number(raw, what, math.inf)
    if not 0 <= value <= 1:
        raise DatasetError(f"{what} = {value} is not in [0, 1]")
    return value


def shown(raw: Any, most: int = 60) -> str:
    """A value as it may stand in a message: short, and on one line."""
    try:
        text = repr(raw)
    except (ValueError, RecursionError):  # an int of over 4300 digits
        text = f"a {type(raw).__name__}"
    return text if len(text) <= most else text[:most] + "..."
