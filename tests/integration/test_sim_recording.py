"""A simulated flight and what people get to look at of it: film, log, live view."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner
from websockets.sync.client import connect

from contact_sim.flight.world import SimulatedWorld
from contact_sim.recording.command import film
from contact_sim.recording.film import CHASE, HEIGHT, RATE_HZ, WIDTH
from contact_sim.scene import build_scene
from drone_client.airframe import Airframe
from drone_client.autopilot import VelocityCommand
from drone_client.cbf import Funnel
from drone_client.errors import WorldError
from drone_client.settings import load_settings
from drone_client.viewing.command import write_mcap
from drone_client.viewing.facts import facts_of
from drone_client.viewing.live import Address, LiveView
from drone_client.viewing.recorder import FlightRecorder
from drone_client.viewing.run_folder import RunFolder
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.messages import pose_numbers
from tests.service_process import free_port
from tests.unit.drone_client.view_builders import write_lines, write_run

SECONDS = 1.5


def fly(folder: Path, world: SimulatedWorld) -> None:
    """So long straight ahead, through the client's own recorder; the ledger as it would be."""
    clock = MonotonicClock()
    write_lines(folder / "ledger.jsonl", [])
    recorder = FlightRecorder(
        world.camera,
        world.vehicle.state,
        folder,
        lambda rig: facts_of(load_settings(), Airframe(), Funnel(), rig),
        pictures=True,
    )
    recorder.start()
    world.start()
    world.vehicle.engage()
    frames, ticks = [], []
    for capture in recorder.captures(0.1):
        now_ns = clock.now_ns()
        if ticks and now_ns - ticks[0]["t_ns"] > SECONDS * 1e9:
            break
        assert capture is not None
        world.vehicle.command(VelocityCommand(np.array([0.1, 0.0, 0.0]), 0.0, now_ns))
        with world.live.look() as (simulation, _):
            body = simulation.truth.world_from_body
        seen = (body @ Airframe().body_from_camera).inverse() @ world.scene.world_from_target
        ticks.append({"t_ns": now_ns, "known": "target", "phase": "search", "h_m": 1.0})
        frames.append(
            {
                "sequence": len(frames),
                "fate": "answered",
                "t_capture_ns": capture.t_source_ns,
                "t1_ns": now_ns,
                "t4_ns": now_ns + 50_000_000,
                "network_delay_ms": 20.0,
                "age_ms": 60.0,
                "verdict": "accepted",
                "outcome": "target",
                "camera_from_target": list(pose_numbers(seen)),
                "world_from_target": list(pose_numbers(world.scene.world_from_target)),
            }
        )
    recorder.stop()
    assert recorder.report()["unwritten"] == []
    write_lines(folder / "ledger.jsonl", frames)
    write_lines(folder / "ticks.jsonl", ticks)
    write_lines(folder / "events.jsonl", [])


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimulatedWorld]:
    folder = tmp_path_factory.mktemp("flight")
    world = SimulatedWorld(build_scene("tunnel", 1), 1, MonotonicClock(), folder)
    try:
        fly(folder, world)
    finally:
        world.close()
    return folder, world


