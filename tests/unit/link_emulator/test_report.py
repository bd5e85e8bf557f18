"""What a relay says of its work, for people and for scripts."""

from __future__ import annotations

import json

import pytest

from link_emulator.histogram import Histogram
from link_emulator.report import DirectionReport, Report, make_report

QUIET = DirectionReport(3, 300, {"queue_full": 0, "lost": 2, "cut": 0, "not_sent": 0}, 1)


def report(error_ns: int) -> Report:
    """Of packets that were all as late."""
    errors = Histogram()
    for _ in range(6):
        errors.add(error_ns)
    return make_report(QUIET, QUIET, errors, "fifo", 0.5)


@pytest.mark.parametrize(
    ("error_ns", "marked"), [(250_000, False), (299_500, False), (301_000, True)]
)
def test_inexact_run_is_marked(error_ns: int, marked: bool) -> None:
    """Over 0.3 ms at p99, and it says so to people, too."""
    assert report(error_ns).marked is marked
    assert ("MARKED" in str(report(error_ns))) is marked


def test_report_survives_json() -> None:
    """What the relay sends is what its starter reads."""
    sent = report(100_000)
    assert Report.from_json(json.loads(json.dumps(sent.as_json()))) == sent


def test_only_reasons_that_occurred_are_printed() -> None:
    """People look for what happened."""
    text = str(report(1000))
    assert "2 lost" in text
    assert "queue_full" not in text
