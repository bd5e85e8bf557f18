"""The link is cut in mid-flight: the drone goes on by its own eyes, and gives the lead back.

Over a real link, with the pictures of the shipped recording. First a worker without a detector,
which says where the target is and comes back in time whatever the machine does beside; then a real
service that is killed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drone_client.airframe import Airframe
from drone_client.link.choose import open_link
from drone_client.replay import ReplayOptions, replay
from drone_client.settings import ClientSettings
from drone_client.source.replay import open_recording
from drone_client.truth import load_truth
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.messages import pose_of
from tests.recordings import RECORDING, close_recording
from tests.service_process import service_process
from tests.unit.drone_client.builders import answering, target_of
from tests.unit.drone_client.zenoh_worker import ZenohWorker

BEFORE, CUT = 24, 30
"""Frames until the link is cut, and until it is back: 2 s and 2.5 s."""
AFTER = 45
INTERRUPTED = 130


def world_from_target():
    """True place of the target in the shipped recording."""
    source = open_recording(RECORDING)
    entries = load_truth(RECORDING / "truth.json", len(source))
    stamps = [c.t_source_ns for c in source.captures()]
    return source.world_from_camera(stamps[-1]) @ entries[-1].camera_from_target


class Ended(KeyboardInterrupt):
    """Enough was seen."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Summary, ticks, looks, and when the link was cut and put together again."""
    folder = tmp_path_factory.mktemp("own-eyes")
    source = open_recording(close_recording(folder / "recording"))
    target = world_from_target()
    worker = ZenohWorker(
        answer=answering(
            lambda header: target_of(
                pose_of(header.world_from_camera).inverse() @ target, np.diag([4e-6] * 6)
            )
        )
    )
    clock = MonotonicClock()
    times: dict[str, int] = {}
    hands: list[threading.Thread] = []

    def beside(what: Callable[[], None]) -> None:
        """Without holding up the camera, whose thread this is."""
        hands.append(threading.Thread(target=what))
        hands[-1].start()

    def on_progress(done: int, tally: object) -> None:
        if done == BEFORE:
            times["cut"] = clock.now_ns()
            beside(worker.close)
        elif done == BEFORE + CUT:
            times["back"] = clock.now_ns()
            beside(worker.open)
        elif done == BEFORE + CUT + AFTER:
            raise Ended

    settings = ClientSettings(
        connect=worker.endpoint,
        tau_max_ms=400,
        age_max_ms=450,
        onboard_fallback=True,
        onboard_max_s=10,
    )
    link = open_link(settings, clock)
    options = ReplayOptions(folder / "run", plot=True)
    try:
        summary = replay(source, Airframe(), settings, options, link, clock, on_progress)
    finally:
        for hand in hands:
            hand.join()
        worker.close()

    def lines(name: str) -> list[dict]:
        return [json.loads(line) for line in (folder / "run" / name).read_text().splitlines()]

    return summary, lines("ticks.jsonl"), lines("onboard.jsonl"), times, target


def own(tick: dict) -> bool:
    """Flown on the drone's own eyes, with a fresh pose."""
    return tick.get("target_source") == "onboard" and tick["freshness"] == "fresh"


def test_the_outage_is_bridged(run):
    """From shortly after the cut on, nearly all ticks are fresh, and seen on board."""
    _, ticks, _, times, _ = run
    during = [t for t in ticks if times["cut"] + 500_000_000 < t["t_ns"] < times["back"]]
    assert len(during) > 30
    assert sum(map(own, during)) > 0.7 * len(during)


def test_the_lead_goes_back_to_the_edge(run):
    """Results came again after the outage, and where they were fresh the drone flew by them."""
    _, ticks, _, times, _ = run
    after = [t for t in ticks if t["t_ns"] > times["back"] and t.get("target_source") == "edge"]
    assert [t for t in after if t["freshness"] == "fresh"]
    assert all(t["unconfirmed_ms"] == 0 for t in after)


