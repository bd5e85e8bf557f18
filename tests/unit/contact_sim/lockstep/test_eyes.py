"""A worker's answers without pictures."""

from __future__ import annotations

import numpy as np
import pytest

from contact_sim.chance import stream
from contact_sim.lockstep.eyes import EyesSettings, ModelEyes
from contact_sim.sensing import d455
from drone_client.encoding_choice import EncodingChoice
from drone_client.rate_control import RateSettings
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose, rotation_from_vector
from rgbd_wire.messages import Outcome, pose_of, unpack_covariance

COLOR = CameraIntrinsics(640, 480, 385.0, 385.0, 319.5, 239.5)
SURE = EyesSettings(found=1.0)
RIG = d455()
BLACK = RgbdFrame(np.zeros((480, 640, 3), np.uint8), None, RIG, 0, None)


def board(x: float = 0.0, y: float = 0.0, z: float = 1.0, turned_rad: float = 0.0) -> Pose:
    """``camera_from_target`` of a board that faces the camera, turned about the vertical."""
    facing = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    turn = rotation_from_vector(np.array([0.0, turned_rad, 0.0]))
    return Pose.from_rotation(turn @ facing, np.array([x, y, z]))


def look(at: Pose, seed: int = 0, settings: EyesSettings = SURE, **flags: bool):
    eyes = ModelEyes(COLOR, stream(seed, "eyes"), settings)
    for name, value in flags.items():
        setattr(eyes, name, value)
    return eyes.look(BLACK, at)


@pytest.mark.parametrize(
    ("at", "seen"),
    [
        (board(z=1.0), True),
        (board(z=4.9), True),
        (board(z=5.1), False),
        (board(z=0.3), True),
        (board(z=0.25), False),
        (board(x=0.6), True),
        (board(x=0.9), False),
        (board(y=-0.7), False),
        (board(z=-1.0), False),
        (board(turned_rad=1.0), True),
        (board(turned_rad=1.3), False),
        (board(turned_rad=np.pi), False),
    ],
)
def test_what_is_in_view_is_found(at: Pose, seen: bool) -> None:
    """The inner half of the board in the picture, in range, and from the front."""
    assert (look(at).outcome is Outcome.TARGET) == seen


def test_somebody_before_the_board_hides_it() -> None:
    """Nothing found, which is an answer."""
    assert look(board(), occluded=True).outcome is Outcome.NOTHING_FOUND


def test_the_share_that_is_found_is_the_settings() -> None:
    """19 of 20; in the dark three fifths of them."""
    for dark, share in ((False, 0.95), (True, 0.57)):
        eyes = ModelEyes(COLOR, stream(2, "eyes"))
        eyes.dark = dark
        hits = [eyes.look(BLACK, board()).target is not None for _ in range(4000)]
        assert np.mean(hits) == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("range_m", [0.5, 1.0, 3.0])
def test_its_covariance_is_honest(range_m: float) -> None:
    """Over many flights the squared error over the covariance is chi-square's, on average."""
    at = board(z=range_m)
    place, turned = [], []
    for seed in range(1500):
        target = look(at, seed).target
        assert target is not None
        covariance = unpack_covariance(target.covariance)
        seen = pose_of(target.camera_from_target)
        off = seen.translation - at.translation
        place.append(off @ np.linalg.solve(covariance[:3, :3], off))
        cosine = (np.trace(seen.rotation @ at.rotation.T) - 1) / 2
        turned.append(np.arccos(np.clip(cosine, -1, 1)) ** 2 / covariance[3, 3])
    assert np.mean(place) == pytest.approx(3.0, rel=0.1)
    assert np.mean(turned) == pytest.approx(3.0, rel=0.1)


def test_a_leaner_encoding_weighs_less() -> None:
    """What the ladder says of its rungs; the best weighs what was measured."""
    choice = EncodingChoice(RateSettings(80_000_000), lambda: None)
    eyes = ModelEyes(COLOR, stream(0, "eyes"), SURE)
    sizes = []
    for goodput in (None, 1e7, 3e5, 1e5):
        chosen = choice.choose(BLACK, len(sizes), goodput)
        look = eyes.look(BLACK, board(), chosen)
        choice.weighed(chosen, *look.sizes[1:])
        sizes.append(look.sizes[0])
    assert sizes[0] == sizes[1] == eyes.look(BLACK, board()).sizes[0]
    assert sizes[1] > 2 * sizes[2] > 2 * sizes[3]
