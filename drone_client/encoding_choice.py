"""How the next frame is coded: the rate controller's rung, around where the target must be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drone_client.rate_control import Choice, RateController, RateSettings
from drone_client.region_of_interest import depth_region
from drone_client.target import TargetEstimate
from rgbd_wire.depth import DepthPlan, Region
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import Encoding

RANGE_MAX_M = 6.0
"""On a lean rung nothing past it is sent: nobody touches what is so far away, and stereo depth is
worth little there."""
REMEMBERED_NS = 3_000_000_000
"""A target that was seen so long ago tells no region any more."""


@dataclass(frozen=True, slots=True)
class ChosenEncoding:
    """A rung, and the region that goes with it."""

    choice: Choice
    encoding: Encoding

    def record(self) -> dict[str, Any]:
        """For the ledger."""
        plan = self.encoding.depth
        region = None if plan.region is None else list(plan.region)
        return self.choice.record() | {"depth_step": plan.step, "depth_region": region}


class EncodingChoice:
    """Asks the rate controller, and knows where the target was last."""

    def __init__(
        self, settings: RateSettings, estimate: Callable[[], TargetEstimate | None]
    ) -> None:
        self._rate = RateController(settings)
        self._estimate = estimate

    def choose(
        self, frame: RgbdFrame, now_ns: int, goodput_bytes_per_s: float | None
    ) -> ChosenEncoding:
        """For a frame that leaves now, drone's clock."""
        region = self._region(frame)
        lens = frame.camera.depth
        share = 0.0 if region is None else _area(region) / (lens.width * lens.height)
        choice = self._rate.choose(now_ns, goodput_bytes_per_s, share)
        plan, rung = DepthPlan(), choice.rung
        if rung.depth_step > 1:
            plan = DepthPlan(rung.depth_step, region if rung.region else None, RANGE_MAX_M)
        return ChosenEncoding(choice, Encoding(choice.jpeg_quality, plan))

    def weighed(self, chosen: ChosenEncoding, color_bytes: int, depth_bytes: int) -> None:
        """What the frame came to."""
        self._rate.weighed(chosen.choice, color_bytes, depth_bytes)

    def _region(self, frame: RgbdFrame) -> Region | None:
        estimate = self._estimate()
        if estimate is None or frame.world_from_camera is None:
            return None
        age_ns = frame.t_capture_ns - estimate.t_capture_ns
        if age_ns > REMEMBERED_NS:
            return None
        world_from_target = estimate.world_from_target
        return depth_region(world_from_target, frame.world_from_camera, age_ns, frame.camera)


def _area(region: Region) -> int:
    x0, y0, x1, y1 = region
    return (x1 - x0) * (y1 - y0)
