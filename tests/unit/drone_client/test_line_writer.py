"""Lines on their way to files: handed over at once, written in order, lost only when counted."""

import fcntl
import json
import os
import threading
from pathlib import Path

import pytest

from drone_client import line_writer
from drone_client.line_writer import LineWriter


def test_lines_of_many_threads_are_whole_and_in_each_threads_order(tmp_path: Path):
    """Four threads write to two files; each file has each thread's lines in their order."""
    writer = LineWriter({"a": tmp_path / "a", "b": tmp_path / "b"})

    def write(thread: int) -> None:
        for n in range(300):
            writer.put("ab"[n % 2], {"thread": thread, "n": n})

    threads = [threading.Thread(target=write, args=(t,)) for t in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    writer.close()
    assert writer.lost == 0
    for parity, name in enumerate("ab"):
        lines = [json.loads(line) for line in (tmp_path / name).read_text().splitlines()]
        for t in range(4):
            mine = [line["n"] for line in lines if line["thread"] == t]
            assert mine == list(range(parity, 300, 2))


def test_a_disk_that_hangs_holds_nobody_up_and_nothing_grows_without_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A pipe that nobody reads: every line is taken at once, and past the bound it is counted."""
    monkeypatch.setattr(line_writer, "MAX_WAITING", 100)
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    writer = LineWriter({"pipe": tmp_path / "pipe"})
    line = {"much": "x" * 10_000}
    given = 500
    for _ in range(given):
        writer.put("pipe", line)
    # What waits, a batch in the writer's hands, and what the pipe has taken
    fits = fcntl.fcntl(reader, fcntl.F_GETPIPE_SZ) // len(json.dumps(line)) + 1
    assert writer.lost >= given - 100 - 100 - fits
    os.set_blocking(reader, True)
    read = 0

    def drain() -> None:
        nonlocal read
        while chunk := os.read(reader, 1 << 16):
            read += chunk.count(b"\n")

    draining = threading.Thread(target=drain)
    draining.start()
    writer.close()
    draining.join()
    os.close(reader)
    assert read + writer.lost == given


def test_what_is_no_json_costs_one_line(tmp_path: Path):
    """The others of its batch are written."""
    writer = LineWriter({"a": tmp_path / "a"})
    for line in ({"n": 1}, {"n": object()}, {"n": float("nan")}):
        writer.put("a", line)
    writer.put("unknown", {"n": 2})
    writer.close()
    writer.put("a", {"n": 3})
    assert (tmp_path / "a").read_text() == '{"n": 1}\n{"n": null}\n'
    assert writer.lost == 1


def test_a_file_that_cannot_be_opened_leaves_none_open(tmp_path: Path):
    """The error is the system's, and no thread is left."""
    before = set(threading.enumerate())
    with pytest.raises(OSError, match="No such file"):
        LineWriter({"a": tmp_path / "a", "b": tmp_path / "no" / "b"})
    assert set(threading.enumerate()) <= before


def test_whoever_asks_waits_until_the_lines_are_there(tmp_path: Path):
    """All that was handed over before the question; after closing there is nothing to wait for."""
    writer = LineWriter({"a": tmp_path / "a"})
    for n in range(200):
        writer.put("a", {"n": n})
        if n % 50 == 49:
            assert writer.on_disk(10)
            assert (tmp_path / "a").read_text().count("\n") == n + 1
    writer.close()
    assert writer.on_disk(0)


def test_a_disk_that_hangs_for_good_does_not_keep_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A pipe that nobody ever reads: the end comes, and what was not written is counted."""
    monkeypatch.setattr(line_writer, "CLOSE_S", 0.05)
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    writer = LineWriter({"pipe": tmp_path / "pipe"})
    for _ in range(100):
        writer.put("pipe", {"much": "x" * 10_000})
    writer.close()
    assert 0 < writer.lost <= 100
    os.set_blocking(reader, True)  # let the thread go before the next test
    while os.read(reader, 1 << 16):
        pass
    os.close(reader)
