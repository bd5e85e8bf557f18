"""``drone-client replay``: a recording flown through the whole chain, against real workers."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drone_client.airframe import Airframe
from drone_client.autopilot.memory import MemoryAutopilot
from drone_client.flight import Flight
from drone_client.flight_settings import flight_settings
from drone_client.ledger import Ledger
from drone_client.link import Link
from drone_client.link.waiting import wait_for_worker
from drone_client.playback import Lockstep, Playback, RealTime
from drone_client.reception import Reception
from drone_client.run_report import report, take_down
from drone_client.settings import ClientSettings
from drone_client.source import RgbdSource
from drone_client.tally import Tally
from drone_client.truth import TruthEntry
from rgbd_wire.clock import Clock
from rgbd_wire.frame import RgbdFrame


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What the command line says of one replay."""

    out: Path
    as_fast_as_possible: bool = False
    """Each frame after the last one's answer, instead of at the recording's speed."""
    truth: tuple[TruthEntry, ...] = ()
    plot: bool = True
    overwrite: bool = False
    """An earlier run in ``out`` may go."""


def replay(
    source: RgbdSource,
    airframe: Airframe,
    settings: ClientSettings,
    options: ReplayOptions,
    link: Link,
    clock: Clock,
    on_progress: Callable[[int, Tally], None],
    on_accepted: Callable[[Reception], None] = lambda reception: None,
) -> dict[str, Any]:
    """Fly a recording; returns the summary, which is also written beside ledger and plot.

    An interrupt (Ctrl-C) ends it early and still leaves a whole ledger, a summary and a plot.

    Raises:
        ClientError: the output folder cannot be written, a picture cannot be read, or there is no
            worker.
        TargetFileError: the target of the drone's own eyes cannot be read.
    """
    parts = flight_settings(settings)
    ledger = Ledger(options.out, overwrite=options.overwrite, own_eyes=settings.onboard_fallback)
    stop = threading.Event()
    playback: Playback
    if options.as_fast_as_possible:
        playback = Lockstep(source, airframe, clock, stop, ledger.settled)
    else:
        playback = RealTime(source, airframe, clock, stop)
    flight = Flight(
        parts,
        airframe,
        link,
        MemoryAutopilot(),
        clock,
        ledger,
        playback.world_from_body,
        on_accepted,
    )
    interrupted = False
    try:
        flight.start()
        ledger.event(clock.now_ns(), "workers", live=wait_for_worker(link, settings))
        for number, (t_capture_ns, capture) in enumerate(playback.captures(), 1):
            frame = RgbdFrame(
                color_rgb=capture.color_rgb,
                depth_units=capture.depth_units,
                camera=source.camera,
                t_capture_ns=t_capture_ns,
                world_from_camera=source.world_from_camera(capture.t_source_ns),
            )
            flight.capture(frame, capture.name)
            on_progress(number, flight.tally)
        flight.drain()
        on_progress(len(source), flight.tally)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        stop.set()
        at_end = take_down(flight, link)
    about = {
        "as_fast_as_possible": options.as_fast_as_possible,
        "interrupted": interrupted,
        **at_end,
    }
    return report(
        options.out,
        settings,
        flight,
        ledger,
        about,
        truth=options.truth,
        plot=options.plot,
    )
