"""The two windows of a film: the drone's own picture, and words over the chase camera's."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from contact_sim.recording.ink import (
    AMBER,
    GREEN,
    GREY,
    PAPER,
    RED,
    WHITE,
    Color,
    Picture,
    line,
    rgb,
    shade,
    softened,
    write,
)
from contact_sim.recording.reel import Instant
from drone_client.gate import Verdict
from drone_client.ledger import Fate
from drone_client.viewing.facts import FlightFacts
from drone_client.viewing.moments import Settled
from drone_client.viewing.outlines import Outline, board_outlines
from drone_client.viewing.overlay import caption, marks, project
from rgbd_wire.camera import CameraIntrinsics
from rgbd_wire.geometry import Pose

PHASE_COLORS: Final[dict[str, Color]] = {
    "search": (95, 155, 255),
    "align": (60, 200, 200),
    "approach": AMBER,
    "contact": GREEN,
    "retreat": (190, 130, 255),
    "done": GREEN,
    "abort": RED,
    "brake": RED,
}
"""Of the mission's phases; of the others grey."""
_UNSETTLED: Final = frozenset({Fate.SUPERSEDED_ON_BOARD.value, Verdict.NOT_LOOKED_AT.value})
"""A frame like this says nothing for or against the link."""
BAR_PX: Final = 30
KNOWN: Final[Color] = (120, 200, 255)


def eye_panel(instant: Instant, facts: FlightFacts, width: int, height: int) -> Picture:
    """The newest picture of the drone's camera, what its answer found in it, and what was known.

    Known is a thin square: where the drone believed the board to be when it took the picture.
    """
    panel = _photo(instant, width, height)
    answer, camera = instant.answer, facts.camera.color
    scale = np.array([width, height]) / (camera.width, camera.height)
    if instant.known is not None:
        for outline in board_outlines(facts)[:1]:
            pixels = project(outline.points, instant.known, camera)
            if pixels is not None:
                line(panel, (pixels + 0.5) * scale - 0.5, KNOWN, 1)
    if answer is not None:
        for mark in marks(answer, facts):
            line(panel, (mark.points_px + 0.5) * scale - 0.5, rgb(mark.color), 2)
    shade(panel, 0, height - BAR_PX, width, height)
    write(panel, *_verdict(answer, (12, height - 10)))
    write(panel, "the drone's camera", (width - 12, height - 10), 14, GREY, right=True)
    return panel


def write_mission(picture: Picture, instant: Instant, start_ns: int, sentence: str | None) -> None:
    """Phase, time and distance along the top of the chase camera's picture; news below."""
    height, width = picture.shape[:2]
    tick = {} if instant.tick is None else instant.tick.line
    phase = str(tick.get("phase", "waiting"))
    shade(picture, 0, 0, width, 40)
    write(picture, phase, (14, 28), 24, PHASE_COLORS.get(phase, GREY), bold=True)
    told = [f"{(instant.t_ns - start_ns) / 1e9:.1f} s"]
    if (tip := tick.get("tip_target_m")) is not None:
        told.insert(0, f"tip {tip[0]:.2f} m before the board")
    write(picture, "   ".join(told), (width - 12, 27), 17, WHITE, right=True)
    if sentence is not None:
        shade(picture, 0, height - BAR_PX, width, height)
        write(picture, sentence, (14, height - 10), 14, WHITE)


def draw_outlines(
    picture: Picture,
    outlines: list[Outline],
    camera_from_frame: Pose,
    intrinsics: CameraIntrinsics,
    scale: float,
    opacity: float,
) -> None:
    """Lines of a frame over what a camera sees, thin and half transparent."""
    layer = picture.copy()
    for outline in outlines:
        pixels = project(outline.points, camera_from_frame, intrinsics)
        if pixels is not None:
            line(layer, (pixels + 0.5) * scale - 0.5, rgb(outline.color), 1)
    cv2.addWeighted(layer, opacity, picture, 1.0 - opacity, 0.0, dst=picture)


def way_outline(way_world: NDArray[np.float64], color: Color) -> Outline:
    """The last part of a way as a line in the world."""
    r, g, b = (c / 255 for c in color)
    return Outline(way_world, (r, g, b))


def _photo(instant: Instant, width: int, height: int) -> Picture:
    if instant.picture is not None:
        bgr = cv2.imread(str(instant.picture.path), cv2.IMREAD_COLOR)
        if bgr is not None:
            rgb_picture = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
            return softened(cv2.resize(rgb_picture, (width, height), interpolation=cv2.INTER_AREA))
    blank: Picture = np.full((height, width, 3), PAPER, dtype=np.uint8)
    write(blank, "no picture", (width // 2 - 40, height // 2), 18, GREY)
    return blank


def _verdict(
    answer: Settled | None, at: tuple[int, int]
) -> tuple[str, tuple[int, int], int, Color]:
    if answer is None:
        return "no answer", at, 16, GREY
    color = GREEN if answer.accepted else GREY if answer.verdict in _UNSETTLED else RED
    return caption(answer), at, 16, color
