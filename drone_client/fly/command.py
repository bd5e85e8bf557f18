"""``drone-client fly``: the command line of the real thing."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from rich.console import Console

from drone_client.airframe import load_airframe
from drone_client.autopilot.choose import open_autopilot
from drone_client.errors import AirframeError, ClientError
from drone_client.flight_settings import flight_settings
from drone_client.fly.run import FlyOptions
from drone_client.fly.run import fly as run_fly
from drone_client.fly.terminal import TerminalCockpit
from drone_client.link.choose import link_summary, open_link
from drone_client.mission import Phase
from drone_client.odometry.choose import open_odometry
from drone_client.ros.names import Flavour
from drone_client.ros.publish import open_ros, publish_accepted
from drone_client.settings import about, load_settings
from drone_client.source.choose import REALSENSE, open_live
from drone_client.summary_table import print_summary
from drone_client.tuning import load_tuning
from rgbd_wire.clock import MonotonicClock

EXIT_NOT_DONE = 3


def fly(
    airframe: Annotated[
        Path, typer.Option(help="TOML with body_from_camera and body_from_tip of this drone")
    ],
    autopilot: Annotated[
        str,
        typer.Option(
            help="udp/HOST:PORT listens, udpout/HOST:PORT speaks first, serial/DEVICE:BAUD; "
            "ardupilot+udp/... for ArduPilot's GUIDED"
        ),
    ] = "udp/127.0.0.1:14540",
    source: Annotated[
        str, typer.Option(help="realsense, or realsense:SERIAL where there are several")
    ] = REALSENSE,
    camera: Annotated[
        Path | None,
        typer.Option(help="camera JSON, in place of what the camera says", show_default=False),
    ] = None,
    tuning: Annotated[
        Path | None,
        typer.Option(
            help="TOML with numbers of mission, guidance, filter and odometry", show_default=False
        ),
    ] = None,
    floor_m: Annotated[
        float | None,
        typer.Option(help="height of a floor in the odometry's world", show_default=False),
    ] = None,
    ceiling_m: Annotated[
        float | None,
        typer.Option(help="height of a ceiling in the odometry's world", show_default=False),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="fly nothing, show the commands; only heartbeats, time and rates are exchanged",
        ),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="take the vehicle without a question")] = False,
    connect: Annotated[str | None, typer.Option(help=about("connect"))] = None,
    out: Annotated[Path, typer.Option(help="folder for ledger, summary and plot")] = Path("RUN"),
    name: Annotated[str | None, typer.Option(help=about("name"))] = None,
    tau_max_ms: Annotated[float | None, typer.Option(help=about("tau_max_ms"))] = None,
    age_max_ms: Annotated[float | None, typer.Option(help=about("age_max_ms"))] = None,
    key_file: Annotated[Path | None, typer.Option(help=about("key_file"))] = None,
    tls: Annotated[Path | None, typer.Option(help=about("tls"))] = None,
    onboard_fallback: Annotated[
        bool | None,
        typer.Option("--onboard-fallback/--no-onboard-fallback", help=about("onboard_fallback")),
    ] = None,
    onboard_target: Annotated[str | None, typer.Option(help=about("onboard_target"))] = None,
    ros_topic: Annotated[str | None, typer.Option(help=about("ros_topic"))] = None,
    ros_connect: Annotated[str | None, typer.Option(help=about("ros_connect"))] = None,
    ros_flavour: Annotated[Flavour | None, typer.Option(help=about("ros_flavour"))] = None,
    vio_topic: Annotated[
        str | None,
        typer.Option(help="ROS 2 topic of the robot's VIO (nav_msgs/Odometry), for the autopilot"),
    ] = None,
    lidar_topic: Annotated[
        str | None,
        typer.Option(help="ROS 2 topic of a lidar that looks down (sensor_msgs/Range)"),
    ] = None,
    ahead_topic: Annotated[
        str | None,
        typer.Option(help="ROS 2 topic of a lidar that looks ahead (sensor_msgs/Range)"),
    ] = None,
    wait_for_vehicle_s: Annotated[
        float, typer.Option(min=0.1, max=600, help="how long to wait for the autopilot's pose")
    ] = 10.0,
    plot: Annotated[
        bool, typer.Option("--plot/--no-plot", help="draw run.png beside the ledger")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="print the summary as JSON")] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="an earlier run in the same folder may go")
    ] = False,
) -> None:
    """Fly to contact with the target, hold it, and come back.

    The drone hovers already, armed and taken off by its pilot, with the target in front of it.
    The client asks before it takes the vehicle (OFFBOARD), arms nothing by itself, and lets go at
    once when the pilot switches the mode. Ctrl-C, SIGTERM, a terminal that is closed: the drone
    backs off and is given back; once more: it is given back where it is. With --dry-run no mode is
    asked for and no command sent: carry the drone by hand and look at the commands.

    Exit code 0: touched and back. 3: the mission ended otherwise, or nobody agreed.

    Example: drone-client fly --airframe drone.toml --autopilot serial//dev/ttyACM0:921600
    """
    console = Console(stderr=True)
    if not (yes or dry_run or sys.stdin.isatty()):
        raise ClientError("nobody to ask: run it in a terminal, or with --yes or --dry-run")
    settings = load_settings(
        name=name,
        connect=connect,
        tau_max_ms=tau_max_ms,
        age_max_ms=age_max_ms,
        key_file=key_file,
        tls=tls,
        onboard_fallback=onboard_fallback,
        onboard_target=onboard_target,
        ros_topic=ros_topic,
        ros_connect=ros_connect,
        ros_flavour=ros_flavour,
    )
    body = load_airframe(airframe)
    parts = flight_settings(settings)
    if tuning is not None:
        parts = load_tuning(tuning, parts)
    if floor_m is not None and ceiling_m is not None and not floor_m < ceiling_m:
        raise AirframeError(
            f"--floor-m {floor_m:g} is not below --ceiling-m {ceiling_m:g}: both are heights"
        )
    planes = list(body.keep_outs)
    try:
        planes += [] if floor_m is None else [body.floor(floor_m)]
        planes += [] if ceiling_m is None else [body.ceiling(ceiling_m)]
    except ValueError as error:
        raise AirframeError(str(error)) from None
    parts = replace(parts, control=replace(parts.control, keep_outs=tuple(planes)))
    options = FlyOptions(out, dry_run, wait_for_vehicle_s, plot, overwrite)
    clock = MonotonicClock()
    cockpit = TerminalCockpit(console, ask=not yes)
    with ExitStack() as stack:
        stack.callback(cockpit.close)
        stack.enter_context(_heeding_hang_up())
        live = open_live(source, clock, camera=camera)
        vehicle = open_autopilot(autopilot, clock)
        stack.callback(vehicle.close)
        link = open_link(settings, clock)
        stack.callback(link.close)
        for warning in link_summary(link).get("warnings", ()):
            console.print(f"warning: {warning}", style="yellow", markup=False, soft_wrap=True)
        odometry = open_odometry(
            settings,
            clock,
            vio_topic=vio_topic,
            lidar_topic=lidar_topic,
            ahead_topic=ahead_topic,
        )
        if odometry is not None:
            stack.callback(odometry.close)
        ros = open_ros(settings, clock)
        if ros is not None:
            stack.callback(ros.close)
        summary = run_fly(
            live,
            vehicle,
            body,
            settings,
            parts,
            options,
            link,
            clock,
            cockpit,
            (lambda reception: None) if ros is None else partial(publish_accepted, ros),
            odometry,
        )
    if as_json:
        print(json.dumps(summary, indent=2))
    else:
        print_summary(summary)
    if summary["phase"] != Phase.DONE.value:
        raise typer.Exit(EXIT_NOT_DONE)


@contextmanager
def _heeding_hang_up() -> Iterator[None]:
    """A terminal that is closed, or a lost ssh, is as good as a Ctrl-C; not under ``nohup``."""
    before = signal.getsignal(signal.SIGHUP)
    if before is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGHUP, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
