"""The watch: a worker that falls silent is left in time, and its newest frame goes to another."""

from __future__ import annotations

import pytest

from drone_client.under_way import UnderWay
from drone_client.watch import MIN_ACK_WAIT_NS, Actions, Why, WorkerWatch
from drone_client.worker_choice import ranked
from rgbd_wire.frame_codec import compress
from rgbd_wire.messages import Outcome, Status
from rgbd_wire.probe import Probe
from tests.unit.drone_client.builders import MS, frame

DRONE, BOOT_ID = "drone-1", 77
WORKERS = ("w1", "w2")
FIRST, OTHER = ranked(DRONE, dict.fromkeys(WORKERS, 1.0))
AGE_MAX_NS = 300 * MS
PERIOD_NS = 66 * MS
"""A camera of 15 Hz."""
ROUND_TRIP_NS = 8 * MS


class World:
    """A drone that sends frames, and workers that echo and acknowledge unless they are silent."""

    def __init__(self, hedge: bool = False) -> None:
        self.watch = WorkerWatch(DRONE, BOOT_ID, AGE_MAX_NS, hedge=hedge)
        self.now_ns = 0
        self.live = WORKERS
        self.silent: set[str] = set()
        self.hung: set[str] = set()
        """Acknowledge and never answer."""
        self.ack_ns = ROUND_TRIP_NS
        self.outcomes: dict[str, Outcome] = {}
        """What each worker answers, if not that there is nothing."""
        self.next_frame_ns = 0
        self.sequence = 0
        self.sent: list[tuple[int, int, str]] = []
        """When, which, to whom; first copies."""
        self.copies: list[tuple[int, int, str, Why]] = []
        self.events: list[str] = []
        self.unheard: list[str] = []
        self.lost: list[int] = []
        self._replies: list[tuple[int, str, tuple]] = []

    def run(self, milliseconds: int) -> None:
        """Go on, in steps of 1 ms."""
        for _ in range(milliseconds):
            self.now_ns += MS
            self._deliver()
            self._act(self.watch.tick(self.now_ns, self.live))
            if self.now_ns >= self.next_frame_ns:
                self.next_frame_ns += PERIOD_NS
                self._send()

    def _send(self) -> None:
        worker = self.watch.choose(self.now_ns, self.live)
        if worker is None:
            return
        picture = compress(frame(self.now_ns))
        due_ns = self.now_ns + MIN_ACK_WAIT_NS
        self.watch.sent(UnderWay(self.sequence, picture, [worker], self.now_ns, due_ns))
        self.sent.append((self.now_ns, self.sequence, worker))
        self._ask(worker, self.sequence)
        self.sequence += 1

    def _ask(self, worker: str, sequence: int) -> None:
        if worker in self.silent:
            return
        self._replies.append((self.now_ns + self.ack_ns, "ack", (sequence, worker)))
        if worker not in self.hung:
            result_ns = self.now_ns + self.ack_ns + 32 * MS
            self._replies.append((result_ns, "result", (sequence, worker)))

    def _act(self, actions: Actions) -> None:
        for worker, probe in actions.probes:
            if worker not in self.silent:
                self._replies.append((self.now_ns + ROUND_TRIP_NS, "echo", (worker, probe)))
        for copy in actions.copies:
            self.copies.append((self.now_ns, copy.frame.sequence, copy.worker, copy.why))
            self._ask(copy.worker, copy.frame.sequence)
        self.events += [name for name, _ in actions.events]
        self.unheard += actions.unheard
        self.lost += actions.lost

    def _deliver(self) -> None:
        due = [r for r in self._replies if r[0] <= self.now_ns]
        self._replies = [r for r in self._replies if r[0] > self.now_ns]
        for _, kind, details in due:
            if details[-1 if kind != "echo" else 0] in self.silent:
                continue
            if kind == "echo":
                _, probe = details
                echo = Probe(BOOT_ID, probe.sequence, probe.t1_ns, 5, 6, 9)
                self.watch.echo(echo, self.now_ns)
            elif kind == "ack":
                self.watch.heard(*details, self.now_ns)
            else:
                sequence, worker = details
                self.watch.heard(sequence, worker, self.now_ns)
                outcome = self.outcomes.get(worker, Outcome.NOTHING_FOUND)
                self.watch.answered(sequence, worker, self.now_ns, outcome, settled=True)


def test_a_drone_stays_with_a_worker_that_answers():
    """Two seconds of peace: one worker, no copy, no suspicion, nothing lost."""
    world = World()
    world.run(2000)
    assert {w for _, _, w in world.sent} == {FIRST}
    assert world.copies == []
    assert world.lost == []
    assert world.events == ["worker"]


def test_a_worker_that_falls_silent_is_left_within_300_ms_and_its_newest_frame_goes_on():
    """Hung process or black hole: acks and echoes end at once, and the token stays up."""
    world = World()
    world.run(1000)
    world.silent.add(FIRST)
    world.run(300)
    assert [(w, why) for _, _, w, why in world.copies] == [(OTHER, Why.HAND_OVER)]
    assert world.unheard == [FIRST]
    assert world.watch.worker == OTHER
    _, sequence, _, _ = world.copies[0]
    assert sequence == max(n for _, n, w in world.sent if w == FIRST)
    assert world.watch.standings() == {FIRST: "suspect", OTHER: "willing"}
    world.run(1000)
    assert world.sent[-1][2] == OTHER


