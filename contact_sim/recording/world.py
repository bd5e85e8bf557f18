"""Which world a run was flown in, from the run's own files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final, NamedTuple

from contact_sim.errors import FilmError
from contact_sim.scene import Scene, build_scene
from drone_client.run_files import SUMMARY_NAME, WORLD_NAME

MAX_BYTES: Final = 10_000_000


class WorldName(NamedTuple):
    """What builds a world."""

    world: str
    seed: int
    board: str | None
    """State of the print; None: nobody wrote it down."""

    def build(self) -> Scene:
        """The world; a print of which nothing is known is clean.

        Raises:
            WorldError: there is none of this name, with that seed and board.
        """
        return build_scene(self.world, self.seed, self.board or "clean")


def load_world(run: Path) -> WorldName:
    """Of ``world.json``; of the summary where there is none, as in flights of earlier days.

    Raises:
        FilmError: neither says it, or not as a simulator would.
    """
    found = _read(run / WORLD_NAME)
    if found is None and (summary := _read(run / SUMMARY_NAME)) is not None:
        found = summary.get("simulated")
    if not isinstance(found, dict):
        raise FilmError(
            f"{run} is no simulated flight, or was cut off before its world was written down: "
            f"there is neither {WORLD_NAME} in it nor a {SUMMARY_NAME} with a world"
        )
    world, seed, board = found.get("world"), found.get("seed"), found.get("board")
    if not isinstance(world, str) or not isinstance(seed, int):
        raise FilmError(f"{run}: world {world!r:.40}, seed {seed!r:.40} is no world that there is")
    return WorldName(world, seed, board if isinstance(board, str) else None)


def _read(path: Path) -> dict[str, Any] | None:
    """A JSON file; None: it is not there, or was cut off."""
    try:
        with path.open("rb") as file:
            found = json.loads(file.read(MAX_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
