"""The TUN relay: what real sockets of two namespaces see of the link."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from link_emulator import (
    Control,
    ControlError,
    Impairments,
    Namespaces,
    NotPermittedError,
    netns,
)
from link_emulator.namespaces import CONGESTION_CONTROLS, may_make_namespaces

WHY_NOT = may_make_namespaces()
pytestmark = pytest.mark.skipif(WHY_NOT is not None, reason=str(WHY_NOT))
ENDS = "tests.integration.link_ends"
PORT = 9000
OUTLIER_MS = 30.0
"""What a busy machine may add before a test of a link's time fails."""


def end(net: Namespaces, place: Any, *arguments: object) -> subprocess.Popen[str]:
    """One of the small programs, in a namespace."""
    command = [sys.executable, "-m", ENDS, *map(str, arguments)]
    return net.popen(place, command, stdout=subprocess.PIPE, text=True)


def serve(net: Namespaces, *arguments: object) -> subprocess.Popen[str]:
    """One in b that listens when this returns."""
    process = end(net, "b", *arguments)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def answer(process: subprocess.Popen[str]) -> Any:
    """What it printed at its end."""
    out, _ = process.communicate(timeout=60)
    return json.loads(out)


def flood(net: Namespaces, count: int, size_bytes: int, rate_hz: float) -> np.ndarray:
    """What arrived in b of so many datagrams of a: number, sent, arrived [ns], bytes."""
    receiver = serve(net, "receive", PORT)
    assert end(net, "a", "send", net.address_b, PORT, count, size_bytes, rate_hz).wait() == 0
    return np.array(answer(receiver))


def test_every_datagram_takes_the_delay() -> None:
    """Nothing is lost, nothing is early, and the median is the delay."""
    with Namespaces(Impairments(delay_ms=10)) as net:
        got = flood(net, 500, 200, 1000)
        report = net.control.report()
    delay_ms = (got[:, 2] - got[:, 1]) / 1e6
    assert len(got) == 500
    assert delay_ms.min() >= 10
    assert np.median(delay_ms) < 10 + OUTLIER_MS
    assert list(got[:, 0]) == list(range(500))
    assert report.up.passed == 500
    assert not sum(report.up.dropped.values())


def test_rate_is_kept_and_what_does_not_fit_is_dropped_at_the_tail() -> None:
    """Twice the rate goes in, the rate comes out of whole IP packets, and the queue is bounded."""
    with Namespaces(Impairments(rate_mbit=8, queue_ms=50)) as net:
        got = flood(net, 2000, 972, 2000)  # 1000 bytes on the wire, 16 Mbit/s
        report = net.control.report()
    through_s = (got[-1, 2] - got[0, 2]) / 1e9
    mbit_s = got[1:, 3].sum() * 8e-6 / through_s
    assert 7.5 < mbit_s < 8.05  # a receiver that was late for the first one sees a little more
    assert report.up.dropped["queue_full"] == 2000 - len(got)
    assert report.up.dropped["queue_full"] > 600
    assert np.median((got[:, 2] - got[:, 1]) / 1e6) < 50 + OUTLIER_MS


def test_loss_is_what_was_asked_for_in_bursts() -> None:
    """The share and the mean length of the gaps are those of the process."""
    with Namespaces(Impairments(loss=0.1, burst=4), Impairments(), seed=3) as net:
        got = flood(net, 8000, 100, 8000)
        report = net.control.report()
    assert report.up.dropped["lost"] == 8000 - len(got)
    assert len(got) / 8000 == pytest.approx(0.9, abs=0.03)
    gaps = np.diff(got[:, 0]) - 1
    assert gaps[gaps > 0].mean() == pytest.approx(4, rel=0.25)


def test_partition_cuts_a_running_link_and_heals() -> None:
    """Pings go, then none comes back, then they go again."""
    with Namespaces(Impairments()) as net:
        serve(net, "echo_udp", PORT)
        before = answer(end(net, "a", "ask", net.address_b, PORT, "udp", 5, 2))
        net.control.cut()
        while_cut = answer(end(net, "a", "ask", net.address_b, PORT, "udp", 3, 0.1))
        net.control.heal()
        after = answer(end(net, "a", "ask", net.address_b, PORT, "udp", 5, 2))
        report = net.control.report()
    assert None not in before + after
    assert while_cut == [None] * 3
    assert report.up.dropped["cut"] == 3


def test_one_direction_can_be_cut_alone() -> None:
    """Datagrams still arrive in b, and the answers do not."""
    with Namespaces(Impairments()) as net:
        serve(net, "echo_udp", PORT)
        net.control.cut("down")
        times = answer(end(net, "a", "ask", net.address_b, PORT, "udp", 3, 0.1))
        report = net.control.report()
    assert times == [None] * 3
    assert report.up.passed == 3
    assert report.down.dropped["cut"] == 3


def test_tcp_gets_through_a_slow_link_that_loses() -> None:
    """A megabyte there and back over 1 % loss is unharmed and no faster than the rate."""
    with Namespaces(Impairments(rate_mbit=40, delay_ms=2, loss=0.01)) as net:
        serve(net, "echo_tcp", PORT)
        told = answer(end(net, "a", "upload", net.address_b, PORT, 1_000_000))
        report = net.control.report()
    assert told["same"]
    assert told["seconds"] > 8e6 / 40e6
    assert report.up.passed > 600
    assert report.up.dropped["lost"] > 0


