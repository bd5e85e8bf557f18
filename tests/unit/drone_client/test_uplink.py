"""The way up: at most W frames in the network, the newest first, and the fate of each is told."""

from __future__ import annotations

import json
import queue
import threading
from pathlib import Path

import numpy as np
import pytest

from drone_client.gate import SentFrame
from drone_client.ledger import EVENTS_NAME, LEDGER_NAME, Fate, Ledger
from drone_client.link.memory import MemoryLink
from drone_client.uplink import Uplink, UplinkSettings
from drone_client.worker_choice import choose_worker
from rgbd_wire.clock import ManualClock
from rgbd_wire.frame_codec import decompress, unpack
from tests.unit.drone_client.builders import CAMERA, MS, eventually, frame, pose

DRONE = "drone-1"
TIMEOUT_NS = 500 * MS


class Rig:
    """An uplink with real compression over a memory link that answers nothing by itself."""

    def __init__(self, folder: Path, workers: tuple[str, ...] = ("w1",), window: int = 2) -> None:
        self.folder = folder
        self.workers = workers
        self.clock = ManualClock(1_000 * MS)
        self.sent: queue.Queue[tuple[str, bytes]] = queue.Queue()
        self.told: list[SentFrame] = []
        self.broken = False
        link = MemoryLink(self.clock, self._on_frame)
        link.workers = lambda: self.workers  # type: ignore[method-assign] # they come and go
        self.ledger = Ledger(folder)
        settings = UplinkSettings(
            DRONE, 77, window, TIMEOUT_NS, budget_ns=300 * MS, jpeg_quality=80
        )
        self.uplink = Uplink(settings, link, self.clock, self, self.ledger)

    def sending(self, sent: SentFrame) -> None:
        self.told.append(sent)

    def _on_frame(self, worker: str, message: bytes) -> tuple[bytes, ...]:
        if self.broken:
            raise OSError("no buffer space")
        sequence = unpack(message).header.sequence
        assert self.told[-1].sequence == sequence  # known before it is on its way
        self.sent.put((worker, message))
        return ()

    def next_sent(self) -> tuple[str, int]:
        """Worker and sequence of the next frame that goes out."""
        worker, message = self.sent.get(timeout=10)
        return worker, unpack(message).header.sequence

    def submit_and_send(self) -> tuple[str, int]:
        self.uplink.submit(frame(self.clock.now_ns()), "x.png")
        return self.next_sent()

    def lines(self, name: str) -> list[dict]:
        return [json.loads(line) for line in (self.folder / name).read_text().splitlines()]


@pytest.fixture
def rig(tmp_path):
    """A started uplink to one worker, window 2; stopped at the end."""
    rig = Rig(tmp_path)
    rig.uplink.start()
    yield rig
    rig.uplink.stop()
    rig.ledger.close()


@pytest.fixture
def pair(tmp_path):
    """A started uplink to two workers."""
    rig = Rig(tmp_path, workers=("w1", "w2"))
    rig.uplink.start()
    yield rig
    rig.uplink.stop()
    rig.ledger.close()


def test_a_frame_arrives_as_it_was_captured(rig):
    """Stamps, pose, camera and depth to the last bit; t1 is taken on the drone's clock."""
    taken = frame(990 * MS, pose((1, 2, 3), (0.1, 0.2, 0.3)))
    rig.uplink.submit(taken, "x.png")
    worker, message = rig.sent.get(timeout=10)
    packed = unpack(message)
    header = packed.header
    assert (worker, header.drone, header.boot_id, header.sequence) == ("w1", DRONE, 77, 0)
    assert (header.t_capture_ns, header.t1_ns) == (990 * MS, 1_000 * MS)
    assert header.budget_ns == 300 * MS
    np.testing.assert_array_equal(packed.world_from_camera.matrix, taken.world_from_camera.matrix)
    received = decompress(packed)
    assert received.camera.color == CAMERA.color
    np.testing.assert_array_equal(received.depth_units, taken.depth_units)
    assert rig.told == [SentFrame(0, 990 * MS, 1_000 * MS, "w1")]


def test_no_more_than_the_window_is_in_the_network_and_the_newest_goes_next(rig):
    """Two under way, eight submitted: seven are superseded on board, the last one goes."""
    assert [rig.submit_and_send()[1] for _ in range(2)] == [0, 1]
    for _ in range(8):
        rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
    assert rig.ledger.fates[Fate.SUPERSEDED_ON_BOARD] == 7
    assert rig.sent.empty()
    rig.uplink.heard(0, "w1")
    assert rig.next_sent() == ("w1", 9)
    superseded = [line["sequence"] for line in rig.lines(LEDGER_NAME)]
    assert superseded == [2, 3, 4, 5, 6, 7, 8]


@pytest.mark.parametrize("window", [1, 3])
def test_the_window_holds_while_acks_come_in_any_order(tmp_path, window):
    """Each ack lets exactly one frame out."""
    rig = Rig(tmp_path, window=window)
    rig.uplink.start()
    under_way = [rig.submit_and_send()[1] for _ in range(window)]
    for i in range(6):
        rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
        rig.uplink.heard(under_way.pop(i % window), "w1")
        under_way.append(rig.next_sent()[1])
        assert rig.sent.empty()
    rig.uplink.stop()
    rig.ledger.close()
    assert rig.ledger.fates == {Fate.INTERRUPTED: window + 6}


def test_an_ack_of_what_holds_no_slot_frees_none(rig):
    """Made up, repeated or late: the window stays shut."""
    rig.submit_and_send()
    rig.submit_and_send()
    for sequence in (99, 5):
        rig.uplink.heard(sequence, "w1")
    rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
    rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
    assert rig.ledger.fates[Fate.SUPERSEDED_ON_BOARD] == 1
    rig.uplink.heard(1, "w1")
    assert rig.next_sent()[1] == 3


