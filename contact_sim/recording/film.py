"""The film of a flight: chase camera, the drone's own picture, and curves with a cursor."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_sim.errors import FilmError
from contact_sim.recording.chase import chase
from contact_sim.recording.curves import Curves
from contact_sim.recording.encoder import VideoFile
from contact_sim.recording.ink import AMBER, Picture, softened
from contact_sim.recording.panels import draw_outlines, eye_panel, way_outline, write_mission
from contact_sim.recording.reel import Reel, load_reel
from contact_sim.recording.stage import OVERSAMPLE, Stage
from contact_sim.scene import Scene
from drone_client.viewing.outlines import Outline, funnel_outlines
from rgbd_wire.geometry import Pose

RATE_HZ: Final = 25.0
WIDTH, HEIGHT = 1280, 720
CHASE: Final = 680, 450
"""Size of the chase camera's window; the drone's own has the rest of the width."""
TRAIL_NS: Final = 8_000_000_000
"""So long the way of the tip stays in the picture."""
NEWS_NS: Final = 3_000_000_000
"""So long a sentence stays."""


class Film:
    """Draws one picture of it at a time; belongs to the thread that made it."""

    def __init__(self, reel: Reel, stage: Stage, times_ns: list[int]) -> None:
        self._reel = reel
        self._stage = stage
        self._times_ns = times_ns
        self._curves = Curves(reel, WIDTH, HEIGHT - CHASE[1])
        self._funnel: list[Outline] = funnel_outlines(reel.facts)
        self._news_ns = [s.t_ns for s in reel.sayings]
        drone = np.array([reel.at(t).truth.world_from_body.translation for t in times_ns])
        board = reel.truths[0].world_from_target
        self._world_from_camera = chase(
            drone, board.translation, board.rotation[:, 0], RATE_HZ, stage.free_m
        )
        self._tips_world = np.array(
            [m.world_from_body @ reel.facts.body_from_tip.translation for m in reel.truths]
        )
        self._truth_ns = [m.t_ns for m in reel.truths]

    def picture(self, number: int) -> Picture:
        """One picture (HEIGHT, WIDTH, 3)."""
        t_ns = self._times_ns[number]
        instant = self._reel.at(t_ns)
        world_from_camera = self._world_from_camera[number]
        scene = softened(self._stage.picture(self._reel.snapshot(t_ns), world_from_camera))
        self._draw_over(scene, t_ns, world_from_camera, instant.truth.world_from_target)
        write_mission(scene, instant, self._reel.start_ns, self._news(t_ns))
        width, height = CHASE
        picture = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
        picture[:height, :width] = scene
        picture[:height, width:] = eye_panel(instant, self._reel.facts, WIDTH - width, height)
        picture[height:] = self._curves.at(instant)
        return picture

    def _draw_over(
        self, scene: Picture, t_ns: int, world_from_camera: Pose, world_from_target: Pose
    ) -> None:
        """The funnel that the tip may not leave, and the way that it took."""
        camera_from_world, intrinsics = world_from_camera.inverse(), self._stage.intrinsics
        camera_from_target = camera_from_world @ world_from_target
        scale = 1.0 / OVERSAMPLE
        draw_outlines(scene, self._funnel, camera_from_target, intrinsics, scale, 0.4)
        way = self._trail(t_ns)
        if len(way) > 1:
            line = [way_outline(way, AMBER)]
            draw_outlines(scene, line, camera_from_world, intrinsics, scale, 0.8)

    def _trail(self, t_ns: int) -> NDArray[np.float64]:
        first = bisect_right(self._truth_ns, t_ns - TRAIL_NS)
        return self._tips_world[first : bisect_right(self._truth_ns, t_ns)]

    def _news(self, t_ns: int) -> str | None:
        newest = bisect_right(self._news_ns, t_ns) - 1
        if newest < 0 or t_ns - self._news_ns[newest] > NEWS_NS:
            return None
        return self._reel.sayings[newest].sentence


def film(run: Path, scene: Scene, path: Path, on_progress: Callable[[float], None]) -> None:
    """Draw the flight in a run's folder into a video.

    Args:
        run: of a simulated flight, with pictures.
        scene: the world that it was flown in.
        path: .mp4 or .webm.
        on_progress: told the share that is done.

    Raises:
        FilmError: it was not recorded, the video cannot be written, or somebody gave it up.
        RenderError: no OpenGL draws here without a screen.
    """
    try:
        reel, _ = load_reel(run)
        draw_film(reel, scene, path, on_progress)
    except KeyboardInterrupt:
        raise FilmError(
            f"{path} was given up; this makes it: python -m contact_sim film {run} {path}"
        ) from None


def draw_film(reel: Reel, scene: Scene, path: Path, on_progress: Callable[[float], None]) -> None:
    """Draw a flight into a video; an interrupt leaves nothing of it.

    Args:
        reel: the flight.
        scene: the world that it was flown in.
        path: .mp4 or .webm.
        on_progress: told the share that is done.

    Raises:
        FilmError: the video cannot be written.
        RenderError: no OpenGL draws here without a screen.
    """
    times_ns = reel.times_ns(RATE_HZ)
    with (
        Stage(scene, reel.facts, *CHASE) as stage,
        VideoFile(path, WIDTH, HEIGHT, RATE_HZ) as video,
    ):
        drawn = Film(reel, stage, times_ns)
        for number in range(len(times_ns)):
            video.add(drawn.picture(number))
            on_progress((number + 1) / len(times_ns))
