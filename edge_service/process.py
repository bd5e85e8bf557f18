"""The service as a process: signals, the start-up lines, the exit code."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib import metadata
from typing import Any, NamedTuple

from edge_service.http.app import create_app
from edge_service.http.server import HttpServer, bind, url_of
from edge_service.mailbox import Mailbox
from edge_service.metrics import Metrics
from edge_service.parts import make_links, make_pipeline
from edge_service.service import EdgeService
from edge_service.settings import EdgeSettings
from edge_service.state import ServiceState
from rgbd_wire.clock import MonotonicClock

log = logging.getLogger(__name__)

EXIT_OK = 0
EXIT_STUCK = 1
EXIT_FORCED = 130


class _End(NamedTuple):
    """How it ended."""

    code: int
    thread_left: bool
    """One is still at work, and Python would wait for it, or for another that waits for it."""


def serve(settings: EdgeSettings) -> int:
    """Run until SIGTERM or SIGINT; the exit code.

    Raises:
        AddressError, TlsFilesError, KeyFileError, WeightsError, TargetFileError,
        SelfCheckError: it cannot start.
    """
    try:
        end = asyncio.run(_serve(settings))
    finally:
        _let_go_of_output()
    if end.thread_left:
        logging.shutdown()
        os._exit(end.code)
    return end.code


async def _serve(settings: EdgeSettings) -> _End:
    start_s = time.monotonic()
    _say(f"edge-service {metadata.version('aerial-contact')}, worker {settings.name}")
    mailbox = Mailbox(settings.max_drones, int(settings.drone_idle_s * 1e9))
    state = ServiceState(settings, Metrics(), mailbox)
    listener = bind(*settings.http_address)
    _say(f"http   {url_of(listener)} (alive, not ready)")
    http = HttpServer(create_app(state))
    http_task = asyncio.create_task(http.serve([listener]))
    stop = _stop_on_signals()
    stopped = asyncio.create_task(stop.wait())
    # A thread of its own: asyncio waits for those of its pool, however long a model takes to load
    loading = asyncio.get_running_loop().run_in_executor(
        ThreadPoolExecutor(1, thread_name_prefix="load"), _bring_up, settings, state
    )
    either: set[asyncio.Future[Any]] = {loading, stopped}
    try:
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        if stop.is_set():
            # No drone knows of this worker, so there is nothing to drain
            loading.cancel()
            _say("bye; stopped before it was ready")
            return _End(EXIT_OK, thread_left=True)
        service = loading.result()
        await asyncio.to_thread(service.start)
        seconds = time.monotonic() - start_s
        _say(f"ready  in {seconds:.1f} s; Ctrl-C stops")
        await asyncio.wait({stopped, http_task}, return_when=asyncio.FIRST_COMPLETED)
        _say("drain  answering what is here")
        finished = await asyncio.to_thread(service.drain, time.sleep)
        log.info("drained", extra={"finished": finished})
    finally:
        http.should_exit = True
        await http_task
    _say("bye" if finished else "bye; the worker is stuck with a frame")
    return _End(EXIT_OK, False) if finished else _End(EXIT_STUCK, thread_left=True)


def _bring_up(settings: EdgeSettings, state: ServiceState) -> EdgeService:
    # The link first: a port that is taken is told before seconds are spent on the model. Drones
    # come only when the token is announced.
    clock = MonotonicClock()
    links = make_links(settings, clock)
    for warning in links.warnings:
        log.warning(warning)
    links.transport.open()
    state.transport = links.transport
    if links.tunnel is not None:
        state.metrics.follow_tunnel(links.tunnel.counters)
    for line in links.lines():
        _say(line)
    try:
        pipeline = make_pipeline(settings, clock, check=True)
    except BaseException:
        links.transport.close()
        raise
    detector = pipeline.detector.describe()
    _say(
        f"model  {detector['name']} {pipeline.detector.model_hash[:12]}, "
        f"{detector['engine']} {detector['precision']}, {detector['threads']} threads"
        + (f", {detector['detect_p50_ms']:.1f} ms" if "detect_p50_ms" in detector else "")
    )
    _say(f"target {pipeline.target.name}, method {pipeline.method}")
    return EdgeService(settings, pipeline, links.transport, state, clock)


def _stop_on_signals() -> asyncio.Event:
    """An event that the first SIGTERM or SIGINT sets; the second one ends the process at once."""
    stop = asyncio.Event()

    def handle() -> None:
        if stop.is_set():
            with suppress(OSError):
                print("edge-service: stopped by force", file=sys.stderr, flush=True)
            os._exit(EXIT_FORCED)
        stop.set()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, handle)
    return stop


def _say(line: str) -> None:
    """Tell people; whoever read it may be gone or his disk full, and the drones are served on."""
    with suppress(OSError):
        print(line, flush=True)


def _let_go_of_output() -> None:
    """Drop what could not be written: Python tries again at its end, and would exit with 120."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:  # it was closed before the start
                stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
