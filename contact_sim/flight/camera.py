"""The simulated RGB-D camera as the client's live source."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Final

from contact_sim.errors import RenderError
from contact_sim.flight.live import LiveSimulation
from contact_sim.scene import Light
from contact_sim.sensing.rgbd import RgbdModel
from drone_client.errors import SourceError
from drone_client.source import Capture
from rgbd_wire.camera import RgbdCamera
from rgbd_wire.clock import Clock

RATE_HZ: Final = 15.0


class SimulatedCamera:
    """A ``LiveSource``: a picture at its rate, drawn on the thread that takes it.

    A machine that draws more slowly drops pictures, as a camera whose host is too slow.
    """

    def __init__(
        self,
        live: LiveSimulation,
        rig: RgbdCamera,
        light: Light,
        seed: int,
        clock: Clock,
        rate_hz: float = RATE_HZ,
        on_start: Callable[[], None] = lambda: None,
    ) -> None:
        """Take over the simulation's eyes.

        Args:
            live: the simulation.
            rig: its cameras.
            light: of its world.
            seed: of noise, dust and holes.
            clock: the drone's.
            rate_hz: pictures a second.
            on_start: called when a run begins.
        """
        self._live = live
        with live.look() as (simulation, _):
            self._model = simulation.model  # now: it takes long, and later the world would wait
        self._rig = rig
        self._light = light
        self._seed = seed
        self._clock = clock
        self._on_start = on_start
        self._period_ns = round(1e9 / rate_hz)
        self._stop = threading.Event()
        self._counts = {"given": 0, "dropped": 0}

    @property
    def camera(self) -> RgbdCamera:
        """The rig."""
        return self._rig

    def start(self) -> None:
        """Nothing to open: OpenGL belongs to the thread that takes the pictures."""
        self._on_start()

    def captures(self, timeout_s: float) -> Iterator[Capture | None]:
        """A picture every period.

        Raises:
            SourceError: nothing draws here without a screen.
        """
        try:
            eye = RgbdModel(self._model, self._rig, self._light, self._seed)
        except RenderError as error:
            raise SourceError(f"the simulated camera: {error}") from None
        try:
            yield from self._pictures(eye)
        finally:
            eye.close()

    def _pictures(self, eye: RgbdModel) -> Iterator[Capture]:
        due_ns = self._clock.now_ns()
        while not self._stop.wait(max(0, due_ns - self._clock.now_ns()) / 1e9):
            late = max(0, self._clock.now_ns() - due_ns) // self._period_ns
            self._counts["dropped"] += late
            due_ns += (late + 1) * self._period_ns
            snapshot, offset_ns = self._live.snapshot()
            picture = eye.take(snapshot)
            self._counts["given"] += 1
            name = str(self._counts["given"])
            yield Capture(picture.t_ns + offset_ns, picture.color_rgb, picture.depth_units, name)

    def counts(self) -> dict[str, int]:
        """Pictures that were given, and those that came too late to be drawn."""
        return dict(self._counts)

    def stop(self) -> None:
        """End ``captures``."""
        self._stop.set()
