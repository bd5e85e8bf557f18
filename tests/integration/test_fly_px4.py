"""A flight of real parts: pictures, a service process, Zenoh, MAVLink over UDP, a PX4-like process.

What is not real is the camera: the board is rendered from where the PX4-like vehicle says it is.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drone_client.airframe import Airframe
from drone_client.autopilot.choose import open_autopilot
from drone_client.autopilot.mavlink import MavlinkAutopilot
from drone_client.cbf import Funnel
from drone_client.flight_settings import flight_settings
from drone_client.fly.cockpit import View
from drone_client.fly.run import FlyOptions, fly
from drone_client.fly.vehicle_pose import VehiclePose
from drone_client.link.choose import open_link
from drone_client.run_files import EVENTS_NAME, TICKS_NAME
from drone_client.settings import ClientSettings
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.geometry import Pose
from tests.integration.px4_process import PeerProcess, mode, until
from tests.integration.rendered_camera import RenderedCamera
from tests.service_process import free_udp_port, service_process

CLOCK = MonotonicClock()
AIRFRAME = Airframe()
AHEAD_M, BESIDE_M, ABOVE_M = 1.5, 0.08, 0.05


def board_before(world_from_body: Pose) -> Pose:
    """``world_from_target`` of an upright board that faces a drone, a little off its nose."""
    forward = world_from_body.rotation[:, 0]
    yaw = math.atan2(forward[1], forward[0])
    ahead, left = (
        np.array([math.cos(yaw), math.sin(yaw), 0]),
        np.array([-math.sin(yaw), math.cos(yaw), 0]),
    )
    up = np.array([0.0, 0.0, 1.0])
    place = world_from_body.translation + AHEAD_M * ahead + BESIDE_M * left + ABOVE_M * up
    return Pose.from_rotation(np.column_stack([-ahead, -left, up]), place)


class Person:
    """Says yes; looks at where the tip truly is."""

    def __init__(self, vehicle: MavlinkAutopilot, world_from_target: Pose) -> None:
        self.told: list[str] = []
        self.tips: list[np.ndarray] = []
        self._vehicle = vehicle
        self._target_from_world = world_from_target.inverse()

    def may_fly(self, view: View) -> bool:
        return True

    def show(self, view: View) -> None:
        state = self._vehicle.state()
        tip = self._target_from_world @ state.world_from_body @ AIRFRAME.body_from_tip
        self.tips.append(tip.translation)

    def tell(self, sentence: str) -> None:
        self.told.append(sentence)


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> dict[str, Any]:
    """One mission, from a hover in POSCTL to the hold after it."""
    folder: Path = tmp_path_factory.mktemp("fly-px4")
    port = free_udp_port()
    peer = PeerProcess("--udp", f"127.0.0.1:{port}")
    vehicle = open_autopilot(f"udp/127.0.0.1:{port}", CLOCK)
    try:
        with service_process(folder) as service:
            until(lambda: vehicle.state() and vehicle.state().world_from_body, "a pose")
            board = board_before(vehicle.state().world_from_body)
            person = Person(vehicle, board)
            pose_at = VehiclePose(vehicle.state, lambda t_ns, pose: None)

            def camera_at(t_ns: int) -> Pose | None:
                world_from_body = pose_at(t_ns)
                return world_from_body and world_from_body @ AIRFRAME.body_from_camera

            settings = ClientSettings(connect=service.endpoint, tau_max_ms=500, age_max_ms=600)
            parts = flight_settings(settings)
            mission = replace(parts.control.mission, standoff_m=0.5, dwell_s=0.5, hold_max_s=30.0)
            # a busy machine's pictures are old: the ball is larger, and so is the mouth
            wide = replace(parts.control.filter, funnel=Funnel(r_c_m=0.03))
            control = replace(
                parts.control, mission=mission, filter=wide, keep_outs=AIRFRAME.keep_outs
            )
            link = open_link(settings, CLOCK)
            try:
                summary = fly(
                    RenderedCamera(CLOCK, board, camera_at),
                    vehicle,
                    AIRFRAME,
                    settings,
                    replace(parts, control=control),
                    FlyOptions(folder / "run", plot=True, wait_for_vehicle_s=30),
                    link,
                    CLOCK,
                    person,
                )
            finally:
                link.close()
            until(lambda: mode(vehicle) != "OFFBOARD", "given back")
        report = peer.report()
    finally:
        vehicle.close()
        peer.close()

    def lines(name: str) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (folder / "run" / name).read_text().splitlines()]

    return {
        "summary": summary,
        "peer": report,
        "tips": np.array(person.tips),
        "told": person.told,
        "phases": [e["after"] for e in lines(EVENTS_NAME) if e["event"] == "phase"],
        "ticks": lines(TICKS_NAME),
        "picture": folder / "run" / "run.png",
    }


def test_it_touches_and_comes_back(flight):
    """Through search, alignment, approach, contact and retreat, and the vehicle is given back."""
    assert flight["summary"]["phase"] == "done", flight["told"]
    for phase in ("align", "approach", "contact", "retreat", "done"):
        assert phase in flight["phases"]
    assert flight["picture"].stat().st_size > 10_000
    assert flight["summary"]["control_errors"] == 0


def test_the_board_is_met_inside_the_mouth_alone(flight):
    """Where the tip truly was: pressed, near the centre, never beside it."""
    tips = flight["tips"]
    pressed = tips[tips[:, 0] < 0]
    assert len(pressed)
    assert np.hypot(pressed[:, 1], pressed[:, 2]).max() < 0.03
    assert tips[:, 0].min() > -0.05


def test_the_vehicle_was_flown_by_its_rules(flight):
    """The PX4-like process saw no rule broken, and got the right messages at the right rate."""
    assert flight["peer"]["violations"] == []


def test_what_it_was_flown_by_is_in_the_ledger(flight):
    """Every tick has its phase; contact was flown on fresh knowledge."""
    ticks = flight["ticks"]
    assert all("phase" in t for t in ticks)
    touching = [t for t in ticks if t["phase"] == "contact"]
    assert touching
    assert sum(t["freshness"] == "fresh" for t in touching) > 0.5 * len(touching)
