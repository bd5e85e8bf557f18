"""The way up: at most W frames in the network, the newest first, and the fate of each is told."""

from __future__ import annotations

import json
import queue
import threading
from pathlib import Path

import numpy as np
import pytest

from drone_client.encoding_choice import EncodingChoice
from drone_client.gate import SentFrame
from drone_client.ledger import Fate, Ledger
from drone_client.link.memory import MemoryLink
from drone_client.rate_control import RateSettings
from drone_client.run_files import EVENTS_NAME, LEDGER_NAME
from drone_client.uplink import Uplink, UplinkSettings
from drone_client.worker_choice import ranked
from rgbd_wire.clock import ManualClock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.frame_codec import decompress, unpack
from rgbd_wire.probe import decode_probe
from tests.unit.drone_client.builders import CAMERA, MS, eventually, frame, pose

DRONE = "drone-1"
TIMEOUT_NS = 500 * MS
AGE_MAX_NS = 300 * MS
STEP_NS = 10 * MS
FIRST, OTHER = ranked(DRONE, {"w1": 1.0, "w2": 1.0})


class Rig:
    """An uplink with real compression over a memory link that answers nothing by itself."""

    def __init__(self, folder: Path, workers: tuple[str, ...] = ("w1",), window: int = 2) -> None:
        self.folder = folder
        self.silent: set[str] = set()
        """Workers that do not echo."""
        self.clock = ManualClock(1_000 * MS)
        self.sent: queue.Queue[tuple[str, bytes]] = queue.Queue()
        self.told: list[SentFrame] = []
        self.broken = False
        self.link = MemoryLink(self.clock, self._on_frame, workers, echo=self._on_probe)
        self.ledger = Ledger(folder)
        settings = UplinkSettings(DRONE, 77, window, TIMEOUT_NS, age_max_ns=AGE_MAX_NS)
        choice = EncodingChoice(RateSettings(80 * MS), lambda: None)
        self.uplink = Uplink(settings, self.link, self.clock, self, self.ledger, choice)
        self.link.start(self._on_message, self.uplink.wake)
        self.looks = 0
        workers_of = self.link.workers

        def counted() -> tuple[str, ...]:
            self.looks += 1
            return workers_of()

        self.link.workers = counted  # type: ignore[method-assign] # each look begins here

    def sending(self, sent: SentFrame) -> None:
        self.told.append(sent)

    def _on_probe(self, worker: str, message: bytes) -> tuple[bytes, ...]:
        return () if worker in self.silent else (message,)

    def _on_message(self, message: bytes, t4_ns: int) -> None:
        _, body = unseal(message, Kind.PROBE)  # nothing else comes back by itself
        self.uplink.echo(decode_probe(body), t4_ns)

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

    def submit_and_look(self) -> bytes:
        """Submit a frame; the message that goes out."""
        self.uplink.submit(frame(self.clock.now_ns()), "x.png")
        return self.sent.get(timeout=10)[1]

    def heard(self, sequence: int, worker: str) -> None:
        """An ack comes in."""
        self.uplink.heard(sequence, worker, self.clock.now_ns())

    def pass_time(self, ns: int) -> None:
        """Let time pass as it does: in steps, each of which the uplink has seen."""
        for _ in range(ns // STEP_NS):
            self.clock.advance(STEP_NS)
            looks = self.looks
            self.uplink.wake()
            assert eventually(lambda looks=looks: self.looks > looks + 1)

    def lines(self, name: str) -> list[dict]:
        assert self.ledger.on_disk()
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
    assert header.budget_ns == AGE_MAX_NS - 10 * MS  # what is left of it when the frame leaves
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
    rig.heard(0, "w1")
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
        rig.heard(under_way.pop(i % window), "w1")
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
        rig.heard(sequence, "w1")
    rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
    rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
    assert rig.ledger.fates[Fate.SUPERSEDED_ON_BOARD] == 1
    rig.heard(1, "w1")
    assert rig.next_sent()[1] == 3


def test_without_a_worker_the_ledger_says_so_and_no_slot_is_taken(rig):
    """Each frame is told; as soon as there is a worker, frames go to it."""
    rig.link.set_workers(())
    for n in range(4):
        rig.uplink.submit(frame(rig.clock.now_ns()), "x.png")
        assert eventually(lambda n=n: rig.ledger.fates[Fate.NO_WORKER] == n + 1)
    rig.link.set_workers(("w1",))
    assert [rig.submit_and_send() for _ in range(2)] == [("w1", 4), ("w1", 5)]


def test_a_worker_that_goes_silent_is_left_and_its_newest_frame_goes_to_the_other(pair):
    """No ack, no echo: three replies missed, and a copy with a stamp of its own leaves."""
    assert [pair.submit_and_send() for _ in range(2)] == [(FIRST, 0), (FIRST, 1)]
    pair.silent.add(FIRST)
    pair.pass_time(260 * MS)
    assert pair.next_sent() == (OTHER, 1)
    first, _, copy = pair.told
    assert (copy.sequence, copy.worker) == (1, OTHER)
    assert copy.t_capture_ns == first.t_capture_ns
    assert copy.t1_ns > first.t1_ns
    assert pair.submit_and_send() == (OTHER, 2)  # its slots are free again
    events = {e["event"]: e for e in pair.lines(EVENTS_NAME)}
    assert events["suspect"]["worker"] == FIRST
    assert events["copy"]["why"] == "hand_over"


def test_a_worker_that_is_gone_is_left_at_once(pair):
    """No time has to pass: the token is down, and the newest frame goes to the other."""
    assert [pair.submit_and_send() for _ in range(2)] == [(FIRST, 0), (FIRST, 1)]
    pair.link.set_workers((OTHER,))
    assert pair.next_sent() == (OTHER, 1)
    assert pair.submit_and_send() == (OTHER, 2)


def test_a_silent_worker_is_asked_again_where_there_is_no_other(rig):
    """A drone with one worker keeps trying; the slots are freed by force."""
    rig.silent.add("w1")
    for _ in range(3):
        assert rig.submit_and_send()[0] == "w1"
        rig.pass_time(TIMEOUT_NS)
    late = [e["sequence"] for e in rig.lines(EVENTS_NAME) if e["event"] == "ack_timeout"]
    assert late == [0, 1, 2]


def test_a_link_that_went_silent_is_not_thought_fast(rig):
    """Acks within a millisecond, and then none: the goodput falls with the first time-out."""
    for n in range(5):
        rig.submit_and_send()
        rig.clock.advance(MS)
        rig.heard(n, "w1")
    fast = rig.uplink.goodput_bytes_per_s
    size = len(rig.submit_and_look())
    rig.pass_time(TIMEOUT_NS)
    slow = rig.uplink.goodput_bytes_per_s
    assert slow < fast
    assert slow <= 1.01 * size / (TIMEOUT_NS / 1e9)
    rig.heard(5, "w1")  # it comes after all, when its slot is long free
    assert rig.uplink.goodput_bytes_per_s <= 1.01 * size / (TIMEOUT_NS / 1e9)


def test_each_change_of_worker_is_an_event(rig):
    """Who was asked, who is now, and who was there."""
    rig.submit_and_send()
    rig.heard(0, "w1")
    rig.link.set_workers(("w2",))
    rig.submit_and_send()
    changes = [e for e in rig.lines(EVENTS_NAME) if e["event"] == "worker"]
    assert [(e["before"], e["now"], e["live"]) for e in changes] == [
        (None, "w1", ["w1"]),
        ("w1", "w2", ["w2"]),
    ]


def test_a_frame_too_old_to_be_answered_in_time_is_not_sent(rig):
    """It would only take the link from a newer one."""
    rig.uplink.submit(frame(rig.clock.now_ns() - AGE_MAX_NS), "x.png")
    assert eventually(lambda: rig.ledger.fates[Fate.TOO_OLD_ON_BOARD] == 1)
    assert rig.submit_and_send() == ("w1", 1)


def test_the_ledger_says_how_a_frame_was_coded_and_why(rig):
    """The first one goes out at its best, since nobody knows the link yet."""
    rig.submit_and_send()
    rig.uplink.stop()
    rig.ledger.close()
    (line,) = rig.lines(LEDGER_NAME)
    assert line["encoding"]["reason"] == "unknown_link"
    assert line["encoding"]["depth_step"] == 1


def test_every_worker_is_probed(pair):
    """The idle one as well: its round trip is known before it is needed."""
    pair.pass_time(200 * MS)
    assert all(pair.uplink.estimate(worker) is not None for worker in ("w1", "w2"))
    assert pair.uplink.standings() == {"w1": "willing", "w2": "willing"}


def test_stop_ends_the_thread_whatever_it_waits_for(tmp_path):
    """Idle, or with the window full and a frame waiting: the thread is gone, the frame told."""
    for waiting, folder in ((False, tmp_path / "idle"), (True, tmp_path / "full")):
        rig = Rig(folder, window=1)
        before = set(threading.enumerate())
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
