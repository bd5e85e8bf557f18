"""What lies in a run's folder, by name; an earlier run goes as a whole, or stays."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from drone_client.errors import OutputError

LEDGER_NAME: Final = "ledger.jsonl"
EVENTS_NAME: Final = "events.jsonl"
TICKS_NAME: Final = "ticks.jsonl"
ONBOARD_NAME: Final = "onboard.jsonl"
POSES_NAME: Final = "poses.jsonl"
TRUTH_NAME: Final = "truth.jsonl"
"""How it truly was; a simulator's."""
WORLD_NAME: Final = "world.json"
"""Which world it was flown in, also of a flight that was killed; a simulator's."""
FACTS_NAME: Final = "flight.json"
SUMMARY_NAME: Final = "summary.json"
PLOT_NAME: Final = "run.png"
PICTURES_NAME: Final = "pictures"

_FILES: Final = (
    LEDGER_NAME,
    EVENTS_NAME,
    TICKS_NAME,
    ONBOARD_NAME,
    POSES_NAME,
    TRUTH_NAME,
    WORLD_NAME,
    FACTS_NAME,
    SUMMARY_NAME,
    PLOT_NAME,
)
_PICTURE = re.compile(r"(\d{1,19})\.jpg")


def check_earlier(folder: Path, *, overwrite: bool) -> None:
    """See that no earlier run is in a folder: it is evidence, and goes only if somebody says so.

    Raises:
        OutputError: there is one.
        OSError: nobody can see.
    """
    earlier = folder / LEDGER_NAME
    if not overwrite and earlier.exists() and earlier.stat().st_size:
        raise OutputError(
            f"folder {folder} holds an earlier run: give another --out, or --overwrite"
        )


def clear_earlier(folder: Path) -> None:
    """Delete what a run wrote into its folder, and nothing else.

    All of it: a new run does not write every file, and what stayed would be taken for its own.

    Raises:
        OSError: a file does not go.
    """
    for name in _FILES:
        (folder / name).unlink(missing_ok=True)
    for picture, _ in list_pictures(folder):
        picture.unlink(missing_ok=True)


def list_pictures(folder: Path, after_ns: int = -1) -> list[tuple[Path, int]]:
    """Files and times [ns] of a run's pictures that are newer than a time, the oldest first."""
    found = []
    try:
        for path in (folder / PICTURES_NAME).iterdir():
            match = _PICTURE.fullmatch(path.name)
            if match is not None and int(match[1]) > after_ns:
                found.append((path, int(match[1])))
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(found, key=lambda picture: picture[1])
