"""Rendezvous hashing: spread out, stay put, and move only those who must."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from drone_client.worker_choice import choose_worker, rendezvous_score

names = st.text("abcdefghij0123456789-_", min_size=1, max_size=8)
workers = st.sets(names, min_size=1, max_size=8)


@given(names, workers, names)
def test_a_worker_that_goes_moves_only_its_own_drones(drone, live, gone):
    """Whoever was served by another stays with it."""
    before = choose_worker(drone, live | {gone}, None)
    after = choose_worker(drone, live - {gone}, None)
    if before != gone:
        assert after == before


@given(names, workers)
def test_the_choice_is_the_highest_score_and_depends_on_no_order(drone, live):
    """Every drone and every restart of it ranks the workers the same way."""
    best = sorted(live, key=lambda w: rendezvous_score(drone, w))[-1]
    assert choose_worker(drone, sorted(live), None) == best
    assert choose_worker(drone, sorted(live, reverse=True), None) == best


@given(names, workers, st.data())
def test_stays_with_a_worker_that_lives(drone, live, data):
    """A change of worker costs frames."""
    current = data.draw(st.sampled_from(sorted(live)))
    assert choose_worker(drone, live, current) == current


@given(names, workers, st.data())
def test_avoids_whom_it_should_unless_there_is_no_other(drone, live, data):
    """Even the current one is left; but a silent worker is better than none."""
    avoid = data.draw(st.sets(st.sampled_from(sorted(live))))
    current = data.draw(st.sampled_from(sorted(live)))
    chosen = choose_worker(drone, live, current, avoid)
    assert chosen in live
    if avoid != live:
        assert chosen not in avoid


def test_no_worker_no_choice():
    """Nobody alive: None, even if there was one a moment ago."""
    assert choose_worker("d", (), "w1") is None


def test_drones_spread_over_the_workers():
    """1000 drones on 4 workers: each has a share near a quarter (5 sigma of a binomial)."""
    shares = Counter(choose_worker(f"drone-{i}", ("a", "b", "c", "d"), None) for i in range(1000))
    assert all(abs(n - 250) < 5 * (1000 * 0.25 * 0.75) ** 0.5 for n in shares.values())
    assert len(shares) == 4
