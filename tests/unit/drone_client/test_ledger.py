"""The ledger: one whole line for each captured frame, whatever happens."""

import json
import math
import tempfile
import threading
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drone_client.errors import OutputError
from drone_client.ledger import Fate, FrameEntry, Ledger
from drone_client.run_files import EVENTS_NAME, LEDGER_NAME, TICKS_NAME
from tests.unit.drone_client.builders import eventually


def strictly(path: Path) -> list[dict]:
    """The lines of a file, as a reader that knows no NaN reads them."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in {path}")

    return [json.loads(line, parse_constant=refuse) for line in path.read_text().splitlines()]


calls = st.lists(
    st.tuples(
        st.sampled_from(["captured", "sent", "close", "close_unanswered"]), st.integers(0, 12)
    ),
    max_size=60,
)


@settings(max_examples=60)
@given(calls)
def test_each_captured_frame_gets_exactly_one_line_in_any_order_of_calls(events):
    """Frames that are sent, answered, given up or forgotten, in any order and repeated."""
    with tempfile.TemporaryDirectory() as folder:
        ledger = Ledger(Path(folder))
        captured: set[int] = set()
        open_: dict[int, int | None] = {}
        expected: Counter[Fate] = Counter()
        for now, (call, n) in enumerate(events):
            if call == "captured" and n not in captured:
                ledger.captured(FrameEntry(n, f"{n}.png", now))
                captured.add(n)
                open_[n] = None
            elif call == "sent":
                ledger.sent(n, now, "w1", 100)
                if n in open_:
                    open_[n] = now
            elif call == "close":
                assert ledger.close_frame(n, Fate.ANSWERED, {}) is (n in open_)
                expected[Fate.ANSWERED] += n in open_
                open_.pop(n, None)
            elif call == "close_unanswered":
                before = now - n
                late = {s for s, t1 in open_.items() if t1 is not None and t1 < before}
                assert ledger.close_unanswered(before, {}) == len(late)
                expected[Fate.NO_REPLY] += len(late)
                for s in late:
                    del open_[s]
            assert ledger.under_way == len(open_)
        expected[Fate.INTERRUPTED] += len(open_)
        ledger.close()
        lines = strictly(Path(folder) / LEDGER_NAME)
        assert sorted(line["sequence"] for line in lines) == sorted(captured)
        assert Counter(Fate(line["fate"]) for line in lines) == +expected
        assert ledger.fates == +expected
        assert ledger.lost_lines == 0


def test_a_line_tells_what_is_known_of_the_frame(tmp_path):
    """Name and stamps from the board, worker and size once it was sent, details from the answer."""
    ledger = Ledger(tmp_path)
    ledger.captured(FrameEntry(0, "a.png", 10))
    ledger.captured(FrameEntry(1, "b.png", 20))
    ledger.sent(0, 15, "w1", 1234, {"rung": "full"})
    ledger.close_frame(0, Fate.ANSWERED, {"verdict": "accepted"})
    ledger.close()
    assert strictly(tmp_path / LEDGER_NAME) == [
        {
            "sequence": 0,
            "name": "a.png",
            "fate": "answered",
            "worker": "w1",
            "bytes": 1234,
            "encoding": {"rung": "full"},
            "t_capture_ns": 10,
            "t1_ns": 15,
            "verdict": "accepted",
        },
        {
            "sequence": 1,
            "name": "b.png",
            "fate": "interrupted",
            "worker": None,
            "bytes": None,
            "encoding": None,
            "t_capture_ns": 20,
            "t1_ns": None,
        },
    ]


def test_a_line_is_on_disk_as_soon_as_the_fate_is_known(tmp_path):
    """A client that is killed leaves whole lines: nothing waits in a buffer."""
    ledger = Ledger(tmp_path)
    ledger.captured(FrameEntry(0, "a.png", 10))
    assert not ledger.settled.is_set()
    ledger.close_frame(0, Fate.NO_WORKER, {})
    ledger.event(11, "worker", now=None)
    assert ledger.settled.is_set()
    assert eventually(lambda: (tmp_path / EVENTS_NAME).read_text().endswith("\n"))
    assert [line["fate"] for line in strictly(tmp_path / LEDGER_NAME)] == ["no_worker"]
    assert strictly(tmp_path / EVENTS_NAME) == [{"t_ns": 11, "event": "worker", "now": None}]
    ledger.close()


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=8,
)


@settings(max_examples=60)
@given(st.dictionaries(st.sampled_from(["h_m", "pose", "age_ms"]), values))
@example({"h_m": math.nan, "pose": [1.0, math.inf, {"deep": (-math.inf, 2)}]})
def test_nan_is_never_written_and_costs_no_line(details):
    """JSON knows no NaN and no infinity: null stands in their place, the rest is as it was."""

    def without_nan(value):
        if isinstance(value, float):
            return value if math.isfinite(value) else None
        if isinstance(value, dict):
            return {k: without_nan(v) for k, v in value.items()}
        return [without_nan(v) for v in value] if isinstance(value, list | tuple) else value

    with tempfile.TemporaryDirectory() as folder:
        ledger = Ledger(Path(folder))
        ledger.captured(FrameEntry(0, "a.png", 10))
        ledger.close_frame(0, Fate.ANSWERED, details)
        ledger.close()
        (line,) = strictly(Path(folder) / LEDGER_NAME)
        assert {k: line[k] for k in details} == without_nan(details)
        assert ledger.lost_lines == 0


def test_threads_that_race_for_a_frame_write_it_once(tmp_path):
    """Answer and time-out may come at the same moment: one of them closes the frame."""
    ledger = Ledger(tmp_path)
    wins: list[int] = []
    start = threading.Barrier(4)

    def close_all() -> None:
        start.wait()
        for n in range(200):
            if ledger.close_frame(n, Fate.ANSWERED, {}):
                wins.append(n)

    for n in range(200):
        ledger.captured(FrameEntry(n, "x", n))
    threads = [threading.Thread(target=close_all) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    ledger.close()
    assert sorted(wins) == list(range(200))
    assert len(strictly(tmp_path / LEDGER_NAME)) == 200


@pytest.mark.parametrize(
    ("folder", "says"),
    [
        ("taken", "there is a file of that name"),
        ("taken/run", "Not a directory"),
        ("/proc/nowhere/run", "No such file"),
    ],
)
def test_a_folder_that_cannot_be_written_is_told_in_one_line(tmp_path, folder, says):
    """Before anything flies, with the folder's name."""
    (tmp_path / "taken").write_text("")
    with pytest.raises(OutputError) as caught:
        Ledger(tmp_path / folder)
    assert str(caught.value).startswith(f"folder {tmp_path / folder}: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_in_the_folder_that_cannot_be_written_closes_the_others(tmp_path):
    """A directory where the ticks should go: told, and nothing stays open."""
    (tmp_path / TICKS_NAME).mkdir()
    with pytest.raises(OutputError, match="Is a directory"):
        Ledger(tmp_path)


def test_a_full_disk_costs_lines_and_not_the_flight(tmp_path):
    """Every lost line is counted; the other files go on."""
    (tmp_path / LEDGER_NAME).symlink_to("/dev/full")
    ledger = Ledger(tmp_path)
    for n in range(5):
        ledger.captured(FrameEntry(n, "x", n))
        ledger.close_frame(n, Fate.NO_WORKER, {})
        ledger.event(n, "still flying")
    assert ledger.fates[Fate.NO_WORKER] == 5
    ledger.close()
    assert ledger.lost_lines >= 5
    assert len(strictly(tmp_path / EVENTS_NAME)) == 5


def test_nothing_is_written_after_closing(tmp_path):
    """A late answer finds no open frame and no file, and harms nothing."""
    ledger = Ledger(tmp_path)
    ledger.captured(FrameEntry(0, "x", 0))
    ledger.close()
    ledger.close()
    assert not ledger.close_frame(0, Fate.ANSWERED, {})
    ledger.event(1, "late")
    ledger.tick({"t_ns": 1})
    assert len(strictly(tmp_path / LEDGER_NAME)) == 1
    assert strictly(tmp_path / EVENTS_NAME) == []


def test_an_earlier_run_is_evidence_and_goes_only_when_told(tmp_path):
    """A folder with a ledger is refused in one line that says what to do, and left as it is."""
    first = Ledger(tmp_path)
    first.captured(FrameEntry(0, "a", 0))
    first.close()
    before = (tmp_path / LEDGER_NAME).read_text()
    with pytest.raises(OutputError, match="earlier run.*--overwrite"):
        Ledger(tmp_path)
    assert (tmp_path / LEDGER_NAME).read_text() == before
    Ledger(tmp_path, overwrite=True).close()
    assert (tmp_path / LEDGER_NAME).read_text() == ""


def test_an_earlier_run_goes_as_a_whole(tmp_path):
    """What another kind of run wrote beside its ledger is no part of this one; the rest stays."""
    of_a_run = [
        *("truth.jsonl", "world.json", "poses.jsonl", "flight.json"),
        *("summary.json", "run.png", "onboard.jsonl", "pictures/123.jpg"),
    ]
    others = ["edge-service.log", "flight.webm", "pictures/mine.jpg", "notes.txt"]
    (tmp_path / "pictures").mkdir()
    for name in [LEDGER_NAME, *of_a_run, *others]:
        (tmp_path / name).write_text("of the earlier run")
    Ledger(tmp_path, overwrite=True).close()
    assert [name for name in of_a_run if (tmp_path / name).exists()] == []
    assert [name for name in others if not (tmp_path / name).exists()] == []


def test_looks_on_board_have_a_file_of_their_own_where_they_are_asked_for(tmp_path):
    """An earlier run's looks do not stay beside a run without them."""
    ledger = Ledger(tmp_path, own_eyes=True)
    ledger.look({"sequence": 1, "verdict": "accepted"})
    ledger.close()
    assert (tmp_path / "onboard.jsonl").read_text() == ('{"sequence": 1, "verdict": "accepted"}\n')
    again = Ledger(tmp_path, overwrite=True)
    again.look({"sequence": 2})
    again.close()
    assert not (tmp_path / "onboard.jsonl").exists()
