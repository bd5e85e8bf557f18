"""``serve`` in a process of its own, on a link in memory that tells stderr what is done with it.

Its one argument says what loads the model: a function of ``LOADS``.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading

from edge_service import process
from edge_service.json_log import configure
from edge_service.parts import Links
from edge_service.pipeline import Pipeline
from edge_service.settings import EdgeSettings
from edge_service.transport.memory import MemoryTransport
from rgbd_wire.clock import Clock
from tests.unit.edge_service.edge_fakes import KnownDetector, pipeline


def tell(word: str) -> None:
    """Say it where standard output may be broken."""
    print(word, file=sys.stderr, flush=True)


class StartedDetector(KnownDetector):
    """Says of itself what a start tells."""

    def describe(self):
        """What it is and how it runs."""
        return {**super().describe(), "engine": "none", "precision": "none", "threads": 1}


class ToldTransport(MemoryTransport):
    """Tells when it is announced and when it is closed."""

    def announce(self) -> None:
        """Tell it."""
        super().announce()
        tell("announced")

    def close(self) -> None:
        """Tell it."""
        super().close()
        tell("closed")


def at_once(_settings: EdgeSettings, clock: Clock, *, check: bool) -> Pipeline:
    """There is nothing to load."""
    assert check
    return pipeline(StartedDetector(), clock)


def told_to_stop(settings: EdgeSettings, clock: Clock, *, check: bool) -> Pipeline:
    """The signal comes when the model is all but there."""
    os.kill(os.getpid(), signal.SIGTERM)
    return at_once(settings, clock, check=check)


def never(settings: EdgeSettings, clock: Clock, *, check: bool) -> Pipeline:
    """A model that takes for ever."""
    tell("loading")
    threading.Event().wait()
    return at_once(settings, clock, check=check)


LOADS = {load.__name__: load for load in (at_once, told_to_stop, never)}


def main() -> None:
    """Serve until a signal."""
    process.make_links = lambda *_: Links(ToldTransport(), None, None, None, ())
    process.make_pipeline = LOADS[sys.argv[1]]
    configure("INFO")
    logging.getLogger("uvicorn").setLevel("WARNING")
    sys.exit(process.serve(EdgeSettings(name="w1", http="127.0.0.1:0", drain_s=2.0)))


if __name__ == "__main__":
    main()
