"""The check at the start: the shipped detector passes, one that is blind does not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from edge_service import parts
from edge_service.detector.drawn import SIDES_PX, draw
from edge_service.detector.engine import TorchDetector
from edge_service.detector.self_check import require, self_check
from edge_service.errors import SelfCheckError
from rgbd_wire.clock import MonotonicClock
from target_pose.candidate import Detections
from target_pose.target import Level, load_target
from tests.unit.edge_service.edge_fakes import KnownDetector, settings

TARGET = load_target()


class Knowing:
    """Finds in each picture what was drawn there."""

    def __init__(self):
        self.drawn = draw(TARGET)

    def detect(self, color_rgb):
        for drawn in self.drawn:
            if np.array_equal(drawn.color_rgb, color_rgb):
                return Detections({level: (box,) for level, box in drawn.boxes.items()})
        raise AssertionError("a picture that was not drawn")


def blind():
    return KnownDetector(Detections(dict.fromkeys(Level, ())))


def test_the_drawn_targets_are_what_they_say():
    """The same in every run; the boxes have the target's proportions."""
    first, again = draw(TARGET), draw(TARGET)
    for one, other, side_px in zip(first, again, SIDES_PX, strict=True):
        assert np.array_equal(one.color_rgb, other.color_rgb)
        assert one.boxes[Level.GOOD].size_px[1] == pytest.approx(side_px)
        ratio = one.boxes[Level.BETTER].size_px[1] / side_px
        assert ratio == pytest.approx(TARGET.level_m[Level.BETTER] / TARGET.board_side_m)


def test_what_finds_them_passes_and_is_timed():
    """All three, and a time for each picture."""
    check = self_check(Knowing(), TARGET)
    assert check.found == check.drawn == 3
    assert 0 < check.p50_ms <= check.worst_ms
    require(check, "it", TARGET)


def test_the_shipped_weights_pass():
    """As a worker starts with them."""
    before = torch.get_num_threads()
    try:
        assert self_check(TorchDetector(threads=1, precision="fp32"), TARGET).passed
    finally:
        torch.set_num_threads(before)


def test_boxes_in_the_wrong_place_do_not_pass():
    """An engine that answers always the same has not seen anything."""
    check = self_check(KnownDetector(), TARGET)
    assert not check.passed
    with pytest.raises(SelfCheckError, match=r"it found 0 of 3 drawn targets.*--self-check warn"):
        require(check, "it", TARGET)


def test_a_worker_with_a_blind_detector_does_not_start(monkeypatch, caplog):
    """It is refused, served with a warning, or not looked at: as the settings say."""
    monkeypatch.setattr(parts, "open_engine", lambda *_, **__: blind())
    clock = MonotonicClock()
    with pytest.raises(SelfCheckError, match="the packaged weights on torch found 0 of 3"):
        parts.make_pipeline(settings(), clock, check=True)
    made = parts.make_pipeline(settings(self_check="warn"), clock, check=True)
    assert made.detector.describe()["self_check"] == "found 0 of 3 drawn targets"
    assert "found 0 of 3" in caplog.text
    made = parts.make_pipeline(settings(self_check="off"), clock, check=True)
    assert "self_check" not in made.detector.describe()
    assert "self_check" not in parts.make_pipeline(settings(), clock).detector.describe()