def test_a_flight_becomes_a_film(flight: tuple[Path, SimulatedWorld]):
    """Of its length and size; the world on the left, the drone's own picture on the right."""
    folder, world = flight
    path, shares = folder / "film.webm", []
    world.film(folder, path, shares.append)
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    video, pictures = cv2.VideoCapture(str(path)), []
    while (answer := video.read())[0]:
        pictures.append(answer[1])
    assert pictures[0].shape == (HEIGHT, WIDTH, 3)
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(RATE_HZ)
    assert len(pictures) == len(shares)
    assert 0.5 * SECONDS * RATE_HZ < len(pictures) < 3 * SECONDS * RATE_HZ
    width, height = CHASE
    middle = pictures[len(pictures) // 2].astype(int)
    scene = middle[60 : height - 40, 20 : width - 20]
    assert 20 < scene.mean() < 200
    assert scene.std() > 10
    # the hull is orange, and nothing else in a tunnel is; BGR
    orange = (scene[..., 2] - scene[..., 0] > 70) & (scene[..., 2] > 90)
    assert orange.sum() > 100
    assert any((p[:, width:, 1].astype(int) - p[:, width:, 2] > 80).any() for p in pictures)


def test_a_film_needs_a_folder_to_go_to(flight: tuple[Path, SimulatedWorld]):
    """It is the client's error, in one sentence."""
    folder, world = flight
    with pytest.raises(WorldError, match="cannot be written: no such folder"):
        world.film(folder, folder / "nowhere" / "film.webm", lambda share: None)


def test_a_film_is_made_again_from_the_files_alone(flight: tuple[Path, SimulatedWorld]):
    """By its command; the world is the one that was flown in."""
    folder, world = flight
    out, again = folder / "again.webm", folder / "first.webm"
    world.film(folder, again, lambda share: None)
    app = typer.Typer(rich_markup_mode=None)
    app.command()(film)
    done = CliRunner().invoke(app, [str(folder), str(out)])
    assert done.exit_code == 0, done.output
    assert done.stderr.splitlines()[-1] == f"wrote {out}"
    videos = [cv2.VideoCapture(str(path)) for path in (again, out)]
    frames = [int(video.get(cv2.CAP_PROP_FRAME_COUNT)) for video in videos]
    assert frames[0] == frames[1]
    for video in videos:
        video.set(cv2.CAP_PROP_POS_FRAMES, frames[0] // 2)
    first, second = (video.read()[1].astype(int) for video in videos)
    assert np.abs(first - second).mean() < 1.0


def test_the_log_of_a_simulated_flight_has_its_truth(flight: tuple[Path, SimulatedWorld]):
    """Pictures, poses and truth of the recorder's and the simulator's own files."""
    folder, _ = flight
    kinds = {type(m).__name__ for m in RunFolder(folder).grown()}
    assert {"Moved", "Pictured", "Settled", "Ticked", "Truly"} == kinds
    path = folder / "flight.mcap"
    write_mcap(folder, path, overwrite=False, console=Console(quiet=True))
    assert path.stat().st_size > 100_000


def dial(port: int):
    """To the live view, as soon as it is up."""
    give_up = time.monotonic() + 30.0
    while True:
        try:
            return connect(
                f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], open_timeout=5
            )
        except OSError:
            if time.monotonic() > give_up:
                raise
            time.sleep(0.1)


def test_a_flight_under_way_is_served_live(tmp_path: Path):
    """Topics are offered to who connects, new lines arrive; the end of the flight ends it."""
    port, run = free_port(), write_run(tmp_path)
    view = LiveView(run, Address("127.0.0.1", port))
    view.start()
    over = threading.Event()

    def go_on() -> None:
        t_ns = 9_000_000_000_000
        while not over.wait(0.02):
            t_ns += 20_000_000
            with (run / "ticks.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps({"t_ns": t_ns, "known": "target", "h_m": 0.321}) + "\n")

    flying = threading.Thread(target=go_on)
    flying.start()
    try:
        with dial(port) as client:
            topics: dict[str, int] = {}
            while "/control" not in topics:
                message = client.recv(timeout=30)
                if isinstance(message, str) and json.loads(message)["op"] == "advertise":
                    topics |= {c["topic"]: c["id"] for c in json.loads(message)["channels"]}
            wanted = [{"id": 1, "channelId": topics["/control"]}]
            client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            give_up = time.monotonic() + 30.0
            while b'"h_m": 0.321' not in (data := client.recv(timeout=30, decode=False)):
                assert time.monotonic() < give_up, data
    finally:
        over.set()
        flying.join()
        view.close()
    assert view.problem is None
    with pytest.raises(OSError, match=r".*"):
        socket.create_connection(("127.0.0.1", port), timeout=1).close()


KILLED = """
import os, sys
from pathlib import Path
from drone_client.viewing.live import Address, LiveView
view = LiveView(Path(sys.argv[1]), Address("127.0.0.1", int(sys.argv[2])))
view.start()
print(view._process.pid, flush=True)
sys.stdin.read()
os._exit(9)
"""


def test_a_client_that_is_killed_leaves_no_server(tmp_path: Path):
    """It ends with whoever started it."""
    port, run = free_port(), write_run(tmp_path)
    parent = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(run), str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert parent.stdin is not None
    with dial(port):
        pass
    parent.communicate(timeout=30)
    assert parent.returncode == 9
    give_up = time.monotonic() + 20.0
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
        except ConnectionRefusedError:
            break
        except (ConnectionResetError, TimeoutError):
            pass  # it is just ending
        assert time.monotonic() < give_up
        time.sleep(0.05)
