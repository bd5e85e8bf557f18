"""The mailbox: one slot per drone, newest wins, nothing lost and nothing twice."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_service.mailbox import WINDOW, Arrival, Mailbox, Verdict

IDLE_NS = 1000
EVER_NS = 10**18


@dataclass(frozen=True)
class Header:
    """As much of a frame's header as the mailbox looks at."""

    drone: str
    boot_id: int
    sequence: int


@dataclass(frozen=True)
class Packed:
    header: Header


def arrival(drone="d", boot_id=1, sequence=0):
    return Arrival(Packed(Header(drone, boot_id, sequence)), 0)


def offer(mailbox, frame, now_ns=0):
    """Admit and, where that says so, put: the verdict and what lost its place."""
    verdict = mailbox.admit(frame.packed.header, now_ns)
    return verdict, mailbox.put(frame) if verdict is Verdict.ADMITTED else None


def test_takes_the_newest_and_hands_back_the_one_it_displaced():
    """A newer frame of a drone takes the place of its older one."""
    mailbox = Mailbox(4, EVER_NS)
    old, new = arrival(sequence=1), arrival(sequence=2)
    assert offer(mailbox, old) == (Verdict.ADMITTED, None)
    assert offer(mailbox, new) == (Verdict.ADMITTED, (old, Verdict.OUTDATED))
    assert mailbox.take(0) is new
    assert mailbox.take(0) is None


def test_an_older_frame_never_displaces_a_newer_one():
    """A frame that was overtaken on its way is outdated, even when the slot is empty again."""
    mailbox = Mailbox(4, EVER_NS)
    new = arrival(sequence=5)
    offer(mailbox, new)
    assert offer(mailbox, arrival(sequence=4))[0] is Verdict.OUTDATED
    assert mailbox.take(0) is new
    assert offer(mailbox, arrival(sequence=3))[0] is Verdict.OUTDATED


def test_an_older_frame_that_comes_twice_is_outdated_once():
    """A late frame is told that it is late; the same one again is not answered again."""
    mailbox = Mailbox(4, EVER_NS)
    offer(mailbox, arrival(sequence=5))
    assert offer(mailbox, arrival(sequence=4))[0] is Verdict.OUTDATED
    assert offer(mailbox, arrival(sequence=4))[0] is Verdict.REPEATED
    assert offer(mailbox, arrival(sequence=3))[0] is Verdict.OUTDATED


def test_an_overtaken_put_gives_its_own_frame_back():
    """Of two frames admitted in order and put in reverse, the newer one keeps the slot."""
    mailbox = Mailbox(4, EVER_NS)
    old, new = arrival(sequence=1), arrival(sequence=2)
    assert mailbox.admit(old.packed.header, 0) is Verdict.ADMITTED
    assert mailbox.admit(new.packed.header, 0) is Verdict.ADMITTED
    assert mailbox.put(new) is None
    assert mailbox.put(old) == (old, Verdict.OUTDATED)
    assert mailbox.take(0) is new


@pytest.mark.parametrize("back", [0, 1, WINDOW - 1, WINDOW, 10 * WINDOW])
def test_a_frame_that_came_before_is_repeated(back):
    """The same sequence again is repeated, however far back; within the window it is told."""
    mailbox = Mailbox(4, EVER_NS)
    offer(mailbox, arrival(sequence=10))
    offer(mailbox, arrival(sequence=10 + back))
    assert offer(mailbox, arrival(sequence=10))[0] is Verdict.REPEATED


def test_a_client_started_anew_begins_from_the_start():
    """After a new boot id low sequences are new, and what is late of the old start is not."""
    mailbox = Mailbox(4, EVER_NS)
    old = arrival(boot_id=1, sequence=900)
    offer(mailbox, old)
    fresh = arrival(boot_id=2, sequence=0)
    assert offer(mailbox, fresh) == (Verdict.ADMITTED, (old, Verdict.OUTDATED))
    assert offer(mailbox, arrival(boot_id=1, sequence=901))[0] is Verdict.OUTDATED
    assert offer(mailbox, arrival(boot_id=1, sequence=901))[0] is Verdict.REPEATED
    assert offer(mailbox, arrival(boot_id=1, sequence=900))[0] is Verdict.REPEATED
    assert mailbox.take(0) is fresh