def test_what_was_seen_on_board_is_the_target(run):
    """Within 2 cm of its true place, each time, and none of it was taken back."""
    summary, _, looks, _, target = run
    accepted = [k for k in looks if k["verdict"] == "accepted"]
    assert len(accepted) > 10
    for line in accepted:
        assert line["source"] == "onboard"
        off = pose_of(tuple(line["world_from_target"])).translation - target.translation
        assert np.linalg.norm(off) < 0.02
    assert summary["onboard"]["accepted"] == len(accepted)
    assert summary["onboard"]["taken_back"] == 0
    assert summary["onboard"]["verdicts"].get("contradicted", 0) == 0
    assert summary["onboard"]["verdicts"].get("failed", 0) == 0
    assert summary["control_errors"] == 0


def test_the_time_without_a_word_of_the_edge_is_told_and_counted(run):
    """Over one bridge it grows as the clock does; the error ball holds 1 cm for each second."""
    _, ticks, _, times, _ = run
    mine = [t for t in ticks if own(t) and t["t_ns"] < times["back"]]
    first, last = mine[0], mine[-1]
    grown_ms = last["unconfirmed_ms"] - first["unconfirmed_ms"]
    assert grown_ms > 800
    assert grown_ms == pytest.approx((last["t_ns"] - first["t_ns"]) / 1e6, abs=1e-3)
    assert all(t["delta_m"] > 0.01 * (t["unconfirmed_ms"] / 1e3 - 0.3) + 0.005 for t in mine)


def test_the_summary_tells_of_the_bridge(run):
    """How many, the longest, and its share of all ticks; every looked-at frame has its line."""
    summary, ticks, looks, _, _ = run
    own_eyes = summary["onboard"]
    assert own_eyes["bridges"] >= 1
    assert own_eyes["longest_bridge_ms"] > 1000
    assert own_eyes["share_of_ticks"] == pytest.approx(sum(map(own, ticks)) / len(ticks), abs=1e-3)
    assert own_eyes["frames"] == len(looks) == sum(own_eyes["verdicts"].values())
    sequences = [k["sequence"] for k in looks]
    assert len(sequences) == len(set(sequences))


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A real service, killed with SIGKILL while a drone flies by it; ticks, looks and the time."""
    folder = tmp_path_factory.mktemp("killed")
    out = folder / "run"
    client = Path(sys.executable).with_name("drone-client")
    with service_process(folder) as service:
        command = [client, "replay", close_recording(folder / "recording"), "--out", out]
        command += ["--connect", service.endpoint, "--onboard-fallback", "--no-plot"]
        command += ["--tau-max-ms", "5000", "--age-max-ms", "6000", "--onboard-max-s", "20"]
        process = subprocess.Popen([str(c) for c in command], env=os.environ | {})
        try:
            give_up = time.monotonic() + 120
            ledger = out / "ledger.jsonl"
            while time.monotonic() < give_up:
                if ledger.exists() and ledger.read_text().count('"update": "fused"') >= 10:
                    break
                time.sleep(0.02)
            killed_ns = time.monotonic_ns()
            service.kill()
            time.sleep(4)  # the outage itself
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == INTERRUPTED
        finally:
            process.kill()
            process.wait()

    def lines(name: str) -> list[dict]:
        return [json.loads(line) for line in (out / name).read_text().splitlines()]

    return killed_ns, lines("ticks.jsonl"), lines("onboard.jsonl")


def test_a_killed_service_is_bridged(killed):
    """Own eyes lead after it, with fresh poses, for a second at least."""
    killed_ns, ticks, looks = killed
    mine = [t for t in ticks if own(t) and t["t_ns"] > killed_ns]
    assert mine, [k["verdict"] for k in looks][-40:]
    assert (mine[-1]["t_ns"] - mine[0]["t_ns"]) / 1e9 > 1
