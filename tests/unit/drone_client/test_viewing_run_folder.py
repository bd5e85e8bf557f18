"""A run's folder as moments in the order of time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drone_client.errors import OutputError
from drone_client.viewing.moments import Level, Moved, Pictured, Said, Settled, Ticked, Truly
from drone_client.viewing.run_folder import RunFolder
from tests.unit.drone_client.view_builders import (
    FRAMES,
    LATE,
    POSES,
    START_NS,
    TICKS,
    WORLD_FROM_TARGET,
    capture_ns,
    ledger_lines,
    write_lines,
    write_run,
)


def test_all_of_a_flight_comes_in_the_order_of_time(tmp_path: Path):
    """Nothing is lost, and nothing comes before what was earlier."""
    moments = RunFolder(write_run(tmp_path)).grown()
    kinds = [type(m) for m in moments]
    assert [kinds.count(k) for k in (Moved, Pictured, Settled, Ticked, Truly)] == [
        *(POSES, FRAMES, FRAMES + 1, TICKS, 0)
    ]
    stamps = [m.t_ns for m in moments]
    assert stamps == sorted(stamps)


def test_a_frame_counts_when_its_answer_came(tmp_path: Path):
    """And is refused or accepted by the gate's own word; without an answer by its fate."""
    moments = RunFolder(write_run(tmp_path)).grown()
    frames = sorted((m for m in moments if isinstance(m, Settled)), key=lambda m: m.t_capture_ns)
    assert frames[0].t_ns == capture_ns(0) + 80_000_000
    assert [m.accepted for m in frames] == [i != LATE for i in range(FRAMES)] + [False]
    assert [frames[LATE].verdict, frames[-1].verdict] == ["network_delay", "no_reply"]
    place = frames[0].world_from_target
    assert place is not None
    np.testing.assert_allclose(place.matrix, WORLD_FROM_TARGET.matrix, atol=1e-9)
    assert frames[-1].camera_from_target is None


def test_events_are_sentences(tmp_path: Path):
    """A transition in the mission's words; what a person has to worry about is a warning."""
    said = [m for m in RunFolder(write_run(tmp_path)).grown() if isinstance(m, Said)]
    assert [m.sentence for m in said] == [
        "workers: live w",
        "hold -> approach: square before the board",
        "suspect: worker w, why silent",
    ]
    assert [m.level for m in said] == [Level.INFO, Level.INFO, Level.WARNING]


def test_what_is_added_comes_once(tmp_path: Path):
    """A second look gives only what is new: lines, and pictures."""
    folder = RunFolder(write_run(tmp_path))
    folder.grown()
    assert folder.grown() == []
    with (tmp_path / "ticks.jsonl").open("a", encoding="utf-8") as file:
        file.write('{"t_ns": 9000000000000, "known": "no_pose"}\n')
    (tmp_path / "pictures" / "9000000000001.jpg").write_bytes(b"x")
    assert [type(m) for m in folder.grown()] == [Ticked, Pictured]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(cuts=st.lists(st.integers(0, 6000), max_size=8))
def test_a_line_counts_when_it_is_whole(tmp_path: Path, cuts: list[int]):
    """However a file grows, what comes of it is the same as of all of it at once."""
    write_lines(tmp_path / "all", ledger_lines())
    data = (tmp_path / "all").read_bytes()
    path = tmp_path / "ledger.jsonl"
    path.write_bytes(b"")
    folder, found = RunFolder(tmp_path), []
    for start, end in zip([0, *sorted(cuts)], [*sorted(cuts), len(data)], strict=True):
        with path.open("ab") as file:
            file.write(data[start:end])
        found += folder.grown()
    assert [m.line["sequence"] for m in found] == list(range(FRAMES + 1))
    assert folder.unread == 0


@pytest.mark.parametrize(
    "line",
    [
        "not JSON",
        "[]",
        "7",
        '{"t_ns": "soon"}',
        '{"t_ns": 1, "world_from_body": [0, 0, 0, 2, 0, 0, 0]}',
        '{"t_ns": 1, "world_from_body": [0, 0, NaN, 1, 0, 0, 0]}',
        "[" * 5000,
    ],
)
def test_a_line_that_is_none_is_left_out_and_counted(tmp_path: Path, line: str):
    """Such as one that a full disk cut off."""
    folder = RunFolder(write_run(tmp_path))
    (tmp_path / "poses.jsonl").write_text(line + "\n", encoding="utf-8")
    moments = folder.grown()
    assert folder.unread == 1
    assert not any(isinstance(m, Moved) for m in moments)


def test_a_folder_without_a_run_is_told(tmp_path: Path):
    """The file that is missing is named."""
    with pytest.raises(OutputError, match=r"there is no ledger\.jsonl"):
        RunFolder(tmp_path)


def test_a_file_that_is_no_text_of_lines_is_told(tmp_path: Path):
    """It is not read into memory without an end."""
    folder = RunFolder(write_run(tmp_path))
    (tmp_path / "ticks.jsonl").write_bytes(b"x" * 1_100_000)
    with pytest.raises(OutputError, match=r"ticks\.jsonl: a line of over"):
        folder.grown()


def test_a_simulator_adds_the_truth(tmp_path: Path):
    """A file more, a kind of moment more."""
    write_run(tmp_path)
    line = {
        "t_ns": START_NS,
        "world_from_body": [0, 0, 1, 1, 0, 0, 0],
        "world_from_target": [3, 0, 1, 0, 0, 0, 1],
        "tip_force_n": 2.5,
        "arm_m": 0.008,
    }
    write_lines(tmp_path / "truth.jsonl", [line])
    (truth,) = (m for m in RunFolder(tmp_path).grown() if isinstance(m, Truly))
    assert (truth.tip_force_n, truth.arm_m) == (2.5, 0.008)
