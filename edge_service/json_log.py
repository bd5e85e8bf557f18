"""Logging as one JSON object per line on stderr, for whatever collects a container's output."""

from __future__ import annotations

import json
import logging
import sys

from edge_service.log_limit import LogLimit

_STANDARD = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "taskName"}
_BOUNDED = (
    "uvicorn",
    "asyncio",
    "edge_service.http",
    "edge_service.pipeline",
    "edge_service.worker",
)
"""Loggers that warn of what anybody may send, or of what a lasting fault does to every frame."""
_FOR_TERMINALS = {"color_message"}  # uvicorn's second copy of its message


class JsonFormatter(logging.Formatter):
    """A record as JSON, with everything that was given as ``extra``."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        line = {
            "time": self.formatTime(record, "%Y-%m-%dT%H:%M:%S%z"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= {k: v for k, v in vars(record).items() if k not in _STANDARD | _FOR_TERMINALS}
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def configure(level: str) -> None:
    """Send records of ``level`` and above to stderr."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    for name in _BOUNDED:
        handler.addFilter(LogLimit(name))
    logging.basicConfig(level=level, handlers=[handler], force=True)
