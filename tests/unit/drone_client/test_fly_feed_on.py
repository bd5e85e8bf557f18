"""After a flight the robot's VIO goes on to a vehicle that still flies, and no longer."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drone_client.errors import AutopilotError
from drone_client.fly.cockpit import View
from drone_client.mission import Phase
from drone_client.odometry import OdometrySample
from drone_client.odometry.source import MemoryOdometry
from drone_client.run_files import SUMMARY_NAME
from tests.unit.drone_client.builders import pose
from tests.unit.drone_client.test_fly import CLOCK, AtTheWall, Scene

WAITS = "fly it down by hand"


@pytest.fixture
def robot() -> Iterator[MemoryOdometry]:
    """A robot whose VIO says a hundred times a second where it is."""
    robot, stop = MemoryOdometry(), threading.Event()

    def run() -> None:
        while not stop.wait(0.01):
            robot.newest_odometry = OdometrySample(CLOCK.now_ns(), pose(), np.zeros(3))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield robot
    stop.set()
    thread.join()


class Pilot:
    """Takes the drone down when it has stayed in the air for a while after the flight."""

    def __init__(self, scene: Scene, down: Callable[[], None] | None = None) -> None:
        self.fed_ns: set[int] = set()
        """Stamps of what the vehicle was given since the flight was over."""
        self.summary: dict[str, Any] | None = None
        """As it lay on the disk meanwhile."""
        self._scene = scene
        self._down = down or self._disarm
        self._look_before = scene.person.on_view
        scene.person.on_view = self._look

    @property
    def waited(self) -> bool:
        return any(WAITS in told for told in self._scene.person.told)

    def _disarm(self) -> None:
        self._scene.vehicle.armed = False

    def _look(self, view: View) -> None:
        self._look_before(view)
        if not self.waited:
            return
        self.fed_ns.add(self._scene.vehicle.given_odometry.t_ns)
        if len(self.fed_ns) >= 5:
            path = self._scene.folder / SUMMARY_NAME
            self.summary = json.loads(path.read_text()) if path.exists() else None
            self._down()


def flown(scene: Scene, robot: MemoryOdometry, **options: Any) -> dict[str, Any]:
    """The summary of a flight beside a robot."""
    return scene.fly(robot, **({"feeds_on": True} | options))


def no_thread_is_left() -> bool:
    return "feed on" not in {t.name for t in threading.enumerate()}


def test_it_is_fed_until_the_motors_stand_still(tmp_path: Path, robot: MemoryOdometry) -> None:
    """Given back in the air, it holds its place by what goes on to it; the summary lies there."""
    scene = Scene(tmp_path)
    pilot = Pilot(scene)
    assert flown(scene, robot)["phase"] == "done", scene.person.told
    assert pilot.waited
    assert not scene.vehicle.armed
    assert pilot.summary is not None
    assert pilot.summary["phase"] == "done"
    assert no_thread_is_left()


def test_a_terminal_that_closes_does_not_end_it_and_ctrl_c_does(
    tmp_path: Path, robot: MemoryOdometry
) -> None:
    """Whoever says so takes it over."""
    scene, hung_up = Scene(tmp_path), []

    def end() -> None:
        if not hung_up:
            hung_up.append(True)
            signal.raise_signal(signal.SIGHUP)
        else:
            raise KeyboardInterrupt

    Pilot(scene, end)
    scene.person.answer = False
    before = signal.getsignal(signal.SIGHUP)
    assert not flown(scene, robot)["agreed"]
    assert hung_up
    assert scene.vehicle.armed
    assert scene.person.told[-1] == "no VIO is passed on to the vehicle any more"
    assert signal.getsignal(signal.SIGHUP) == before
    assert no_thread_is_left()


def test_a_flight_that_fails_in_the_air_is_fed_as_well(
    tmp_path: Path, robot: MemoryOdometry
) -> None:
    """What went wrong is told before the wait, for a person has to act on it."""

    class Lost(AtTheWall):
        def state(self):
            return replace(super().state(), world_from_body=None)

    scene = Scene(tmp_path, Lost())
    pilot = Pilot(scene)
    with pytest.raises(AutopilotError, match="does not say where it is"):
        flown(scene, robot, wait_for_vehicle_s=0.2)
    assert pilot.waited
    assert "does not say where it is" in scene.person.told[-2]
    assert no_thread_is_left()


@pytest.mark.parametrize("why", ["on the ground", "silent", "a dry run", "fed by others"])
def test_nobody_is_waited_for_without_need(tmp_path: Path, robot: MemoryOdometry, why: str) -> None:
    """Motors that stand still, a VIO that never spoke, a run that feeds nothing."""
    scene = Scene(tmp_path, AtTheWall(armed=why != "on the ground"))
    scene.person.answer = False
    options: dict[str, Any] = {}
    if why == "a dry run":
        options["dry_run"] = True
        scene.when(Phase.ALIGN, interrupt)
    elif why == "fed by others":
        options["feeds_on"] = False
    flown(scene, MemoryOdometry() if why == "silent" else robot, **options)
    assert not any(WAITS in told for told in scene.person.told)
    assert no_thread_is_left()


def interrupt() -> None:
    raise KeyboardInterrupt
