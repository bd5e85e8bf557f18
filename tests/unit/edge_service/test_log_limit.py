"""The bound on the log: once a minute for each kind, and a count of what was held back."""

from __future__ import annotations

import logging

from edge_service.log_limit import MAX_KINDS, LogLimit


class Clock:
    """Seconds that are set by hand."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def record(text="garbage", error=None, level=logging.WARNING, name="some.thing"):
    exc_info = None if error is None else (type(error), error, None)
    return logging.LogRecord(name, level, "file", 1, text, (), exc_info)


def test_a_flood_is_one_record_a_minute_with_a_count():
    """The first at once; the next after a minute tells how many there were between."""
    clock = Clock()
    limit = LogLimit("some", 60, clock)
    passed = []
    for second in range(180):
        clock.now_s = float(second)
        for _ in range(10):
            one = record()
            if limit.filter(one):
                passed.append((second, getattr(one, "held_back", 0)))
    assert passed == [(0, 0), (60, 599), (120, 599)]


def test_each_kind_has_its_own_minute():
    """Another text, level or exception is another kind; arguments are not."""
    limit = LogLimit("some", 60, Clock())
    kinds = [
        record("a"),
        record("b"),
        record("a", level=logging.ERROR),
        record("a", ValueError()),
        record("a", KeyError()),
    ]
    assert all(map(limit.filter, kinds))
    assert not any(map(limit.filter, kinds))
    first, second = record("from %s"), record("from %s")
    first.args, second.args = ("x",), ("y",)
    assert limit.filter(first)
    assert not limit.filter(second)


def test_kinds_without_end_fill_no_memory():
    """Those beyond the bound share one minute."""
    limit = LogLimit("some", 60, Clock())
    passed = sum(limit.filter(record(f"text {i}")) for i in range(10 * MAX_KINDS))
    assert passed == MAX_KINDS + 1
    assert len(limit._kinds) == MAX_KINDS + 1


def test_other_loggers_are_not_bounded():
    """Nor one whose name only begins alike."""
    limit = LogLimit("some", 60, Clock())
    for name in ("other", "something"):
        assert all(limit.filter(record(name=name)) for _ in range(3))
