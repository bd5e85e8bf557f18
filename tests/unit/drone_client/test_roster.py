"""The roster: a worker that does not answer is left, and one that works is stayed with."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drone_client.roster import Roster, RosterSettings, Standing
from drone_client.worker_choice import ranked
from rgbd_wire.messages import Status

MS = 1_000_000
SECOND = 1_000_000_000
WORKERS = ("w1", "w2", "w3")


def status(worker: str, boot_id: int = 1, **changes) -> Status:
    """What an idle worker says."""
    said = {
        "sequence": 0,
        "waiting": 0,
        "drones": 1,
        "max_drones": 64,
        "service_p50_ns": 30 * MS,
        "service_p95_ns": 40 * MS,
        "model": "m",
        "draining": False,
    }
    return Status(worker=worker, worker_boot_id=boot_id, **(said | changes))


def roster_of(*workers: str) -> Roster:
    """A roster that sees these workers."""
    roster = Roster("drone-1")
    roster.see(workers)
    return roster


def make_suspect(roster: Roster, worker: str) -> None:
    """Three replies in a row missed."""
    assert [roster.missed(worker) for _ in range(3)] == [False, False, True]


def test_the_first_choice_is_the_rendezvous_hash():
    """Nothing is known yet: all weigh the same."""
    assert roster_of(*WORKERS).choose(0) == ranked("drone-1", dict.fromkeys(WORKERS, 1.0))[0]
    assert roster_of().choose(0) is None


def test_three_replies_missed_in_a_row_are_a_hand_over():
    """Two are not; a reply in between starts the count again."""
    roster = roster_of(*WORKERS)
    first = roster.choose(0)
    roster.missed(first)
    roster.missed(first)
    assert roster.choose(0) == first
    roster.replied(first, 1)
    roster.missed(first)
    roster.missed(first)
    assert roster.choose(2) == first
    assert roster.missed(first)
    assert roster.standing(first) is Standing.SUSPECT
    assert roster.choose(3) != first


def test_a_suspect_is_trusted_again_after_three_replies_in_a_row():
    """One late echo of a worker that hangs every now and then is not enough."""
    roster = roster_of("w1", "w2")
    make_suspect(roster, "w1")
    for _ in range(2):
        roster.replied("w1", 1)
    assert roster.standing("w1") is Standing.SUSPECT
    roster.missed("w1")
    for _ in range(2):
        roster.replied("w1", 3)
    assert roster.standing("w1") is Standing.SUSPECT
    roster.replied("w1", 4)
    assert roster.standing("w1") is Standing.WILLING


def test_a_worker_that_acknowledges_and_never_answers_is_left_for_a_while():
    """Its echoes say nothing of the part that hangs; after the cool-down it gets a chance."""
    roster = roster_of("w1", "w2")
    assert [roster.overdue("w1", 0) for _ in range(3)] == [False, False, True]
    for _ in range(20):
        roster.replied("w1", 4 * SECOND)
    assert roster.standing("w1") is Standing.SUSPECT
    roster.replied("w1", 5 * SECOND)
    assert roster.standing("w1") is Standing.WILLING
    assert not roster.overdue("w1", 5 * SECOND)  # the count has started afresh


def test_a_result_clears_the_count_of_overdue_ones():
    """Two overdue, a result, two overdue: a slow worker, not a hung one."""
    roster = roster_of("w1", "w2")
    for _ in range(3):
        roster.overdue("w1", 0)
        roster.overdue("w1", 0)
        roster.answered("w1")
    assert roster.standing("w1") is Standing.WILLING


def test_a_draining_worker_is_left_and_a_restarted_one_is_another():
    """By its status or by a result; a new boot_id wipes what was known."""
    roster = roster_of("w1", "w2")
    roster.take_status(status("w1", boot_id=1, draining=True))
    assert roster.choose(0) == "w2"
    roster.drains("w2")
    assert roster.choose(0) == roster.choose(1) is not None  # better than nobody
    roster.take_status(status("w1", boot_id=2))
    assert roster.choose(2) == "w1"


def test_a_full_worker_is_not_gone_to_unless_one_is_there_already():
    """It would turn the drone away; its own drones stay."""
    roster = roster_of("w1", "w2")
    first = roster.choose(0)
    other = "w2" if first == "w1" else "w1"
    for worker in WORKERS[:2]:
        roster.take_status(status(worker, drones=4, max_drones=4))
    assert roster.standing(first) is Standing.WILLING
    assert roster.standing(other) is Standing.FULL
    assert roster.runner_up() is None
    make_suspect(roster, first)
    assert roster.choose(1) == first  # nobody else would take it
    roster.take_status(status(other, drones=3, max_drones=4))
    assert roster.choose(2) == other


def test_answers_that_turn_frames_away_make_suspect_for_a_while():
    """Three in a row; one answer of use in between starts the count again."""
    roster = roster_of("w1", "w2")
    assert [roster.refused("w1", 0) for _ in range(2)] == [False, False]
    roster.answered("w1")
    assert [roster.refused("w1", 0) for _ in range(3)] == [False, False, True]
    for _ in range(9):
        roster.replied("w1", SECOND)
    assert roster.standing("w1") is Standing.SUSPECT
    roster.replied("w1", 5 * SECOND)
    assert roster.standing("w1") is Standing.WILLING
    assert not roster.refused("w1", 5 * SECOND)


def test_two_workers_of_one_name_are_told_and_clear_no_suspicion():
    """Their boot ids alternate; a restart never brings an old one back."""
    roster = roster_of("w1", "w2")
    roster.take_status(status("w1", boot_id=1))
    roster.take_status(status("w1", boot_id=2))
    assert roster.same_name == []
    make_suspect(roster, "w1")
    for n in range(6):
        roster.take_status(status("w1", boot_id=1 + n % 2))
    assert roster.same_name == ["w1"]
    assert roster.standing("w1") is Standing.SUSPECT


def test_one_that_went_and_came_back_starts_afresh():
    """Suspicion does not outlive the worker."""
    roster = roster_of("w1", "w2")
    make_suspect(roster, "w1")
    roster.see(("w2",))
    assert roster.standing("w1") is Standing.GONE
    roster.see(("w1", "w2"))
    assert roster.standing("w1") is Standing.WILLING


def test_with_suspects_alone_the_one_heard_of_last_is_asked():
    """The link may be at fault, not the workers."""
    for last, first in (("w1", "w2"), ("w2", "w1")):
        roster = roster_of("w1", "w2")
        roster.replied(first, 100)
        roster.replied(last, 200)
        for worker in (first, last):
            make_suspect(roster, worker)
        assert roster.choose(5 * SECOND) == last


@pytest.mark.parametrize(("hung", "full"), [("w1", "w2"), ("w2", "w1")])
def test_one_that_turns_frames_away_is_asked_rather_than_one_that_hangs(hung, full):
    """Both are suspects, and one of them is dead: it was heard of too, and fell silent later."""
    roster = roster_of("w1", "w2")
    for worker in (hung, full):
        roster.replied(worker, 0)
    make_suspect(roster, hung)
    for n in range(3):
        roster.replied(full, 2 * SECOND + n)
        roster.refused(full, 2 * SECOND + n)
    chosen = []
    for n in range(100):  # it replies, to probes and with refusals, and the other does not
        roster.replied(full, 2 * SECOND + n * 20 * MS)
        chosen.append(roster.choose(2 * SECOND + n * 20 * MS))
    assert set(chosen) == {full}


@pytest.mark.parametrize(("stuck", "full"), [("w1", "w2"), ("w2", "w1")])
def test_one_that_turns_frames_away_is_asked_rather_than_one_that_leaves_them(stuck, full):
    """Both reply to probes, in turn; whoever was heard of last a moment ago says nothing."""
    roster = roster_of("w1", "w2")
    for n in range(3):
        roster.overdue(stuck, n)
        roster.refused(full, n)
    chosen = []
    for n in range(100):
        roster.replied((stuck, full)[n % 2], n * 20 * MS)
        chosen.append(roster.choose(n * 20 * MS))
    assert set(chosen[2:]) == {full}


def test_a_worker_much_better_for_long_is_moved_to_and_not_before():
    """Hysteresis: twice the delay for less than a second moves nobody."""
    roster = Roster("drone-1", RosterSettings(better_for_ns=SECOND))
    roster.see(("w1", "w2"))
    first = roster.choose(0)
    other = "w2" if first == "w1" else "w1"
    for _ in range(30):
        roster.replied(first, 0, 200 * MS)
        roster.replied(other, 0, 20 * MS)
    moved = [t for t in range(0, 4000, 10) if roster.choose(t * MS) == other]
    assert 1000 <= moved[0] <= 2000
    assert moved == list(range(moved[0], 4000, 10))  # and it stays there


def test_a_burst_of_delay_moves_nobody():
    """Better for 0.9 s, then the same again: the count starts anew."""
    roster = roster_of("w1", "w2")
    first = roster.choose(0)
    other = "w2" if first == "w1" else "w1"
    for n in range(60):
        slow = n % 10 != 9
        roster.take_status(status(first, service_p50_ns=(300 if slow else 10) * MS))
        roster.take_status(status(other, service_p50_ns=10 * MS))
        assert roster.choose(n * 100 * MS) == first


def test_a_worker_that_served_nobody_yet_is_not_taken_for_a_fast_one():
    """It says 0 for want of frames: the drone stays; its own last word counts, if any."""
    roster = roster_of("w1", "w2")
    first = roster.choose(0)
    other = "w2" if first == "w1" else "w1"
    for n in range(100):
        for worker in (first, other):
            roster.replied(worker, n * 100 * MS, MS)
        roster.take_status(status(first, service_p50_ns=60 * MS))
        roster.take_status(status(other, service_p50_ns=0))
        assert roster.choose(n * 100 * MS) == first
    roster.take_status(status(other, service_p50_ns=70 * MS))
    roster.take_status(status(other, service_p50_ns=0))
    assert roster.expected_delay_ns(other) > roster.expected_delay_ns(first)


def test_waiting_frames_count_as_delay():
    """Two workers alike, one with a queue: the other one's expected delay is smaller."""
    roster = roster_of("w1", "w2")
    roster.take_status(status("w1", waiting=3))
    roster.take_status(status("w2", waiting=0))
    assert roster.expected_delay_ns("w1") - roster.expected_delay_ns("w2") == 90 * MS


