"""The encoding of the next frame: the rung that fits, around where the target must be."""

from __future__ import annotations

import numpy as np

from drone_client.encoding_choice import RANGE_MAX_M, REMEMBERED_NS, EncodingChoice
from drone_client.rate_control import RateSettings, Reason
from drone_client.region_of_interest import depth_region
from drone_client.target import TargetEstimate
from rgbd_wire.camera import CameraIntrinsics, RgbdCamera
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import compress
from rgbd_wire.geometry import Pose
from tests.unit.drone_client.builders import MS, SECOND, pose

HERE = Pose.identity()
WORLD_FROM_TARGET = pose((0.0, 0.0, 4.0))
LENS = CameraIntrinsics(160, 120, 200.0, 200.0, 79.5, 59.5)
CAMERA = RgbdCamera(LENS, LENS, 0.001, Pose.identity())


def frame(t_capture_ns: int, world_from_camera: Pose | None = None) -> RgbdFrame:
    """Noise, which no codec makes small."""
    rng = np.random.default_rng(0)
    color = rng.integers(0, 255, (120, 160, 3), np.uint8)
    depth = rng.integers(1000, 5000, (120, 160), np.uint16)
    return RgbdFrame(color, depth, CAMERA, t_capture_ns, world_from_camera)


SLOW = compress(frame(0)).size_bytes * 0.7 / 0.080
"""Bytes a second: a bit less than the best rung needs."""


def estimate_of(t_capture_ns: int = 0) -> TargetEstimate:
    """A target 4 m ahead."""
    return TargetEstimate(WORLD_FROM_TARGET, np.eye(6) * 1e-6, t_capture_ns, 4.0)


def choose(estimate, goodput, t_ns=100 * MS, world_from_camera=HERE):
    """The choice for a frame, after one at its best has been weighed."""
    choice = EncodingChoice(RateSettings(80 * MS), lambda: estimate)
    first = choice.choose(frame(0, world_from_camera), 0, None)
    compressed = compress(frame(0, world_from_camera), first.encoding)
    choice.weighed(first, len(compressed.color), compressed.depth.size_bytes)
    return choice.choose(frame(t_ns, world_from_camera), t_ns, goodput)


def test_on_a_link_that_carries_it_everything_is_sent():
    """The best rung has no region and no range."""
    chosen = choose(estimate_of(), 1e9)
    assert chosen.choice.reason is Reason.FITS
    assert chosen.encoding.depth.step == 1
    assert chosen.encoding.depth.range_max_m is None


def test_on_a_slow_link_the_region_is_where_the_target_must_be():
    """Lean outside, whole inside, nothing past 6 m; and the ledger hears of it."""
    chosen = choose(estimate_of(), SLOW)
    plan = chosen.encoding.depth
    assert plan.step > 1
    assert plan.range_max_m == RANGE_MAX_M
    assert plan.region == depth_region(WORLD_FROM_TARGET, HERE, 100 * MS, CAMERA)
    record = chosen.record()
    assert record["depth_region"] == list(plan.region)
    assert record["depth_step"] == plan.step


def test_without_a_target_a_pose_or_a_lately_seen_one_there_is_no_region():
    """The whole picture goes out lean: a target may be anywhere in it."""
    for chosen in (
        choose(None, SLOW),
        choose(estimate_of(), SLOW, world_from_camera=None),
        choose(estimate_of(), SLOW, t_ns=REMEMBERED_NS + SECOND),
        choose(estimate_of(), SLOW, world_from_camera=pose((0, 0, 9.0))),  # it lies behind
    ):
        assert chosen.encoding.depth.region is None
        assert chosen.encoding.depth.step > 1


def test_on_the_last_rung_there_is_no_region_either():
    """A link on which nothing else gets through."""
    chosen = choose(estimate_of(), SLOW / 100)
    assert chosen.choice.reason is Reason.TOO_SLOW
    assert chosen.encoding.depth.region is None