def test_a_put_from_before_the_restart_does_not_displace_the_new_start():
    """A frame admitted just before its client was started anew loses to the new start."""
    mailbox = Mailbox(4, EVER_NS)
    old, fresh = arrival(boot_id=1, sequence=5), arrival(boot_id=2)
    assert mailbox.admit(old.packed.header, 0) is Verdict.ADMITTED
    assert offer(mailbox, fresh) == (Verdict.ADMITTED, None)
    assert mailbox.put(old) == (old, Verdict.OUTDATED)


def test_one_drone_too_many_has_no_room_until_another_falls_silent():
    """The longest silent drone makes way, but not before it is idle, and not with a frame."""
    mailbox = Mailbox(2, IDLE_NS)
    for drone, now_ns in (("a", 0), ("b", 10)):
        offer(mailbox, arrival(drone), now_ns)
    assert offer(mailbox, arrival("c"), 20)[0] is Verdict.NO_ROOM
    assert offer(mailbox, arrival("c", sequence=1), IDLE_NS + 1)[0] is Verdict.NO_ROOM
    assert mailbox.take(0).packed.header.drone == "a"
    assert offer(mailbox, arrival("c", sequence=2), IDLE_NS)[0] is Verdict.NO_ROOM
    assert offer(mailbox, arrival("c", sequence=3), IDLE_NS + 1)[0] is Verdict.ADMITTED
    assert mailbox.drones == 2


def test_the_longest_silent_drone_makes_way_not_the_first_one():
    """A drone that has been there longest but sends keeps its place."""
    mailbox = Mailbox(2, IDLE_NS)
    for drone, sequence, now_ns in (("a", 0, 0), ("b", 0, 0), ("a", 1, IDLE_NS)):
        offer(mailbox, arrival(drone, sequence=sequence), now_ns)
        mailbox.take(0)
    assert offer(mailbox, arrival("c"), IDLE_NS + 1)[0] is Verdict.ADMITTED
    assert offer(mailbox, arrival("a", sequence=1), IDLE_NS + 1)[0] is Verdict.REPEATED


def test_a_drone_silent_for_long_starts_over():
    """After its idle time even the sequences of a start that was replaced are taken again."""
    mailbox = Mailbox(2, IDLE_NS)
    offer(mailbox, arrival(boot_id=1), 0)
    offer(mailbox, arrival(boot_id=2), 0)
    mailbox.take(0)
    assert offer(mailbox, arrival(boot_id=1, sequence=1), IDLE_NS)[0] is Verdict.OUTDATED
    assert offer(mailbox, arrival(boot_id=1, sequence=2), IDLE_NS + 1)[0] is Verdict.ADMITTED


def test_drones_take_turns():
    """A drone that sends ten times as often is served as often as the others."""
    mailbox = Mailbox(3, EVER_NS)
    served = Counter()
    for n in range(30):
        for drone in "abc":
            for k in range(10 if drone == "a" else 1):
                offer(mailbox, arrival(drone, sequence=10 * n + k))
        served[mailbox.take(0).packed.header.drone] += 1
    assert served == {"a": 10, "b": 10, "c": 10}


def test_closed_it_takes_no_more_and_gives_out_the_rest():
    """What waits is still given out; what comes is turned away, known drone or not."""
    mailbox = Mailbox(4, EVER_NS)
    waiting, between = arrival("a"), arrival("b")
    offer(mailbox, waiting)
    assert mailbox.admit(between.packed.header, 0) is Verdict.ADMITTED
    mailbox.close()
    assert mailbox.put(between) == (between, Verdict.CLOSED)
    assert offer(mailbox, arrival("a", sequence=1))[0] is Verdict.CLOSED
    assert offer(mailbox, arrival("a", sequence=1))[0] is Verdict.REPEATED
    assert offer(mailbox, arrival("z"))[0] is Verdict.CLOSED
    assert not mailbox.finished
    assert mailbox.take(0) is waiting
    assert mailbox.finished
    assert mailbox.take(60) is None  # at once


def test_what_is_not_accepted_keeps_its_turn():
    """Taken is the first in turn that fits; the others are as if nobody had asked."""
    mailbox = Mailbox(4, EVER_NS)
    frames = {drone: arrival(drone) for drone in "abc"}
    for frame in frames.values():
        offer(mailbox, frame)
    assert mailbox.take(0, lambda it: it.drone != "a") is frames["b"]
    assert mailbox.take(0, lambda it: it.drone not in "ac") is None
    assert [mailbox.take(0), mailbox.take(0)] == [frames["a"], frames["c"]]