def first_one_goes_with_a_frame() -> tuple[World, int]:
    """A frame is on its way to a worker whose token goes; the frame's number."""
    world = World()
    world.run(1001)
    world._send()
    world.silent.add(FIRST)
    world.live = (OTHER,)
    return world, world.sent[-1][1]


def test_a_worker_that_is_gone_is_left_at_once():
    """The token goes: the next tick hands over, without waiting for anything."""
    world, newest = first_one_goes_with_a_frame()
    world.run(1)
    assert [(s, w) for _, s, w, _ in world.copies] == [(newest, OTHER)]
    assert newest in world.lost


def test_a_worker_that_is_found_gone_as_a_frame_leaves_is_handed_over_all_the_same():
    """Between two ticks: the frame goes to the other, and the next tick looks after the rest."""
    world, newest = first_one_goes_with_a_frame()
    world._send()
    assert world.sent[-1][2] == OTHER
    world.run(1)
    assert [(s, w) for _, s, w, _ in world.copies] == [(newest, OTHER)]
    assert newest in world.lost


def test_a_silent_worker_that_comes_back_is_trusted_and_not_gone_back_to():
    """It is willing again after a few echoes; the drone stays where it is."""
    world = World()
    world.run(1000)
    world.silent.add(FIRST)
    world.run(500)
    world.silent.clear()
    world.run(1000)
    assert world.watch.standings() == {FIRST: "willing", OTHER: "willing"}
    assert world.watch.worker == OTHER


def test_a_worker_that_acknowledges_and_never_answers_is_left():
    """Only its link lives: three frames past their age, and it is suspect for a while."""
    world = World()
    world.run(1000)
    world.hung.add(FIRST)
    world.run(700)
    assert world.watch.worker == OTHER
    world.run(2000)
    assert world.watch.standings()[FIRST] == "suspect"


@pytest.mark.parametrize("outcome", [Outcome.OVERLOADED, Outcome.FAILED, Outcome.DROPPED])
def test_a_worker_that_turns_frames_away_is_left_and_not_gone_back_to(outcome):
    """It answers at once, and nothing of use: fast is not good."""
    world = World()
    world.run(1000)
    world.outcomes[FIRST] = outcome
    world.run(500)
    assert world.watch.worker == OTHER
    count = len(world.sent)
    world.run(4000)
    assert {w for _, _, w in world.sent[count:]} == {OTHER}


def test_a_frame_turned_away_now_and_then_moves_nobody():
    """Superseded is no refusal, and one overload among good answers is none either."""
    world = World()
    for n in range(40):
        world.outcomes[FIRST] = Outcome.OVERLOADED if n % 3 == 2 else Outcome.SUPERSEDED
        world.run(66)
    assert {w for _, _, w in world.sent} == {FIRST}


@pytest.mark.parametrize("token_goes", [False, True])
def test_a_draining_worker_is_left_and_keeps_what_it_has(token_goes):
    """It answers what is under way: no copy, no lost slot."""
    world = World()
    world.run(1000)
    status = Status(FIRST, 9, 0, 0, 1, 64, 0, 0, "m", True)
    world.watch.take_status(status)
    if token_goes:  # before the watch has looked
        world.live = (OTHER,)
    world.run(200)
    assert world.watch.worker == OTHER
    assert world.copies == []
    assert world.lost == []


def test_with_one_worker_alone_a_drone_goes_on_asking():
    """Suspect, but there is no other; and when it answers again all is well."""
    world = World()
    world.live = ("w1",)
    world.run(500)
    world.silent.add("w1")
    world.run(500)
    count = len(world.sent)
    world.run(500)
    assert len(world.sent) > count
    assert world.copies == []
    world.silent.clear()
    world.run(500)
    assert world.watch.standings() == {"w1": "willing"}


def test_when_all_are_silent_nobody_gets_a_copy_twice():
    """The radio is down, not a worker: each frame goes out twice at most."""
    world = World()
    world.run(1000)
    world.silent.update(WORKERS)
    world.run(3000)
    sequences = [s for _, s, _, _ in world.copies]
    assert len(sequences) == len(set(sequences))
    assert world.watch.worker is not None


@pytest.mark.parametrize("hedge", [True, False])
def test_a_late_answer_gets_a_second_copy_only_where_that_is_asked_for(hedge):
    """One frame gets stuck; the runner-up gets a copy while it still can make it."""
    world = World(hedge=hedge)
    world.run(1000)
    world.hung.add(FIRST)  # acks go on, so nobody is suspected yet
    world.run(110)
    expected = [(OTHER, Why.HEDGE)] if hedge else []
    assert [(w, why) for _, _, w, why in world.copies] == expected


def test_a_slow_link_does_not_make_the_idle_worker_look_better():
    """Acks of frames take 150 ms, echoes 8 ms to both: the drone stays where it is."""
    world = World()
    world.ack_ns = 150 * MS
    world.run(6000)
    assert {w for _, _, w in world.sent} == {FIRST}


def test_probes_go_to_every_worker_and_tell_its_round_trip():
    """The idle one is known as well as the one in use."""
    world = World()
    world.run(2000)
    for worker in WORKERS:
        assert world.watch.round_trip_ns(worker) == ROUND_TRIP_NS - 1  # held for 1 ns
    assert world.watch.round_trip_ns("nobody") == 0
