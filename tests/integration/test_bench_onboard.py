"""The bench of own eyes on the shipped recording: it runs through, and the outages are bridged."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from target_pose.target import load_target
from tests.perf import bench_onboard
from tests.perf.onboard_sequences import recordings, without_target


@pytest.fixture
def shipped(monkeypatch):
    """The shipped recording alone, and one thread."""
    first = next(recordings())
    monkeypatch.setattr(bench_onboard, "recordings", lambda: iter([first]))
    monkeypatch.setattr(bench_onboard.cv2, "setNumThreads", lambda _: None)
    return first


def test_outages_of_a_second_in_the_shipped_approach_are_bridged(
    shipped, monkeypatch, capsys, tmp_path
):
    """Nine in ten at least, none of them without own eyes, and nothing but the target is seen."""
    page = tmp_path / "onboard.md"
    options = ["--flights", "0", "--lookalikes", "", "--seconds", "1", "--json"]
    monkeypatch.setattr(sys, "argv", ["bench", *options, "--write", str(page)])
    assert bench_onboard.main() == 0
    (row,) = json.loads(capsys.readouterr().out)["bridges"]
    assert row["outages"] >= 10
    assert row["bridged"] >= 0.9 * row["outages"]
    assert row["bridged_without"] == 0
    assert row["wrong"] == 0
    assert row["covered"] == row["onboard"] > 100
    assert "shipped recording | 1 |" in page.read_text()


def test_a_target_that_is_taken_down_is_gone_from_the_picture(shipped):
    """Its black and white are replaced by what is around it; nothing else changes."""
    shot = shipped.shots[40]
    bare = without_target(shot, load_target())
    changed = (bare.color_rgb != shot.frame.color_rgb).any(axis=2)
    assert 0.02 < changed.mean() < 0.6
    v, u = np.nonzero(changed)
    inside = bare.color_rgb[v, u]
    assert np.ptp(inside, axis=0).max() == 0