def test_a_stop_wakes_whoever_waits_for_a_frame_that_fits():
    """Nothing more comes, so there is nothing to wait for, not even with a frame that waits."""
    mailbox, taken = Mailbox(4, EVER_NS), []
    offer(mailbox, arrival())
    asked = threading.Event()

    def accept(_):
        asked.set()
        return False

    taker = threading.Thread(target=lambda: taken.append(mailbox.take(3600, accept)))
    taker.start()
    assert asked.wait(20)
    mailbox.close()
    taker.join(20)
    assert taken == [None]
    assert not mailbox.finished


def test_empty_gives_out_all_that_wait():
    """What is left at the end is given out in order of the turns."""
    mailbox = Mailbox(4, EVER_NS)
    frames = [arrival(drone) for drone in "abc"]
    for frame in frames:
        offer(mailbox, frame)
    assert mailbox.empty() == frames
    assert mailbox.empty() == []


FRAMES = st.tuples(st.sampled_from("abc"), st.integers(1, 3), st.integers(0, 80))
STEPS = st.lists(st.one_of(FRAMES, st.just("take")), max_size=120)


@given(STEPS)
def test_every_admitted_frame_leaves_exactly_once_and_the_newest_stays(steps):
    """Against a plain model: same verdicts, same frames out, none lost, none twice."""
    mailbox = Mailbox(2, EVER_NS)
    model = {}
    put, out = [], []
    for step in steps:
        if step == "take":
            taken = mailbox.take(0)
            waiting = [d for d in model if model[d]["waiting"] is not None]
            assert (taken is None) == (not waiting)
            if taken is not None:
                out.append(taken)
                drone = taken.packed.header.drone
                assert taken is model[drone]["waiting"]
                model[drone]["waiting"] = None
            continue
        drone, boot, sequence = step
        frame = arrival(*step)
        verdict, left = offer(mailbox, frame)
        if drone not in model and len(model) == 2:
            assert verdict is Verdict.NO_ROOM
            continue
        known = model.setdefault(drone, {"boots": [boot], "seen": {}, "waiting": None})
        if boot not in known["boots"]:
            # only the last two starts are remembered
            for gone in known["boots"][:-1]:
                known["seen"].pop(gone)
            known["boots"] = [known["boots"][-1], boot]
        seen = known["seen"].setdefault(boot, [])
        highest = max(seen, default=-1)
        if sequence in seen or sequence <= highest - WINDOW:
            assert verdict is Verdict.REPEATED
            continue
        seen.append(sequence)
        if boot != known["boots"][-1] or sequence < highest:
            assert verdict is Verdict.OUTDATED
            continue
        assert verdict is Verdict.ADMITTED
        put.append(frame)
        assert left == (known["waiting"] and (known["waiting"], Verdict.OUTDATED))
        if left is not None:
            out.append(left[0])
        known["waiting"] = frame
    out += mailbox.empty()
    assert Counter(map(id, out)) == Counter(map(id, put))


class Ledger:
    """Counts how often each frame was settled, from any thread."""

    def __init__(self):
        self.settled = Counter()
        self._lock = threading.Lock()

    def settle(self, frame):
        with self._lock:
            self.settled[frame.packed.header.drone, frame.packed.header.sequence] += 1


def send_all(mailbox, ledger, drone, n):
    for sequence in range(n):
        frame = arrival(drone, sequence=sequence)
        verdict, left = offer(mailbox, frame)
        if verdict is not Verdict.ADMITTED:
            assert verdict is Verdict.CLOSED
            ledger.settle(frame)
        elif left is not None:
            ledger.settle(left[0])


def take_all(mailbox, ledger):
    while not mailbox.finished:
        if (frame := mailbox.take(1.0)) is not None:
            ledger.settle(frame)


def test_nothing_is_lost_or_doubled_between_threads():
    """Four drones' threads against one taker and a close: each frame is settled exactly once."""
    mailbox, ledger = Mailbox(4, EVER_NS), Ledger()
    taker = threading.Thread(target=take_all, args=(mailbox, ledger))
    senders = [threading.Thread(target=send_all, args=(mailbox, ledger, d, 400)) for d in "abcd"]
    for thread in (taker, *senders):
        thread.start()
    senders[0].join()
    mailbox.close()
    for thread in (taker, *senders):
        thread.join()
    assert ledger.settled == Counter((d, n) for d in "abcd" for n in range(400))
