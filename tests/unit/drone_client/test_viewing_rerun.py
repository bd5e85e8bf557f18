"""A flight as a Rerun recording, read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
import rerun.chunk
from rich.console import Console

from drone_client.errors import OutputError
from drone_client.viewing.command import write_rerun
from tests.unit.drone_client.view_builders import (
    FRAMES,
    POSES,
    RIG,
    START_NS,
    TICKS,
    WORLD_FROM_TARGET,
    body_at,
    camera_from_target,
    write_run,
)

QUIET = Console(quiet=True)
TIME = "drone_time"


def rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Each entity's rows, in the order of time [ns]; what is static has none."""
    entities: dict[str, list[dict[str, Any]]] = {}
    for chunk in rerun.chunk.RrdReader(str(path)).store().stream():
        batch = chunk.to_record_batch()
        columns = {
            name.split(":")[-1]: (
                column.cast(pyarrow.int64()) if pyarrow.types.is_duration(column.type) else column
            ).to_pylist()
            for name, column in zip(batch.schema.names, batch.columns, strict=True)
        }
        found = [
            dict(zip(columns, values, strict=True))
            for values in zip(*columns.values(), strict=True)
        ]
        entities.setdefault(chunk.entity_path, []).extend(found)
    for found in entities.values():
        found.sort(key=lambda row: row.get(TIME, 0))
    return entities


@pytest.fixture(scope="module")
def entities(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("run")
    path = folder / "flight.rrd"
    write_rerun(write_run(folder), path, overwrite=False, console=QUIET)
    return rows(path)


def moving(entities: dict, path: str) -> list[dict[str, Any]]:
    return [row for row in entities[path] if TIME in row]


def test_the_tree_of_entities_is_the_tree_of_frames(entities: dict):
    """Drone under world, camera under drone, the picture under the camera; beside it the board."""
    assert {
        *("/world/drone", "/world/drone/camera", "/world/drone/camera/image", "/world/target"),
        *("/world/drone/shape", "/world/target/board", "/world/target/funnel", "/log"),
    } <= entities.keys()


def test_the_drone_is_where_it_was(entities: dict):
    """At each pose's own time."""
    drone = moving(entities, "/world/drone")
    assert len(drone) == POSES
    first, last = drone[0], drone[-1]
    assert first[TIME] == START_NS
    (place,) = last["translation"]
    expected = body_at(last[TIME]).translation
    np.testing.assert_allclose(place, expected, atol=1e-5)
    (target,) = moving(entities, "/world/target")[0]["translation"]
    np.testing.assert_allclose(target, WORLD_FROM_TARGET.translation, atol=1e-6)


def test_pictures_and_what_was_found_in_them_share_their_times(entities: dict):
    """A JPEG for each, and the outline in its pixels."""
    image = [r for r in moving(entities, "/world/drone/camera/image") if r.get("blob")]
    assert len(image) == FRAMES
    found = moving(entities, "/world/drone/camera/image/found")
    assert {row[TIME] for row in image} <= {row[TIME] for row in found}
    corners = np.array(found[0]["strips"][0])[:4]
    center = RIG.color.image_from_camera @ camera_from_target(0).translation
    np.testing.assert_allclose(corners.mean(axis=0), center[:2] / center[2], atol=0.5)
    assert bytes(np.array(image[0]["blob"][0], dtype=np.uint8)[:2]) == b"\xff\xd8"


def test_numbers_and_words_are_there(entities: dict):
    """The barrier at every tick, the delay of every answer, what was said."""
    h = moving(entities, "/control/h_m")
    assert len(h) == TICKS
    assert h[20]["scalars"] == [pytest.approx(0.8)]
    assert len(moving(entities, "/link/network_delay_ms")) == FRAMES
    texts = [row["text"][0] for row in moving(entities, "/log")]
    assert texts[1] == "hold -> approach: square before the board"


def test_a_replay_shows_what_it_has(tmp_path: Path):
    """The camera is placed where it saw the target."""
    path = tmp_path / "replay.rrd"
    run = write_run(tmp_path / "run", known=False)
    write_rerun(run, path, overwrite=False, console=QUIET)
    (place,) = moving(rows(path), "/world/drone/camera")[0]["translation"]
    expected = WORLD_FROM_TARGET @ camera_from_target(0).inverse()
    np.testing.assert_allclose(place, expected.translation, atol=1e-5)


def test_a_file_that_is_there_stays(tmp_path: Path):
    """Unless it may go."""
    run, path = write_run(tmp_path / "run"), tmp_path / "flight.rrd"
    path.write_bytes(b"precious")
    with pytest.raises(OutputError, match="is there already"):
        write_rerun(run, path, overwrite=False, console=QUIET)
    assert path.read_bytes() == b"precious"
    write_rerun(run, path, overwrite=True, console=QUIET)
    assert "/world/drone" in rows(path)
