"""A short run of the fuzzer; ``tests/perf/fuzz_wire.py`` is the long one."""

from __future__ import annotations

import random
from collections import Counter

from rgbd_wire.errors import Reject
from tests.perf.fuzz_wire import mutant, receive, seeds


def test_vectors_themselves_are_accepted():
    """The fuzzer starts from messages that a receiver takes."""
    assert all("accepted" in receive(data) for data in seeds())


def test_mutants_are_answered_or_refused():
    """Ten thousand mutants: a message or a reason, never another exception, never a warning.

    Every reason comes up, so that the mutants are known to reach every layer.
    """
    rng, sources = random.Random(7), seeds()
    outcomes = Counter(receive(mutant(rng.choice(sources), rng)) for _ in range(10_000))
    assert {reason.value for reason in Reject} <= set(outcomes)
    for kind in ("frame", "result", "ack", "probe", "status"):
        assert outcomes[f"{kind} accepted"] > 50
