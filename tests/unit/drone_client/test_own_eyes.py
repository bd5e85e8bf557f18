"""The thread with the drone's own eyes: what it is given, what it says; it harms nobody."""

from __future__ import annotations

import json
import logging
import threading

import numpy as np
import pytest

from drone_client import own_eyes
from drone_client.ledger import Ledger
from drone_client.lookout import Lookout, LookoutSettings
from drone_client.onboard import LookVerdict
from drone_client.own_eyes import OwnEyes
from drone_client.reception import EdgeWord
from drone_client.run_files import ONBOARD_NAME
from drone_client.target import Source
from tests.unit.drone_client import onboard_world as world
from tests.unit.drone_client.builders import MS, SECOND, eventually


class StepClock:
    """Stands still until it is set."""

    def __init__(self, t_ns: int) -> None:
        self.t_ns = t_ns

    def now_ns(self) -> int:
        return self.t_ns


class Rig:
    """Own eyes over a real lookout and ledger, with a clock and a word of the edge at will."""

    def __init__(self, folder, knows_pose: bool = True) -> None:
        self.clock = StepClock(world.T0_NS + 355 * MS)
        self.word = world.said()
        self.ledger = Ledger(folder, own_eyes=True)
        self.folder = folder
        lookout = Lookout(world.TARGET, LookoutSettings(300 * MS, 5 * SECOND))
        self.eyes = OwnEyes(
            world.TARGET,
            lookout,
            lambda: self.word,
            lambda t_ns: world.WORLD_FROM_CAMERA if knows_pose else None,
            self.clock,
            self.ledger.look,
        )

    def __enter__(self) -> Rig:
        self.eyes.start()
        return self

    def __exit__(self, *_) -> None:
        self.eyes.stop()
        self.ledger.close()
        assert "own eyes" not in {t.name for t in threading.enumerate()}

    def lines(self, count: int) -> list[dict]:
        """The first lines, as soon as there are so many."""
        path = self.folder / ONBOARD_NAME
        assert eventually(lambda: path.read_text().count("\n") >= count)
        return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_frame_without_a_fresh_word_becomes_a_pose(tmp_path):
    """It leads, it is marked, and its line tells all of it."""
    with Rig(tmp_path) as rig:
        rig.eyes.offer(7, world.picture())
        (line,) = rig.lines(1)
        lead = rig.eyes.leading(rig.clock.now_ns())
    assert lead.source is Source.ONBOARD
    off = lead.world_from_target.translation - world.WORLD_FROM_TARGET.translation
    assert np.linalg.norm(off) < 0.006
    assert (line["verdict"], line["sequence"], line["method"]) == ("accepted", 7, "fused")
    assert line["source"] == "onboard"
    assert line["unconfirmed_ms"] == 350
    assert max(line["sigma_mm"]) < 50
    assert line["look_ms"] == 0  # its clock stands
    assert rig.eyes.verdicts == {LookVerdict.ACCEPTED: 1}


def test_while_the_edge_is_fresh_a_frame_costs_nothing(tmp_path, monkeypatch):
    """No look, no line, and the edge leads."""
    monkeypatch.setattr(own_eyes, "look", lambda *_: pytest.fail("nobody shall look"))
    with Rig(tmp_path) as rig:
        rig.word = world.said(world.T0_NS + 250 * MS)
        rig.eyes.offer(1, world.picture())
        assert rig.eyes.leading(rig.clock.now_ns()) is rig.word.estimate
        assert (tmp_path / ONBOARD_NAME).read_text() == ""
        assert not rig.eyes.verdicts


