"""A picture of a film: a flight through a real service, as the film of one shows it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import cv2

from contact_sim.figures.bench import LINK, SERVICE_WORDS, FigureBench
from contact_sim.figures.run import Run, fly
from contact_sim.figures.style import DPI, WIDTH_IN, new_figure
from contact_sim.lockstep.eyes import Eyes, Look
from contact_sim.lockstep.flight import LockstepFlight, LockstepSettings
from contact_sim.recording.film import CHASE, HEIGHT, RATE_HZ, WIDTH, Film
from contact_sim.recording.ink import Picture
from contact_sim.recording.reel import Reel
from contact_sim.recording.stage import Stage
from contact_sim.recording.truth import truth_line
from contact_sim.scene import build_scene
from contact_sim.sensing import d455
from drone_client.airframe import Airframe
from drone_client.encoding_choice import ChosenEncoding
from drone_client.mission import Phase
from drone_client.records import decision_record, reception_record
from drone_client.settings import default_settings
from drone_client.viewing.facts import facts_of
from drone_client.viewing.moments import (
    Level,
    Moment,
    Moved,
    Pictured,
    Said,
    Ticked,
    settled,
    truly,
)
from rgbd_wire.frame import RgbdFrame
from rgbd_wire.geometry import Pose

WORLD, SEED = "tunnel", 3
SHOWN_S: Final = 3.0
"""So long after the approach has begun the picture is."""
QUICK_S: Final = 5.0
TRUTH_NS: Final = 40_000_000


class Recorder:
    """Writes a flight in lockstep down as moments, its pictures into a folder."""

    def __init__(self, eyes: Eyes, folder: Path) -> None:
        self.needs_pictures = True
        self.moments: list[Moment] = []
        self._eyes = eyes
        self._folder = folder
        self._truth_due_ns = 0
        self._truth_ns = 0

    def look(
        self, frame: RgbdFrame, camera_from_target: Pose, chosen: ChosenEncoding | None = None
    ) -> Look:
        """Keep the picture, and let the others look."""
        path = self._folder / f"{frame.t_capture_ns}.png"
        cv2.imwrite(str(path), cv2.cvtColor(frame.color_rgb, cv2.COLOR_RGB2BGR))
        self.moments.append(Pictured(frame.t_capture_ns, path))
        return self._eyes.look(frame, camera_from_target, chosen)

    def before_tick(self, flight: LockstepFlight) -> None:
        """How it truly is, and where the drone believes to be."""
        now_ns = flight.simulation.t_ns
        if now_ns < self._truth_due_ns:
            return
        self._truth_due_ns = now_ns + TRUTH_NS
        self.moments.append(truly(truth_line(flight.simulation, now_ns, self._truth_ns)))
        self._truth_ns = now_ns
        state = flight.vehicle.state()
        if state is None or state.world_from_body is None or state.t_pose_ns is None:
            return
        self.moments.append(Moved(state.t_pose_ns, state.world_from_body, state.velocity_world))

    def all(self, run: Run) -> list[Moment]:
        """All moments of a flight that is over, in the order of time."""
        moments = list(self.moments)
        for reception in run.receptions:
            stamp = {"t_capture_ns": reception.result.t_capture_ns, "fate": "answered"}
            moments.append(settled(reception_record(reception) | stamp))
        for tick in run.flown.ticks:
            moments.append(Ticked(tick.t_ns, decision_record(tick.decision)))
            mission = tick.decision.mission
            if mission is not None and (change := mission.transition) is not None:
                sentence = f"{change.before} -> {change.after}: {change.sentence}"
                moments.append(Said(tick.t_ns, sentence, Level.INFO))
        return sorted(moments, key=lambda moment: moment.t_ns)


def draw(bench: FigureBench) -> tuple[Any, str]:
    """Fly with pictures, and draw one of the film's."""
    bench.tell("a flight to film", 0, 1)
    settings = LockstepSettings(longest_s=QUICK_S) if bench.quick else None
    scene = build_scene(WORLD, SEED)
    with TemporaryDirectory(prefix="film-") as folder:
        recorder = Recorder(bench.service, Path(folder))
        run = fly("film", scene, SEED, LINK, recorder, settings, recorder.before_tick)
        facts = facts_of(default_settings(), Airframe(), run.funnel, d455())
        reel = Reel(facts, recorder.all(run))
        times_ns = reel.times_ns(RATE_HZ)
        shown_s = (run.began(Phase.APPROACH) or 0.0) + SHOWN_S
        number = nearest(times_ns, round(1e9 * shown_s))
        with Stage(scene, facts, *CHASE) as stage:
            picture = Film(reel, stage, times_ns).picture(number)
    return _figure(picture), _caption(run, (times_ns[number] - times_ns[0]) / 1e9)


def nearest(times_ns: Sequence[int], t_ns: int) -> int:
    """Number of the time that is nearest to one."""
    return min(range(len(times_ns)), key=lambda i: abs(times_ns[i] - t_ns))


def _figure(picture: Picture) -> Any:
    """As it is, pixel for pixel of the figure's width."""
    height_in = WIDTH_IN * HEIGHT / WIDTH
    figure = new_figure(height_in)
    size = round(WIDTH_IN * DPI), round(height_in * DPI)
    figure.set_dpi(DPI)
    figure.set_layout_engine("none")
    figure.figimage(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    return figure


def _caption(run: Run, shown_s: float) -> str:
    return (
        f"A picture of the film of a flight in the {run.world} (seed {run.seed}), {shown_s:.1f} s "
        "after its beginning. Left, the chase camera: green the funnel that the tip may not leave, "
        "amber its way. Right, the drone's own picture with what its answer found, and in thin "
        "blue what the drone knew when it took it. Below, over the whole flight: h and the h that "
        f"is certain, d1 + d2 against tau_max, the force of the tip. Flown {SERVICE_WORDS}; other "
        "flights are filmed with drone-client fly --sim --video, and python -m contact_sim film."
    )
