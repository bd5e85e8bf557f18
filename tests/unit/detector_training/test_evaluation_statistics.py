"""Intervals, average precision and the operating point, beside scipy, sklearn and plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from sklearn.metrics import average_precision_score

from detector_training.evaluation.intervals import upper_bound, wilson
from detector_training.evaluation.matching import Outcome, match
from detector_training.evaluation.operating_point import at_false_positive_rate
from detector_training.evaluation.precision_recall import (
    average_precision,
    draw_pictures,
    precision_intervals,
    rank,
    rank_at_all,
    resampled_precision,
)


def _outcomes(seed, pictures=6):
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(pictures):
        k, m = int(rng.integers(0, 5)), int(rng.integers(0, 3))
        scores = np.sort(rng.random(k))[::-1]
        overlaps = rng.random((k, m)).astype(np.float32)
        made.append(Outcome(scores, overlaps, rng.random(m) < 0.7))
    return made


SEEDS = st.integers(0, 10**6)


@given(trials=st.integers(1, 5000), share=st.floats(0, 1))
def test_wilson_is_scipys(trials, share):
    """Value and both ends, at 0 and at all too."""
    hits = round(share * trials)
    want = stats.binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    got = wilson(hits, trials)
    assert got == pytest.approx((hits / trials, want.low, want.high), abs=1e-12)


def test_no_trials_have_no_share_and_too_many_hits_are_refused():
    """Nothing is known of nothing."""
    assert wilson(0, 0) is None
    with pytest.raises(ValueError, match="3 hits of 2 trials"):
        wilson(3, 2)


@given(events=st.integers(0, 300), pictures=st.integers(1, 10_000))
def test_upper_bound_is_garwoods(events, pictures):
    """Half a quantile of chi squared, by scipy."""
    want = stats.chi2.ppf(0.95, 2 * (events + 1)) / 2 / pictures
    assert upper_bound(events, pictures) == pytest.approx(want, rel=1e-9)


def test_none_in_three_thousand_bounds_the_rate_by_one_in_a_thousand():
    """The rule of three."""
    assert upper_bound(0, 3000) == pytest.approx(1e-3, rel=0.01)


@given(seed=SEEDS, count=st.integers(1, 30))
def test_area_under_the_raw_curve_is_scikit_learns(seed, count):
    """Where every truth is found both mean the same, before the curve is made monotonic."""
    rng = np.random.default_rng(seed)
    hits = rng.random(count) < 0.5
    hits[rng.integers(count)] = True
    scores = rng.permutation(count) / count
    outcomes = [
        Outcome(
            np.array([s]),
            np.ones((1, 1), np.float32) if hit else np.zeros((1, 0), np.float32),
            np.ones(int(hit), bool),
        )
        for s, hit in zip(scores, hits, strict=True)
    ]
    ranking = rank(outcomes, 0.5)
    raw = ranking.precision[ranking.hits].sum() / ranking.truths.sum()
    want = average_precision_score(hits, scores)
    assert raw == pytest.approx(want)
    assert average_precision(outcomes, 0.5) >= want - 1e-12


@given(seed=SEEDS)
@settings(max_examples=60, deadline=None)
def test_a_draw_of_the_bootstrap_is_the_set_with_its_pictures_repeated(seed):
    """The vectorised way against scoring each drawn list of pictures by itself."""
    outcomes = _outcomes(seed)
    draws = draw_pictures(len(outcomes), seed, 8)
    assert (draws.sum(axis=1) == len(outcomes)).all()
    for got, draw in zip(resampled_precision(rank(outcomes, 0.5), draws), draws, strict=True):
        drawn = [o for o, times in zip(outcomes, draw, strict=True) for _ in range(times)]
        want = average_precision(drawn, 0.5)
        assert np.isnan(got) if want is None else got == pytest.approx(want)


@given(seed=SEEDS)
@settings(max_examples=40, deadline=None)
def test_some_pictures_of_a_ranking_are_ranked_as_by_themselves(seed):
    """Scores, hits, pictures and truths, in any order of the pictures."""
    outcomes = _outcomes(seed)
    chosen = np.random.default_rng(seed).permutation(len(outcomes))[:3].tolist()
    got = rank(outcomes, 0.5).of(chosen)
    want = rank([outcomes[k] for k in chosen], 0.5)
    for name in ("scores", "hits", "pictures", "truths"):
        assert (getattr(got, name) == getattr(want, name)).all()


def test_the_bootstrap_is_seeded_and_holds_its_value():
    """Twice the same; more pictures give a shorter interval."""
    few, many = (rank_at_all(_outcomes(1, count)) for count in (20, 400))
    assert precision_intervals(few, 3) == precision_intervals(few, 3)
    for rankings in (few, many):
        for x in precision_intervals(rankings, 3):
            assert 0 <= x.low <= x.value <= x.high <= 1
    lengths = [x.high - x.low for x in (precision_intervals(r, 3)[0] for r in (few, many))]
    assert lengths[1] < lengths[0]


@given(seed=SEEDS, iou=st.sampled_from([0.3, 0.5, 0.8]))
@settings(max_examples=80, deadline=None)
def test_matching_is_the_plain_loops(seed, iou):
    """Each found box takes the best free truth that counts; no truth is taken twice."""
    for outcome in _outcomes(seed):
        free, want = set(np.flatnonzero(outcome.counts).tolist()), []
        for row in outcome.overlaps.tolist():
            best = max(free, key=lambda m: row[m], default=None)
            near = best is not None and row[best] >= iou
            want.append(best if near else -1)
            free -= {best} if near else set()
        hit, ignored, taken = match(outcome, iou)
        assert taken.tolist() == want
        assert hit.tolist() == [m >= 0 for m in want]
        uncounted = np.flatnonzero(~outcome.counts)
        for k, row in enumerate(outcome.overlaps):
            assert ignored[k] == (want[k] < 0 and bool((row[uncounted] >= iou).any()))


@given(seed=SEEDS, allowed=st.sampled_from([0.0, 100.0, 250.0, 1000.0]))
@settings(max_examples=80, deadline=None)
def test_no_lower_threshold_would_keep_the_rate(seed, allowed):
    """At the threshold the rate is kept; just below it, where it is not 0, it is not."""
    outcomes = _outcomes(seed, 12)

    def false_above(threshold):
        count = 0
        for o in outcomes:
            hit, ignored, _ = match(o)
            count += int((~hit & ~ignored & (o.scores > threshold)).sum())
        return count

    point = at_false_positive_rate(outcomes, outcomes, allowed)
    assert point.false_positives == false_above(point.threshold) <= allowed / 1000 * 12
    if point.threshold > 0:
        assert false_above(point.threshold - 1e-9) > allowed / 1000 * 12
    assert point.upper_bound_per_1000 > 1000 * point.false_positives / 12


def test_recall_at_the_operating_point_counts_what_is_above_it():
    """One of two finds is better than the one false box that is not allowed."""
    hit = Outcome(np.array([0.9]), np.array([[0.8]], np.float32), np.array([True]))
    weak = hit._replace(scores=np.array([0.4]))
    false = Outcome(np.array([0.6]), np.zeros((1, 0), np.float32), np.zeros(0, bool))
    point = at_false_positive_rate([hit, weak], [hit, weak, false], 1.0)
    assert (point.threshold, point.recall.value, point.false_positives) == (0.6, 0.5, 0)
    generous = at_false_positive_rate([hit, weak], [hit, weak, false], 334.0)
    assert (generous.threshold, generous.recall.value, generous.false_positives) == (0.0, 1.0, 1)
