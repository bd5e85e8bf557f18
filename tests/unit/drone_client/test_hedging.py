"""Hedging through a whole flight: a late answer costs no measurement, and none counts twice."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drone_client.airframe import Airframe
from drone_client.autopilot.memory import MemoryAutopilot
from drone_client.flight import Flight
from drone_client.flight_settings import flight_settings
from drone_client.ledger import Ledger
from drone_client.link.memory import MemoryLink
from drone_client.run_files import EVENTS_NAME, LEDGER_NAME
from drone_client.settings import ClientSettings
from drone_client.under_way import FEW_ROUND_TRIPS
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.envelope import Kind, unseal
from rgbd_wire.frame_codec import unpack
from rgbd_wire.messages import FrameHeader, seal_ack, seal_result
from rgbd_wire.probe import Probe, decode_probe, seal_probe
from tests.unit.drone_client.builders import WORKER_BOOT_ID, ack_of, eventually, frame, result_of

CLOCK = MonotonicClock()
WORKERS = ("w1", "w2")


class TwoWorkers:
    """Both acknowledge at once; one of them keeps its results to itself when told to."""

    def __init__(self, folder: Path, **changes) -> None:
        self.folder = folder
        self.holds_back: str | None = None
        self.held: list[tuple[str, FrameHeader]] = []
        self.asked: list[str] = []
        self.link = MemoryLink(CLOCK, self._on_frame, WORKERS, echo=self._on_probe)
        self.ledger = Ledger(folder)
        slow = {"tau_max_ms": 9e3, "age_max_ms": 9e3, "ack_timeout_ms": 9e3}
        settings = ClientSettings(**(slow | {"reply_timeout_ms": 5e4} | changes))
        self.flight = Flight(
            flight_settings(settings),
            Airframe(),
            self.link,
            MemoryAutopilot(),
            CLOCK,
            self.ledger,
            lambda now_ns: None,
        )

    def __enter__(self) -> TwoWorkers:
        self.flight.start()
        return self

    def __exit__(self, *_) -> None:
        self.flight.stop()

    def capture(self) -> None:
        """One frame."""
        self.flight.capture(frame(CLOCK.now_ns()), "x.png")

    def answer_held(self) -> None:
        """The late answer comes after all."""
        for worker, header in self.held:
            self.link.deliver([seal_result(result_of(header, worker, None))])

    def lines(self, name: str) -> list[dict]:
        assert self.ledger.on_disk()
        return [json.loads(line) for line in (self.folder / name).read_text().splitlines()]

    def _on_frame(self, worker: str, message: bytes) -> list[bytes]:
        header = unpack(message).header
        self.asked.append(worker)
        ack = seal_ack(ack_of(header, worker))
        if worker == self.holds_back:
            self.held.append((worker, header))
            return [ack]
        return [ack, seal_result(result_of(header, worker, None))]

    def _on_probe(self, worker: str, message: bytes) -> list[bytes]:
        _, body = unseal(message, Kind.PROBE)
        probe = decode_probe(body)
        echo = Probe(probe.boot_id, probe.sequence, probe.t1_ns, 5, 6, WORKER_BOOT_ID)
        return [seal_probe(echo)]


def fly_until_usual(rig: TwoWorkers) -> str:
    """Enough answers to know what late means; the worker that gives them."""
    for n in range(FEW_ROUND_TRIPS + 2):
        rig.capture()
        assert eventually(lambda n=n: rig.flight.tally.verdicts["accepted"] == n + 1)
    return rig.asked[-1]


@pytest.mark.parametrize("late_answer", [True, False])
def test_a_late_answer_is_hedged_and_the_first_one_wins(tmp_path, late_answer):
    """The copy's answer is accepted; the late one, if it ever comes, is counted and not used."""
    with TwoWorkers(tmp_path, hedge=True) as rig:
        first = fly_until_usual(rig)
        other = next(w for w in WORKERS if w != first)
        before = rig.flight.tally.verdicts["accepted"]
        rig.holds_back = first
        rig.capture()
        assert eventually(lambda: rig.flight.tally.verdicts["accepted"] == before + 1)
        assert rig.asked[-2:] == [first, other]
        if late_answer:
            rig.answer_held()
            assert eventually(lambda: rig.flight.tally.verdicts["other_copy"] == 1)
        assert rig.flight.tally.verdicts["accepted"] == before + 1
    (copy,) = [e for e in rig.lines(EVENTS_NAME) if e["event"] == "copy"]
    assert (copy["worker"], copy["why"]) == (other, "hedge")
    line = next(f for f in rig.lines(LEDGER_NAME) if f["sequence"] == copy["sequence"])
    assert (line["fate"], line["worker"], line["verdict"]) == ("answered", other, "accepted")


def test_without_being_asked_nothing_is_hedged(tmp_path):
    """A second copy costs the link a frame: it is the pilot's choice."""
    with TwoWorkers(tmp_path) as rig:
        first = fly_until_usual(rig)
        rig.holds_back = first
        rig.capture()
        assert eventually(lambda: rig.asked[-1] == first and len(rig.held) == 1)
        rig.answer_held()
        count = len(rig.asked)
        assert eventually(lambda: rig.flight.tally.verdicts["accepted"] == count)
        assert set(rig.asked) == {first}
