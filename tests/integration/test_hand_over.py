"""A worker dies, hangs or drains in mid-flight: the drone goes to the other one by itself.

Real processes over both transports. What is asserted is that it happens, and how; how fast is
measured by ``scripts/bench handover``.
"""

import signal
import time

import pytest

from tests.two_workers import INTERRUPTED, Flying, Pair

FAULTS = {"killed": signal.SIGKILL, "hung": signal.SIGSTOP, "drained": signal.SIGTERM}
ENOUGH = 12
"""Accepted results before the fault, and again after it."""
PATIENT = ("--tau-max-ms", "2500", "--age-max-ms", "3000")
"""Two workers and a drone on two busy cores: none of their frames shall be too late there."""


@pytest.fixture(scope="module", params=["zenoh", "udp"])
def pair_of(request, tmp_path_factory):
    """A fresh pair of workers for each fault: it costs one of them."""

    def make(fault):
        return Pair(tmp_path_factory.mktemp(f"{request.param}-{fault}"), request.param)

    return make


@pytest.fixture(scope="module", params=sorted(FAULTS))
def flight(request, pair_of, tmp_path_factory):
    """A flight during which the worker of the newest accepted result gets a signal.

    On a busy machine the drone may change worker by itself before that, even in the very moment of
    the signal: what it was sending to then stands in its own events.
    """
    folder = tmp_path_factory.mktemp(request.param)
    with pair_of(request.param) as pair:
        flying = Flying(folder, pair, PATIENT)
        try:
            before = flying.wait_for_accepted(ENOUGH)
            other = next(name for name in pair.services if name != before)
            fault_ns = time.monotonic_ns()  # one machine, one clock: the drone's as well
            pair.services[before].process.send_signal(FAULTS[request.param])
            flying.wait_for_accepted(ENOUGH, other)
            run = flying.land()
            code = pair.services[before].process.wait(60) if request.param == "drained" else None
        finally:
            flying.close()
    return request.param, fault_ns, before, other, run, code


def test_the_other_worker_takes_over(flight):
    """Accepted results from the one, then from the other, and the change stands in the events."""
    _, fault_ns, before, other, run, _ = flight
    assert run.exit_code == INTERRUPTED
    until_then = [f["worker"] for f in run.accepted() if f["t4_ns"] <= fault_ns]
    assert before in until_then
    assert run.accepted()[-1]["worker"] == other
    assert (before, other) in [(e["before"], e["now"]) for e in run.changes()]
    assert run.worker_at(time.monotonic_ns()) == other


def test_each_frame_has_one_line_and_none_is_accepted_twice(flight):
    """Second copies make no second lines."""
    *_, run, _ = flight
    sequences = sorted(f["sequence"] for f in run.frames)
    assert sequences == list(range(len(sequences)))
    captures = [f["t_capture_ns"] for f in run.accepted()]
    assert captures == sorted(set(captures))


def test_a_silent_worker_is_suspected_by_its_missing_replies(flight):
    """The lease would take seconds; the drone tells by what it did not get."""
    fault, fault_ns, before, _, run, _ = flight
    suspects = [e["worker"] for e in run.events if e["event"] == "suspect"]
    if fault == "hung" and run.worker_at(fault_ns) == before:
        assert before in suspects


def test_a_drained_worker_answers_what_it_has_and_ends_well(flight):
    """Exit code 0, no frame of it is left without an answer, and so none is sent again."""
    fault, fault_ns, before, _, run, code = flight
    if fault == "drained":
        assert code == 0
        assert not [f for f in run.frames if f["fate"] == "no_reply" and f["worker"] == before]
        left = [e["why"] for e in run.changes() if e["before"] == before and e["t_ns"] > fault_ns]
        copies = [e for e in run.events if e["event"] == "copy" and e["t_ns"] > fault_ns]
        # On a starved machine the drone may see the end before the word that it drains, or have
        # waited too long for an answer before: it leaves such a one as any that is lost
        if not {"gone", "suspect"} & set(left):
            assert not [e for e in copies if e["why"] == "hand_over"]
