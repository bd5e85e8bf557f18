"""A recording in memory."""

import numpy as np

from drone_client.source import Capture
from drone_client.source.memory import MemorySource
from tests.unit.drone_client.builders import CAMERA, MS, frame, pose


def test_gives_what_it_was_handed_as_often_as_asked():
    """Captures in order, and the pose between two that are known."""
    color, depth = frame().color_rgb, frame().depth_units
    captures = [Capture(t * MS, color, depth, f"{t}") for t in (0, 100)]
    trajectory = [(0, pose((0, 0, 0))), (100 * MS, pose((1, 0, 0)))]
    source = MemorySource(CAMERA, captures, trajectory)
    assert len(source) == 2
    assert [c.name for c in source.captures()] == ["0", "100"]
    assert list(source.captures()) == captures
    np.testing.assert_allclose(source.world_from_camera(30 * MS).translation, (0.3, 0, 0))
    assert source.world_from_camera(200 * MS) is None


def test_without_a_trajectory_nobody_knows_the_pose():
    """A drone without odometry."""
    assert MemorySource(CAMERA, []).world_from_camera(0) is None
