"""Labelled points on the sheet: where the net saw them, and where the pose puts them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_service.drawing.draw import draw
from edge_service.drawing.findings import Findings
from edge_service.drawing.scene import CIRCLE_RGB, USED_RGB
from edge_service.pipeline import Found, Output
from rgbd_wire.messages import Outcome
from target_pose.candidate import Box, Candidate, Detections
from target_pose.pnp import localise_pnp
from target_pose.points import BoardPoint, PointPx
from target_pose.target import Level, Shade, Target
from tests.unit.edge_service.edge_fakes import CAMERA, COLOR, INTRINSICS
from tests.unit.target_pose.render import facing_pose, seen_pixels

PLACES = ((-0.15, 0.15), (0.15, 0.14), (0.14, -0.15), (-0.13, -0.12), (0.02, 0.05), (0.1, -0.04))
POINTS = tuple(BoardPoint(f"p{k}", y, z) for k, (y, z) in enumerate(PLACES))
TARGET = Target("panel", 0.4, Shade.WHITE, (), {Level.GOOD: 0.4}, points=POINTS)
POSE = facing_pose([0.05, 0.0, 1.1], 0.4, 1.0, 2.0)


@pytest.mark.parametrize("lost", [None, math.nan, -1e9])
def test_seen_points_are_dots_and_predicted_ones_crosses(lost):
    """Both colours are on the sheet near each point; one that is nowhere is survived."""
    uv = seen_pixels(POSE @ np.array([(0.0, y, z) for y, z in PLACES]), INTRINSICS)
    seen = [PointPx(float(u), float(v), 0.9) for u, v in uv + 0.5]
    if lost is not None:
        seen[0] = PointPx(lost, lost, 0.9)
    box = Box(100.0, 60.0, 220.0, 180.0, 0.9, tuple(seen))
    points = {p.name: s for p, s in zip(POINTS, seen, strict=True)}
    candidate = Candidate({Level.GOOD: box}, 0.9, points)
    located = localise_pnp(COLOR, None, CAMERA, candidate, TARGET)
    output = Output(Outcome.TARGET, found=Found(candidate, located, None))
    sheet = draw(COLOR, INTRINSICS, TARGET, Findings(Detections({Level.GOOD: (box,)}), output))
    scale = 4.0  # 320 x 240 fitted into 1600 x 960
    for u, v in uv[1:]:
        at = np.array([v, u]) * scale + (scale - 1) / 2
        row, column = (int(x) for x in at)
        near = sheet[row - 12 : row + 13, column - 12 : column + 13].reshape(-1, 3)
        assert (near == USED_RGB).all(axis=1).any()
        assert (np.abs(near - np.array(CIRCLE_RGB)).max(axis=1) < 60).any()
