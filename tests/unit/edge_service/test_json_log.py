"""Logging: one JSON object per line."""

from __future__ import annotations

import json
import logging

import pytest

from edge_service.json_log import JsonFormatter, configure


@pytest.fixture(autouse=True)
def _own_root_logger():
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


def test_a_record_is_one_line_with_its_extras(capsys):
    """Message, level and everything that was given as extra, on stderr."""
    configure("WARNING")
    log = logging.getLogger("some.module")
    log.warning("frame %s", "refused", extra={"reason": "checksum", "color_message": "x"})
    log.info("quiet")
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    record = json.loads(line)
    assert record.pop("time")
    assert record == {
        "level": "WARNING",
        "logger": "some.module",
        "message": "frame refused",
        "reason": "checksum",
    }


def test_what_strangers_make_the_http_server_say_is_bounded(capsys):
    """A flood of garbage is one line; our own lines are all there."""
    configure("WARNING")
    for _ in range(1000):
        logging.getLogger("uvicorn.error").warning("Invalid HTTP request received.")
        logging.getLogger("edge_service.some").warning("ours")
    lines = [json.loads(line)["message"] for line in capsys.readouterr().err.splitlines()]
    assert lines.count("Invalid HTTP request received.") == 1
    assert lines.count("ours") == 1000


@pytest.mark.parametrize("name", ["worker", "pipeline", "http.localize"])
def test_a_fault_that_lasts_is_not_a_traceback_for_every_frame(capsys, name):
    """The first one is there; those of a minute are one line, whatever drone they are of."""
    configure("WARNING")
    for k in range(100):
        try:
            raise RuntimeError(k)
        except RuntimeError:
            logging.getLogger(f"edge_service.{name}").exception("failed", extra={"drone": k})
    (line,) = capsys.readouterr().err.splitlines()
    assert "RuntimeError: 0" in json.loads(line)["exception"]


def test_a_traceback_stays_on_its_line():
    """An exception is a field, and what JSON does not know is written as text."""
    try:
        raise ValueError("two\nlines")
    except ValueError as error:
        record = logging.makeLogRecord(
            {"msg": "failed", "exc_info": (type(error), error, error.__traceback__), "at": {1, 2}}
        )
    line = JsonFormatter().format(record)
    assert "\n" not in line
    assert "ValueError: two\nlines" in json.loads(line)["exception"]
    assert json.loads(line)["at"] == "{1, 2}"
