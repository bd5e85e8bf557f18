"""The stages of one frame, with the real nesting and localiser behind a known detector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge_service.errors import ImageError
from edge_service.pipeline import MAX_REASON_CHARACTERS, bounded
from rgbd_wire.clock import ManualClock
from rgbd_wire.errors import DecodeError, Reject
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.frame_codec import unpack
from rgbd_wire.messages import Outcome
from target_pose.candidate import Box, Detections
from target_pose.localisation import Refusal
from target_pose.target import Level
from tests.unit.edge_service.edge_fakes import (
    CAMERA,
    CAMERA_FROM_TARGET,
    COLOR,
    DEPTH,
    TARGET,
    WORLD_FROM_CAMERA,
    KnownDetector,
    message,
    pipeline,
    tiny_frame,
    true_detections,
    with_broken_picture,
)

NOTHING = Detections(dict.fromkeys(Level, ()))
SHIFTED = Detections(  # three boxes that do not share a centre
    {level: (Box(40.0 * n, 0.0, 40.0 * n + 30, 30.0, 0.9),) for n, level in enumerate(Level)}
)


def frame(world_from_camera=WORLD_FROM_CAMERA, depth=DEPTH):
    return RgbdFrame(COLOR, depth, CAMERA, 0, world_from_camera)


def test_finds_the_target_where_it_was_drawn():
    """The pose out of a packed frame is the one of the scene, in the camera and in the world."""
    output = pipeline().process(unpack(message()))
    assert output.outcome is Outcome.TARGET
    assert output.reason == ""
    found = output.found
    got = found.localisation.camera_from_target
    np.testing.assert_allclose(got.translation, CAMERA_FROM_TARGET.translation, atol=2e-3)
    np.testing.assert_allclose(got.rotation[:, 0], [0, 0, -1], atol=0.02)
    # by hand: the camera looks along world x from (0, 0, 2), its right is world -y
    np.testing.assert_allclose(found.world_from_target.translation, [1.5, -0.05, 2.03], atol=2e-3)


def test_names_its_stages_in_order():
    """Every stage that ran is timed, by the clock that it was given."""
    output = pipeline(clock=ManualClock(3)).process(unpack(message()))
    assert list(output.stages_ns) == ["decode", "detect", "nest", "localise"]
    assert set(output.stages_ns.values()) == {0}


def test_without_a_pose_of_the_camera_there_is_none_in_the_world():
    """A drone that does not know where it is still gets the target in its camera."""
    output = pipeline().process(unpack(message(bare=True)))
    assert output.outcome is Outcome.TARGET
    assert output.found.world_from_target is None


@pytest.mark.parametrize(
    ("detections", "outcome", "stages"),
    [
        (NOTHING, Outcome.NOTHING_FOUND, ["detect"]),
        (SHIFTED, Outcome.NOT_A_TARGET, ["detect", "nest"]),
    ],
)
def test_says_why_there_is_no_target(detections, outcome, stages):
    """No box, and boxes that do not nest, are outcomes of their own with a reason."""
    output = pipeline(KnownDetector(detections)).locate(frame())
    assert output.outcome is outcome
    assert output.reason
    assert output.found is None
    assert list(output.stages_ns) == stages


def test_a_picture_that_does_not_decode_is_a_bad_frame():
    """A frame whole by its checksum but with a broken JPEG has a reason and reaches no detector."""
    detector = KnownDetector()
    output = pipeline(detector).process(unpack(with_broken_picture(message())))
    assert output.outcome is Outcome.BAD_FRAME
    assert output.reason.startswith("bad_color: ")
    assert list(output.stages_ns) == ["decode"]
    assert detector.seen == []


def test_of_several_frames_each_has_its_own_end():
    """A batch that fails is looked at one by one: only the one at fault is bad."""
    detector = KnownDetector()
    spoilt = ImageError("too small")

    def detect(color_rgb):
        if color_rgb is frames[1].color_rgb:
            raise spoilt
        return detector.detections

    detector.detect = detect
    frames = [frame(), replace(frame(), color_rgb=COLOR.copy()), frame(depth=None)]
    stages = [{}, {}, {}]
    made = pipeline(detector)
    seen = made.detect(frames, stages)
    assert seen == [detector.detections, spoilt, detector.detections]
    outputs = [made.conclude(*each) for each in zip(frames, seen, stages, strict=True)]
    assert [o.outcome for o in outputs] == [Outcome.TARGET, Outcome.BAD_FRAME, Outcome.TARGET]
    assert list(outputs[0].stages_ns) == ["detect", "nest", "localise"]


def test_a_picture_that_is_too_small_does_not_cost_the_others_their_batch():
    """It is singled out, and the rest goes through the detector at once, in order."""
    detector = KnownDetector()
    frames = [frame(), tiny_frame(8), frame(depth=None), tiny_frame(15)]
    made = pipeline(detector)
    seen = made.detect(frames, [{} for _ in frames])
    assert detector.batches == [2]
    assert [d is detector.detections for d in seen] == [True, False, True, False]
    for bad, size in ((1, "8x8"), (3, "15x15")):
        output = made.conclude(frames[bad], seen[bad], {})
        assert output.outcome is Outcome.BAD_FRAME
        assert output.reason.endswith(size)


def test_pictures_that_are_all_too_small_reach_no_detector():
    """Nothing is left to look at."""
    detector = KnownDetector()
    seen = pipeline(detector).detect([tiny_frame(8), tiny_frame(8)], [{}, {}])
    assert [type(what) for what in seen] == [ImageError, ImageError]
    assert detector.batches == detector.seen == []


def test_a_picture_that_the_detector_does_not_take_is_a_bad_frame():
    """A frame too small for the detector is the sender's fault, and is told why."""
    detector = KnownDetector(error=ImageError("a picture's side is 16 to 4096 px, not 8x8"))
    output = pipeline(detector).process(unpack(message()))
    assert output.outcome is Outcome.BAD_FRAME
    assert output.reason == "a picture's side is 16 to 4096 px, not 8x8"


