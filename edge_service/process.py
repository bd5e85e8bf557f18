"""The service as a process: signals, the start-up lines, the exit code."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import time
from importlib import metadata

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


def serve(settings: EdgeSettings) -> int:
    """Run until SIGTERM or SIGINT; the exit code.

    Raises:
        AddressError, TlsFilesError, KeyFileError, WeightsError, TargetFileError,
        SelfCheckError: it cannot start.
    """
    code = asyncio.run(_serve(settings))
    if code == EXIT_STUCK:
        # Somebody else's thread may wait for the one that hangs, and Python would wait for both
        logging.shutdown()
        sys.stdout.flush()
        os._exit(code)
    return code


async def _serve(settings: EdgeSettings) -> int:
    start_s = time.monotonic()
    _say(f"edge-service {metadata.version('aerial-contact')}, worker {settings.name}")
    mailbox = Mailbox(settings.max_drones, int(settings.drone_idle_s * 1e9))
    state = ServiceState(settings, Metrics(), mailbox)
    listener = bind(*settings.http_address)
    _say(f"http   {url_of(listener)} (alive, not ready)")
    http = HttpServer(create_app(state))
    http_task = asyncio.create_task(http.serve([listener]))
    stop = _stop_on_signals()
    try:
        service = await asyncio.to_thread(_bring_up, settings, state)
        seconds = time.monotonic() - start_s
        _say(f"ready  in {seconds:.1f} s; Ctrl-C stops")
        stopped = asyncio.create_task(stop.wait())
        await asyncio.wait({stopped, http_task}, return_when=asyncio.FIRST_COMPLETED)
        _say("drain  answering what is here")
        finished = await asyncio.to_thread(service.drain, time.sleep)
    finally:
        http.should_exit = True
        await http_task
    _say("bye" if finished else "bye; the worker is stuck with a frame")
    return EXIT_OK if finished else EXIT_STUCK


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
    service = EdgeService(settings, pipeline, links.transport, state, clock)
    service.start()
    return service


def _stop_on_signals() -> asyncio.Event:
    """An event that the first SIGTERM or SIGINT sets; the second one ends the process at once."""
    stop = asyncio.Event()

    def handle() -> None:
        if stop.is_set():
            print("edge-service: stopped by force", file=sys.stderr, flush=True)
            os._exit(EXIT_FORCED)
        stop.set()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, handle)
    return stop


def _say(line: str) -> None:
    print(line, flush=True)