def test_newest_wins_and_the_displaced_frame_is_told(tmp_path, monkeypatch):
    """While one frame is looked at, of two more the older one is never seen."""
    go_on, looking = threading.Event(), threading.Event()
    look = own_eyes.look

    def slow(*arguments):
        looking.set()
        assert go_on.wait(10)
        return look(*arguments)

    monkeypatch.setattr(own_eyes, "look", slow)
    with Rig(tmp_path) as rig:
        rig.eyes.offer(1, world.picture(t_ns=world.T0_NS + 350 * MS))
        assert looking.wait(10)
        rig.eyes.offer(2, world.picture(t_ns=world.T0_NS + 351 * MS))
        rig.eyes.offer(3, world.picture(t_ns=world.T0_NS + 352 * MS))
        # the control loop is served meanwhile
        assert rig.eyes.leading(rig.clock.now_ns()) is rig.word.estimate
        go_on.set()
        verdicts = {k["sequence"]: k["verdict"] for k in rig.lines(3)}
    assert verdicts == {1: "accepted", 2: "displaced", 3: "accepted"}


@pytest.mark.parametrize(
    ("word", "verdict"),
    [
        (EdgeWord(world.edge_estimate(), world.T0_NS + 1), "denied"),
        (world.said(outliers=2), "contested"),
        (world.said(world.T0_NS - 6 * SECOND), "expired"),
    ],
)
def test_what_speaks_against_a_look_is_told_without_one(tmp_path, monkeypatch, word, verdict):
    """A line with the reason; the picture is not looked at."""
    monkeypatch.setattr(own_eyes, "look", lambda *_: pytest.fail("nobody shall look"))
    with Rig(tmp_path) as rig:
        rig.word = word
        rig.eyes.offer(1, world.picture())
        (line,) = rig.lines(1)
        assert line["verdict"] == verdict
        assert line["look_ms"] is None
        assert rig.eyes.leading(rig.clock.now_ns()) is word.estimate


def test_a_drone_that_does_not_know_where_it_is_says_so(tmp_path):
    """NO_OWN_POSE."""
    with Rig(tmp_path, knows_pose=False) as rig:
        rig.eyes.offer(1, world.picture())
        assert rig.lines(1)[0]["verdict"] == "no_own_pose"


def test_a_black_picture_is_a_reason(tmp_path):
    """And no pose."""
    with Rig(tmp_path) as rig:
        rig.eyes.offer(1, world.picture(dim=0.0))
        assert rig.lines(1)[0]["verdict"] in ("no_circle", "refused")
        assert rig.eyes.leading(rig.clock.now_ns()).source is Source.EDGE


def test_an_error_is_counted_told_once_and_the_next_frame_is_looked_at(
    tmp_path, monkeypatch, caplog
):
    """The thread goes on; the log has one traceback, not thirty a second."""
    look, errors = own_eyes.look, iter([RuntimeError("one"), RuntimeError("two")])

    def breaking(*arguments):
        if (error := next(errors, None)) is not None:
            raise error
        return look(*arguments)

    monkeypatch.setattr(own_eyes, "look", breaking)
    with caplog.at_level(logging.ERROR), Rig(tmp_path) as rig:
        for i in range(3):
            rig.eyes.offer(i, world.picture(t_ns=world.T0_NS + (350 + i) * MS))
            assert rig.lines(i + 1)[i]["sequence"] == i
        assert rig.eyes.leading(rig.clock.now_ns()).source is Source.ONBOARD
    assert [k["verdict"] for k in rig.lines(3)] == ["failed", "failed", "accepted"]
    assert rig.eyes.verdicts[LookVerdict.FAILED] == 2
    assert len([r for r in caplog.records if r.exc_info]) == 1


def test_an_error_never_reaches_who_flies_or_who_films(tmp_path, monkeypatch, caplog):
    """Control tick and capture go on as without own eyes."""

    def broken(*_):
        raise RuntimeError("broken")

    with caplog.at_level(logging.CRITICAL), Rig(tmp_path) as rig:
        monkeypatch.setattr(Lookout, "leading", broken)
        monkeypatch.setattr(Lookout, "is_due", broken)
        rig.eyes.offer(1, world.picture())
        assert rig.eyes.leading(rig.clock.now_ns()) is rig.word.estimate
    assert rig.eyes.verdicts[LookVerdict.FAILED] == 2


def test_stopping_before_starting_and_twice_is_no_error(tmp_path):
    """A run that ends before it begins."""
    rig = Rig(tmp_path)
    rig.eyes.stop()
    rig.eyes.stop()
    rig.ledger.close()
