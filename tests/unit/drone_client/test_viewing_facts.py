"""``flight.json``: what must be known of a drone to draw its flight."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drone_client.errors import OutputError
from drone_client.viewing.facts import load_facts
from tests.unit.drone_client.view_builders import facts


def test_what_was_written_is_read(tmp_path: Path):
    """Camera, airframe, target, funnel and limits come back as they went."""
    path, before = tmp_path / "flight.json", facts()
    path.write_text(json.dumps(before.to_json()), encoding="utf-8")
    after = load_facts(path)
    assert after is not None
    assert (after.camera.color, after.funnel) == (before.camera.color, before.funnel)
    assert after.propellers == before.propellers
    assert len(after.propellers) == 4
    assert (after.board_side_m, after.discs_m) == (0.4, (0.3, 0.14, 0.06))
    assert (after.tau_max_ms, after.age_max_ms) == (before.tau_max_ms, before.age_max_ms)
    np.testing.assert_allclose(
        after.body_from_camera.matrix, before.body_from_camera.matrix, atol=1e-12
    )


def test_a_replay_has_none(tmp_path: Path):
    """No file is no mistake."""
    assert load_facts(tmp_path / "flight.json") is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "[" * 5000,
        json.dumps(facts().to_json() | {"funnel": {"a": -1.0, "e_m": 0.003, "r_c_m": 0.02}}),
        json.dumps(facts().to_json() | {"body_from_tip": [0, 0, 0, 1, 1, 1, 1]}),
        json.dumps(facts().to_json() | {"camera": {}}),
        json.dumps(facts().to_json() | {"propellers": [[1, 2]]}),
    ],
)
def test_a_broken_file_is_told_with_its_name(tmp_path: Path, text: str):
    """Whatever is wrong with it."""
    path = tmp_path / "flight.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(OutputError, match=r"flight\.json"):
        load_facts(path)
