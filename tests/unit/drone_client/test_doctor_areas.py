"""All areas of the doctor at once: whatever one of them does, there are lines and an end."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from drone_client.doctor.areas import look_at
from drone_client.doctor.finding import Check, Finding, ok
from drone_client.errors import LinkError
from rgbd_wire.errors import CameraFileError
from target_pose.errors import TargetFileError

LONG_S = 60.0


@pytest.fixture
def never() -> Iterator[Callable[[], list[Check]]]:
    """An area that hangs until the test is over."""
    over = threading.Event()

    def hang() -> list[Check]:
        over.wait(LONG_S)
        return []

    yield hang
    over.set()


def raising(error: BaseException) -> Callable[[], list[Check]]:
    """An area that fails."""

    def look() -> list[Check]:
        raise error

    return look


def test_the_lines_come_in_the_order_of_the_areas():
    """Whoever is done first."""
    second_is_done = threading.Event()

    def first() -> list[Check]:
        assert second_is_done.wait(LONG_S)
        return [ok("first", "a", "")]

    def second() -> list[Check]:
        second_is_done.set()
        return [ok("second", "a", ""), ok("second", "b", "")]

    checks = look_at({"first": (first, LONG_S), "second": (second, LONG_S)})
    assert [(c.area, c.name) for c in checks] == [("first", "a"), ("second", "a"), ("second", "b")]


@pytest.mark.parametrize(
    "error",
    [LinkError("no\nendpoint"), CameraFileError("no\nendpoint"), TargetFileError("no\nendpoint")],
)
def test_an_error_of_ours_is_a_fault_in_its_own_words(error, caplog):
    """On one line, and without a traceback."""
    (check,) = look_at({"service": (raising(error), LONG_S)})
    assert (check.area, check.finding, check.found) == ("service", Finding.FAULT, "no endpoint")
    assert check.advice
    assert not caplog.records


@pytest.mark.parametrize("error", [ZeroDivisionError("by\nzero"), RuntimeError(), OSError(5, "io")])
def test_any_other_error_is_a_fault_too_and_its_traceback_is_logged(error, caplog):
    """With its type, for it may have no words; the others are told all the same."""
    areas = {"camera": (raising(error), LONG_S), "files": (lambda: [ok("files", "a", "")], LONG_S)}
    bad, good = look_at(areas)
    assert (bad.area, bad.finding) == ("camera", Finding.FAULT)
    assert bad.found.startswith(f"{type(error).__name__}: ")
    assert "\n" not in bad.found
    assert bad.advice
    assert good.finding is Finding.OK
    assert caplog.records[0].exc_info[1] is error


def test_a_thread_that_is_ended_is_a_fault():
    """A library that leaves by SystemExit ends neither the command nor its report."""
    (check,) = look_at({"camera": (raising(SystemExit(0)), LONG_S)})
    assert check.finding is Finding.FAULT


def test_an_area_that_hangs_is_a_fault_and_the_others_are_waited_for(never):
    """Each by its own limit; what hangs is shown meanwhile."""
    others_turn = threading.Event()
    shown: list[list[str]] = []

    def on_wait(names: list[str]) -> None:
        shown.append(list(names))
        if names == ["files"]:
            others_turn.set()

    def patient() -> list[Check]:
        assert others_turn.wait(LONG_S)
        return [ok("files", "a", "")]

    bad, good = look_at({"camera": (never, 0.01), "files": (patient, LONG_S)}, on_wait)
    assert (bad.area, bad.finding) == ("camera", Finding.FAULT)
    assert bad.found == "no end within 0.01 s"
    assert "--limit-s" in bad.advice
    assert good.finding is Finding.OK
    assert shown[0] == ["camera", "files"]