def test_congestion_control_of_a_namespace_can_be_chosen() -> None:
    """A connection has what was asked for, whichever the machine's default is."""
    available = CONGESTION_CONTROLS.read_text().split()
    with Namespaces() as net:
        serve(net, "echo_tcp", PORT)
        for name in available:
            net.congestion_control("a", name)
            assert answer(end(net, "a", "congestion", net.address_b, PORT)) == name
        with pytest.raises(NotPermittedError, match="no 'nagle' in this kernel"):
            net.congestion_control("a", "nagle")


def test_report_says_how_exact_the_relay_was() -> None:
    """Every released packet was measured, none left early, and a reset forgets."""
    with Namespaces(Impairments(rate_mbit=50, delay_ms=5)) as net:
        flood(net, 2000, 1200, 5000)
        report = net.control.report()
        net.control.reset()
        assert net.control.report().released == 0
    assert report.released == report.up.passed + report.down.passed == 2000
    assert 0 < report.release_error_p50_ms <= report.release_error_p99_ms
    assert report.release_error_p99_ms <= report.release_error_max_ms
    assert report.marked == (report.release_error_p99_ms > 0.3)
    assert report.scheduling in ("fifo", "nice", "plain")


def test_change_that_cannot_be_is_refused_and_changes_nothing() -> None:
    """The message says why; the link is as before."""
    with Namespaces(Impairments()) as net:
        with pytest.raises(ControlError, match="loss is 2"):
            net.control.change(loss=2)
        with pytest.raises(ControlError, match="no impairment 'speed'"):
            net.control.change(speed=1)
        with pytest.raises(ControlError, match="no direction 'left'"):
            net.control.change("left", loss=0)
        serve(net, "echo_udp", PORT)
        assert None not in answer(end(net, "a", "ask", net.address_b, PORT, "udp", 3, 2))


def test_another_process_can_change_the_link_at_a_path(tmp_path: Path) -> None:
    """The control path takes commands, and is gone afterwards."""
    path = tmp_path / "link"
    with Namespaces(control_path=path) as net:
        other = Control.connect(path)
        other.change("up", cut=True)
        serve(net, "echo_udp", PORT)
        assert answer(end(net, "a", "ask", net.address_b, PORT, "udp", 1, 0.1)) == [None]
        assert other.report().up.dropped["cut"] == 1
        other.close()
        assert net.control.report().up.dropped["cut"] == 1  # the relay lives on
    assert not path.exists()


def test_nothing_is_left_behind_not_even_by_an_error() -> None:
    """Namespaces and processes end with the block."""

    def fail() -> None:
        with Namespaces() as net:
            names.extend(net.names.values())
            processes.append(serve(net, "echo_udp", PORT))
            pids.append(net.relay_pid)
            raise RuntimeError("on purpose")

    names: list[str] = []
    processes: list[subprocess.Popen[str]] = []
    pids: list[int] = []
    with pytest.raises(RuntimeError, match="on purpose"):
        fail()
    assert not [name for name in names if (netns.FOLDER / name).exists()]
    assert processes[0].poll() is not None
    assert not Path(f"/proc/{pids[0]}").exists()


KILLED = """
import os, sys
from link_emulator import Namespaces
net = Namespaces().__enter__()
child = net.popen("b", ["sleep", "600"])
print(*net.names.values(), net.relay_pid, child.pid, flush=True)
sys.stdin.read()
"""


def _start_killed() -> tuple[subprocess.Popen[str], list[str], list[int]]:
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    words = process.stdout.readline().split()
    return process, words[:2], [int(word) for word in words[2:]]


def _end_killed(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _wait_until_gone(names: list[str], pids: list[int]) -> None:
    deadline = time.monotonic() + 20
    while any((netns.FOLDER / n).exists() for n in names) or any(map(_is_alive, pids)):
        assert time.monotonic() < deadline, f"left behind: {names}, {pids}"
        time.sleep(0.01)


def test_killed_run_is_cleaned_up_by_its_relay() -> None:
    """After kill -9 of the process that made them, the namespaces and all in them are gone."""
    process, names, pids = _start_killed()
    _end_killed(process)
    _wait_until_gone(names, pids)


def test_killed_run_whose_relay_was_killed_too_is_swept() -> None:
    """The next one to start deletes what a dead process has left, and only that."""
    with Namespaces() as mine:
        process, names, pids = _start_killed()
        os.kill(pids[0], signal.SIGKILL)
        _end_killed(process)
        assert set(names) <= set(netns.sweep())
        _wait_until_gone(names, pids)
        assert all((netns.FOLDER / name).exists() for name in mine.names.values())


def test_command_line_runs_a_command_and_says_what_the_link_did() -> None:
    """The command's exit code is passed on; the report is JSON on stderr."""
    script = (
        "import socket; socket.socket(2, 2).sendto(b'x', ('10.203.0.2', 9)); raise SystemExit(3)"
    )
    done = subprocess.run(
        [sys.executable, "-m", "link_emulator", "run", "--delay-ms", "1", "--json"]
        + ["--", sys.executable, "-c", script],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    report = json.loads(done.stderr)
    assert done.returncode == 3
    assert report["up"]["passed"] + report["up"]["waiting"] == 1