def test_without_a_worker_the_ledger_says_so_and_no_slot_is_taken(rig):
    """Each frame is told; as soon as there is a worker, frames go to it."""
    rig.workers = ()
    for n in range(4):
        rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
        assert eventually(lambda n=n: rig.ledger.fates[Fate.NO_WORKER] == n + 1)
    rig.workers = ("w1",)
    assert [rig.submit_and_send() for _ in range(2)] == [("w1", 4), ("w1", 5)]


def test_a_worker_that_acknowledges_nothing_is_left_for_another(pair):
    """After the ack time-out the slots are free, and the other worker gets the next frame."""
    first = choose_worker(DRONE, ("w1", "w2"), None)
    other = {"w1": "w2", "w2": "w1"}[first]
    assert [pair.submit_and_send()[0] for _ in range(2)] == [first, first]
    pair.uplink.submit(frame(pair.clock.now_ns()), "x.png")
    pair.clock.advance(TIMEOUT_NS)
    assert pair.next_sent() == (other, 2)
    late = [e for e in pair.lines(EVENTS_NAME) if e["event"] == "ack_timeout"]
    assert [(e["sequence"], e["worker"]) for e in late] == [(0, first), (1, first)]
    pair.uplink.heard(2, other)
    assert pair.submit_and_send()[0] == other  # and it stays there


def test_a_frame_that_times_out_late_is_not_blamed_on_the_new_worker(pair):
    """A frame to the silent worker expires after the change: the new worker keeps its drone."""
    first = choose_worker(DRONE, ("w1", "w2"), None)
    other = {"w1": "w2", "w2": "w1"}[first]
    assert pair.submit_and_send() == (first, 0)
    pair.clock.advance(TIMEOUT_NS // 2)
    assert pair.submit_and_send() == (first, 1)
    pair.uplink.submit(frame(pair.clock.now_ns()), "x.png")
    pair.clock.advance(TIMEOUT_NS // 2)
    assert pair.next_sent() == (other, 2)
    pair.clock.advance(TIMEOUT_NS // 2)  # frame 1, to the first one, expires now
    pair.workers = ("w1", "w2", "w3")
    assert pair.submit_and_send() == (other, 3)
    late = [e["worker"] for e in pair.lines(EVENTS_NAME) if e["event"] == "ack_timeout"]
    assert late == [first, first]


def test_a_silent_worker_is_asked_again_where_there_is_no_other(rig):
    """A drone with one worker keeps trying."""
    for _ in range(3):
        rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
        assert rig.next_sent()[0] == "w1"
        rig.clock.advance(TIMEOUT_NS)


def test_a_silent_worker_that_went_and_came_back_is_trusted_again(pair):
    """A restarted worker is another one."""
    first = choose_worker(DRONE, ("w1", "w2"), None)
    other = {"w1": "w2", "w2": "w1"}[first]
    pair.submit_and_send()
    pair.clock.advance(TIMEOUT_NS)
    for live, chosen in (
        (("w1", "w2"), other),  # the first one is silent
        ((other,), other),  # and now it is gone
        ((first,), first),  # back, and the other one gone
        (("w1", "w2"), first),  # both: no reason to leave it
    ):
        pair.workers = live
        worker, sequence = pair.submit_and_send()
        assert worker == chosen
        if worker == other:  # the first one is trusted before it has said a word
            pair.uplink.heard(sequence, other)


def test_each_change_of_worker_is_an_event(rig):
    """Who was asked, who is now, and who was there."""
    rig.submit_and_send()
    rig.uplink.heard(0, "w1")
    rig.workers = ("w2",)
    rig.submit_and_send()
    changes = [e for e in rig.lines(EVENTS_NAME) if e["event"] == "worker"]
    assert [(e["before"], e["now"], e["live"]) for e in changes] == [
        (None, "w1", ["w1"]),
        ("w1", "w2", ["w2"]),
    ]


def test_stop_ends_the_thread_whatever_it_waits_for(tmp_path):
    """Idle, or with the window full and a frame waiting: the thread is gone, the frame told."""
    for waiting, folder in ((False, tmp_path / "idle"), (True, tmp_path / "full")):
        before = set(threading.enumerate())
        rig = Rig(folder, window=1)
        rig.uplink.start()
        if waiting:
            rig.submit_and_send()
            rig.uplink.submit(frame(rig.clock.now_ns()), "waits.png")
        rig.uplink.stop()
        assert set(threading.enumerate()) == before
        rig.ledger.close()
        assert rig.ledger.fates[Fate.INTERRUPTED] == (2 if waiting else 0)


def test_an_uplink_that_was_never_started_can_be_stopped(tmp_path):
    """A run that fails before it begins is cleaned up like any other."""
    rig = Rig(tmp_path)
    rig.uplink.stop()
    rig.ledger.close()


def test_a_frame_that_cannot_be_sent_is_told_and_the_next_one_goes(tmp_path, caplog):
    """A link that raises costs its frames, and one entry in the log; not the thread."""
    rig = Rig(tmp_path, window=4)
    rig.uplink.start()
    rig.broken = True
    for n in range(2):
        rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
        assert eventually(lambda n=n: rig.ledger.fates[Fate.SEND_FAILED] == n + 1)
    rig.broken = False
    assert rig.submit_and_send() == ("w1", 2)
    rig.uplink.stop()
    rig.ledger.close()
    assert rig.uplink.send_failures == 2
    assert len(caplog.records) == 1
