"""Rendezvous hashing: spread out by weight, and move only those who must."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.worker_choice import ranked, rendezvous_score

names = st.text("abcdefghij0123456789-_", min_size=1, max_size=8)
weights = st.dictionaries(names, st.floats(0.01, 100), min_size=1, max_size=8)


@given(names, weights, names)
def test_a_worker_that_goes_moves_only_its_own_drones(drone, live, gone):
    """Whoever was served by another stays with it."""
    before = ranked(drone, live | {gone: 1.0})[0]
    rest = {w: x for w, x in live.items() if w != gone}
    if before != gone:
        assert ranked(drone, rest)[0] == before


@given(names, weights)
def test_the_order_is_by_score_and_depends_on_no_order(drone, live):
    """Every drone and every restart of it ranks the workers the same way."""
    order = ranked(drone, live)
    scores = [rendezvous_score(drone, w, live[w]) for w in order]
    assert scores == sorted(scores, reverse=True)
    assert ranked(drone, dict(reversed(live.items()))) == order


@given(names, names, st.floats(0.01, 100), st.floats(1.0, 50.0))
def test_more_weight_never_ranks_lower(drone, worker, weight, factor):
    """A worker that got faster loses no drone."""
    more = rendezvous_score(drone, worker, weight * factor)
    assert more >= rendezvous_score(drone, worker, weight)


@pytest.mark.parametrize("weights", [(1, 1, 1, 1), (1, 2, 4, 1)])
def test_drones_spread_over_the_workers_by_their_weights(weights):
    """1000 drones: each worker has its share (5 sigma of a binomial)."""
    live = dict(zip("abcd", map(float, weights), strict=True))
    shares = Counter(ranked(f"drone-{i}", live)[0] for i in range(1000))
    for worker, weight in live.items():
        p = weight / sum(weights)
        assert abs(shares[worker] - 1000 * p) < 5 * (1000 * p * (1 - p)) ** 0.5