def scripted(answers, calls):
    """A localiser that gives each answer in turn and keeps what it was asked."""

    def localise(*args):
        calls.append(args)
        return answers[len(calls) - 1]

    return localise


def with_candidates(n, answers, calls, **options):
    """A pipeline whose nesting gives ``n`` candidates, and those candidates."""
    nested = [pipeline().group(true_detections(s), TARGET, COLOR)[0] for s in SCORES[:n]]

    def group(*_):
        return tuple(nested)

    return replace(pipeline(**options), group=group, localise=scripted(answers, calls)), nested


SCORES = (0.99, 0.95, 0.9, 0.85)


def pose_of_scene():
    return pipeline().locate(frame()).found.localisation


def test_the_next_candidate_is_tried_when_the_best_has_no_pose():
    """A refusal of the best candidate is not the end; the answer says which one it was."""
    calls, good = [], pose_of_scene()
    made, candidates = with_candidates(4, [Refusal.TOO_SMALL, good], calls)
    output = made.locate(frame())
    assert output.outcome is Outcome.TARGET
    assert output.found.candidate is candidates[1]


def test_the_first_refusal_is_the_reason_and_only_so_many_are_tried():
    """With no pose at all the reason is the best candidate's, and the tries are bounded."""
    calls = []
    refusals = [Refusal.GRAZING, Refusal.TOO_SMALL, Refusal.BAD_BOX, Refusal.BAD_INPUT]
    made, _ = with_candidates(4, refusals, calls, max_candidates=2)
    output = made.locate(frame())
    assert (output.outcome, output.reason) == (Outcome.REFUSED, "grazing")
    assert len(calls) == 2


@pytest.mark.parametrize(
    ("world_from_camera", "level", "up"),
    [(WORLD_FROM_CAMERA, True, [0, -1, 0]), (WORLD_FROM_CAMERA, False, None), (None, True, None)],
)
def test_up_comes_from_the_world_only_where_there_is_a_level_one(world_from_camera, level, up):
    """The localiser is told where up is in the camera, or nothing at all."""
    calls = []
    made, _ = with_candidates(1, [Refusal.GRAZING], calls, world_is_level=level)
    made.locate(frame(world_from_camera))
    if up is None:
        assert calls[0][5] is None
    else:
        np.testing.assert_allclose(calls[0][5], up, atol=1e-12)


def test_a_reason_fits_the_wire():
    """A reason is one line of bounded length, with its end marked where it was cut."""
    assert bounded("a\n  b") == "a b"
    cut = bounded("x" * 500)
    assert len(cut) == MAX_REASON_CHARACTERS
    assert cut.endswith("...")


def test_only_bad_pictures_are_outcomes():
    """What is wrong with the detector is not the frame's fault: it goes up to the worker."""
    with pytest.raises(DecodeError):
        pipeline(KnownDetector(error=DecodeError(Reject.CHECKSUM, "not the frame's"))).locate(
            frame()
        )