def test_the_runner_up_is_somebody_else_who_is_willing():
    """A hedge to a suspect or to oneself is none."""
    roster = roster_of("w1", "w2")
    first = roster.choose(0)
    other = "w2" if first == "w1" else "w1"
    assert roster.runner_up() == other
    make_suspect(roster, other)
    assert roster.runner_up() is None


@given(st.sampled_from(["status", "replied", "missed", "overdue", "drains", "answered"]))
def test_what_is_said_of_strangers_is_ignored(what):
    """A worker whose token is not up does not come into being by a message."""
    roster = roster_of("w1")
    if what == "status":
        roster.take_status(status("rogue"))
    elif what in ("overdue", "replied"):
        getattr(roster, what)("rogue", 0)
    else:
        getattr(roster, what)("rogue")
    assert roster.standings() == {"w1": "willing"}


class RosterMachine(RuleBasedStateMachine):
    """Any history: whoever is chosen is alive, and willing if anybody is."""

    def __init__(self) -> None:
        super().__init__()
        self.roster = Roster("drone-1")
        self.live: frozenset[str] = frozenset()
        self.now_ns = 0

    @rule(live=st.frozensets(st.sampled_from(WORKERS)))
    def see(self, live):
        self.live = live
        self.roster.see(live)

    @rule(worker=st.sampled_from(WORKERS), step=st.integers(0, 2 * SECOND))
    def miss(self, worker, step):
        self.now_ns += step
        self.roster.missed(worker)

    @rule(worker=st.sampled_from(WORKERS), rtt=st.integers(0, SECOND))
    def reply(self, worker, rtt):
        self.roster.replied(worker, self.now_ns, rtt)

    @rule(worker=st.sampled_from(WORKERS))
    def refuse(self, worker):
        self.roster.refused(worker, self.now_ns)

    @rule(worker=st.sampled_from(WORKERS))
    def overdue(self, worker):
        self.roster.overdue(worker, self.now_ns)

    @rule(
        worker=st.sampled_from(WORKERS),
        boot_id=st.integers(0, 2),
        waiting=st.integers(0, 2**62),
        draining=st.booleans(),
    )
    def status(self, worker, boot_id, waiting, draining):
        self.roster.take_status(status(worker, boot_id, waiting=waiting, draining=draining))

    @invariant()
    def chooses_the_living_and_willing_first(self):
        chosen = self.roster.choose(self.now_ns)
        assert (chosen is None) == (not self.live)
        if chosen is None:
            return
        assert chosen in self.live
        standing = {w: self.roster.standing(w) for w in self.live}
        for better in (Standing.WILLING, Standing.SUSPECT, Standing.FULL):
            if better in standing.values():
                assert standing[chosen] is better
                break
        assert self.roster.runner_up() != chosen


TestRoster = RosterMachine.TestCase
TestRoster.settings = hypothesis_settings(max_examples=50, stateful_step_count=30)


@pytest.mark.parametrize("drone", ["a", "b", "c", "d", "e", "f"])
def test_a_fleet_does_not_move_as_one(drone):
    """How long a drone waits depends on its name, within twice the set time."""
    roster = Roster(drone)
    assert SECOND <= roster._patience_ns < 2 * SECOND
