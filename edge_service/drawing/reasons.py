"""Refusals in words: what a person can do about them."""

from __future__ import annotations

from edge_service.pipeline import Output
from rgbd_wire.messages import Outcome
from target_pose.localisation import Refusal

_WORDS: dict[str, str] = {
    Refusal.BAD_INPUT: "picture or depth is not as the camera JSON says",
    Refusal.BAD_INTRINSICS: "the lens model cannot be inverted where the target is seen: check the "
    "camera JSON's coefficients and model",
    Refusal.BAD_BOX: "no box of it is finite, not empty and inside the picture",
    Refusal.TOO_SMALL: "its outer disc is under 8 px wide: fly nearer, or print it larger",
    Refusal.GRAZING: "seen from over 72 degrees off its normal: fly more in front of it",
    Refusal.INCONSISTENT: "circles and depth measure ranges that cannot both be true: check "
    "depth_scale_m, the print's size and the focal length (drone-client calibrate)",
    Refusal.POINTS_DISAGREE: "its points are not where any pose of the target would put them: "
    "check that the net's key points have the order of the target's [[points]]",
    Refusal.BEHIND_CAMERA: "the solution lies behind the camera, or shows the board's back; with "
    "labelled points: check their order",
    Refusal.NO_EVIDENCE: "no circle, no plane, and a box that the picture's border cuts",
}


def in_words(output: Output) -> str:
    """Why there is no target, with what to do where that is known."""
    if output.outcome is Outcome.REFUSED and output.reason in _WORDS:
        return f"{output.reason}: {_WORDS[output.reason]}"
    return output.reason
