"""The service is killed in mid-replay and started again: the drone holds, counts and comes back."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.recordings import long_recording
from tests.service_process import service_process

ENOUGH = 15
"""Accepted results before the kill, and again after the restart."""
INTERRUPTED = 130


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service that is ready."""
    with service_process(tmp_path_factory.mktemp("service")) as service:
        yield service


@pytest.fixture(scope="module")
def flight(service, tmp_path_factory):
    """A replay during which the service is gone for a while; ledger, ticks, events, summary."""
    folder = tmp_path_factory.mktemp("kill")
    recording = long_recording(folder / "recording")
    out = folder / "run"
    client = Path(sys.executable).with_name("drone-client")
    command = [client, "replay", recording, "--connect", service.endpoint, "--out", out]
    command += ["--tau-max-ms", "2000", "--age-max-ms", "2500", "--no-plot"]

    ledger = out / "ledger.jsonl"

    def accepted() -> int:
        return ledger.read_text().count('"verdict": "accepted"') if ledger.exists() else 0

    def wait_for_accepted(count: int) -> None:
        give_up = time.monotonic() + 120
        while accepted() < count and time.monotonic() < give_up:
            time.sleep(0.02)
        assert accepted() >= count, f"{accepted()} accepted:\n{service.log.read_text()}"

    process = subprocess.Popen(command)
    try:
        wait_for_accepted(ENOUGH)
        killed_ns = time.monotonic_ns()
        service.kill()
        time.sleep(1.2)  # long enough for hold and brake
        before_restart = accepted()
        restarted_ns = time.monotonic_ns()
        service.start()
        wait_for_accepted(before_restart + ENOUGH)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == INTERRUPTED
    finally:
        process.kill()

    def lines(name: str) -> list[dict]:
        return [json.loads(line) for line in (out / name).read_text().splitlines()]

    summary = json.loads((out / "summary.json").read_text())
    return {
        "killed_ns": killed_ns,
        "restarted_ns": restarted_ns,
        "frames": lines("ledger.jsonl"),
        "ticks": lines("ticks.jsonl"),
        "events": lines("events.jsonl"),
        "summary": summary,
    }


def test_ledger_has_each_frame_once(flight):
    """Whatever became of it, a captured frame has exactly one line."""
    sequences = sorted(f["sequence"] for f in flight["frames"])
    assert sequences == list(range(len(sequences)))
    assert flight["summary"]["frames"] == len(sequences)
    assert flight["summary"]["interrupted"]


def test_frames_of_the_outage_are_counted(flight):
    """Without a worker a frame's fate is no_worker, no_reply or superseded, and not silence."""
    after = [f for f in flight["frames"] if f["t_capture_ns"] > flight["killed_ns"]]
    lost = [f for f in after if f["fate"] in ("no_worker", "no_reply", "superseded_on_board")]
    assert len(lost) >= 5


def test_drone_does_not_close_in_on_old_knowledge(flight):
    """Every tick with a target older than age_max of the filter says so, and closes in no more."""
    old = [t for t in flight["ticks"] if t.get("freshness") in ("hold", "brake", "retreat")]
    assert old
    assert {t["status"] for t in old} <= {"stale", "abort"}
    phases = [t["freshness"] for t in flight["ticks"] if t.get("freshness")]
    assert "hold" in phases
    assert "brake" in phases


def test_drone_reconnects_and_accepts_again(flight):
    """After the restart results are accepted, from another start of the worker."""
    accepted = [f for f in flight["frames"] if f.get("verdict") == "accepted"]
    before = {f["worker_boot_id"] for f in accepted if f["t4_ns"] < flight["killed_ns"]}
    after = {f["worker_boot_id"] for f in accepted if f["t4_ns"] > flight["restarted_ns"]}
    assert len(before) == 1
    assert len(after) == 1
    assert before != after


def test_events_tell_of_the_worker(flight):
    """The worker's going and coming back stand in events.jsonl."""
    changes = [(e["before"], e["now"]) for e in flight["events"] if e["event"] == "worker"]
    assert changes[0] == (None, "worker")
    assert ("worker", None) in changes
    assert changes[-1] == (None, "worker")
