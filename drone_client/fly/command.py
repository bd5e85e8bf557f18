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
from typing import Annotated, Any

import typer
from rich.console import Console

from drone_client.airframe import Airframe, load_airframe
from drone_client.errors import AirframeError, ClientError, WorldError
from drone_client.flight_settings import FlightSettings, flight_settings
from drone_client.fly.lateness import too_slow
from drone_client.fly.robot import Robot, open_robot
from drone_client.fly.run import FlyOptions
from drone_client.fly.run import fly as run_fly
from drone_client.fly.simulator import Simulator, SimulatorRequest, open_simulator
from drone_client.fly.terminal import TerminalCockpit
from drone_client.fly.truly import print_truth, unsafe
from drone_client.fly.views import checked, told, write_views
from drone_client.link.choose import link_summary, open_link
from drone_client.mission import Phase
from drone_client.ros.names import Flavour
from drone_client.ros.publish import open_ros, publish_accepted
from drone_client.run_files import LEDGER_NAME
from drone_client.run_report import check_folder
from drone_client.settings import ClientSettings, about, load_settings
from drone_client.source.choose import REALSENSE
from drone_client.summary import read_lines
from drone_client.summary_table import print_summary
from drone_client.tuning import load_tuning
from drone_client.viewing.facts import facts_of
from drone_client.viewing.recorder import FlightRecorder
from rgbd_wire.clock import MonotonicClock

EXIT_UNWRITTEN = 2
"""It ended well, and something that was asked for is not on the disk; as with ``replay``."""
EXIT_NOT_DONE = 3
EXIT_BROKEN_OFF = 130
PX4_BOOT_S = 120.0
"""A PX4 that was started for the flight says where it is within this time."""
OF_A_WORLD = ("seed", "board")
"""Options that no real flight has."""
OF_A_ROBOT = ("source", "camera", "vio_topic", "lidar_topic", "ahead_topic")
"""Options that name parts of a real drone, in whose place a simulator puts its own."""


def fly(
    context: typer.Context,
    airframe: Annotated[
        Path | None,
        typer.Option(
            help="TOML with body_from_camera and body_from_tip of this drone, also of a simulated "
            "one",
            show_default="needed, but for --sim",
        ),
    ] = None,
    sim: Annotated[
        str | None,
        typer.Option(
            "--sim", help="fly in a simulated world: tunnel or refinery", show_default=False
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="of the simulated world")] = 0,
    board: Annotated[
        str, typer.Option(help="print in the simulated world: clean, scratched or glossy")
    ] = "clean",
    emulated_link: Annotated[
        str | None,
        typer.Option(
            "--link",
            help="emulated link to the service of --sim: lan, wifi, 5g or bad",
            show_default=False,
        ),
    ] = None,
    hil: Annotated[
        str | None,
        typer.Option(
            "--hil",
            metavar="HOST:PORT",
            help="let a PX4 SITL binary fly the drone of --sim: it calls 127.0.0.1:4560",
            show_default=False,
        ),
    ] = None,
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
    video: Annotated[
        Path | None,
        typer.Option(help="film of the simulated flight: .mp4 or .webm", show_default=False),
    ] = None,
    mcap: Annotated[
        Path | None, typer.Option(help="MCAP file of the flight, for Foxglove", show_default=False)
    ] = None,
    rerun: Annotated[
        Path | None, typer.Option(help="Rerun recording (.rrd) of the flight", show_default=False)
    ] = None,
    foxglove: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT",
            help="serve the flight live to Foxglove, such as 8765",
            show_default=False,
        ),
    ] = None,
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

    With --vio-topic the robot's VIO is passed on to the autopilot from the first second until the
    motors stand still, for the vehicle may know its place by nothing else: land it, or Ctrl-C.

    With --sim the same client flies a simulated drone, through a real service that is started for
    it, or the one of --connect; nobody is asked.

    With --hil as well the vehicle is a PX4 SITL binary that you start and take off (docs/px4.md),
    and that the client reaches at --autopilot; somebody is asked, as with a real one.

    --mcap, --rerun and --video are written when the flight is over, from the run's folder;
    drone-client log writes the first two again at any time.

    Exit code 0: touched and back. 3: the mission ended otherwise, nobody agreed, or, in a simulated
    world, anything but the tip touched anything, or it pushed beside the mouth. 130: broken off.

    Example: drone-client fly --airframe drone.toml --autopilot serial//dev/ttyACM0:921600

    Example: drone-client fly --sim tunnel --seed 3 --link wifi --out runs/tunnel
    """
    console = Console(stderr=True)
    asks = not (yes or dry_run) and (sim is None or hil is not None)
    _check(context, sim, hil, emulated_link)
    views = checked(video, mcap, rerun, foxglove, simulated=sim is not None, overwrite=overwrite)
    body = _airframe(airframe, sim, console)
    _check_asked(asks=asks)
    check_folder(out, overwrite=overwrite)
    settings = load_settings(
        name=name,
        connect=connect,
        key_file=key_file,
        tau_max_ms=tau_max_ms,
        age_max_ms=age_max_ms,
        tls=tls,
        onboard_fallback=onboard_fallback,
        onboard_target=onboard_target,
        ros_topic=ros_topic,
        ros_connect=ros_connect,
        ros_flavour=ros_flavour,
    )
    starts_service = sim is not None and _needs_service(settings, tls, key_file)
    parts = _tuned(flight_settings(settings), tuning)
    _with_keep_outs(parts, body, floor_m, ceiling_m)  # all mistakes before anything is started
    clock = MonotonicClock()
    with ExitStack() as stack:
        stack.enter_context(_heeding_hang_up())
        world: Simulator | None = None
        if sim is not None:
            _tell_building(console, sim, seed, hil)
            request = SimulatorRequest(
                sim,
                seed,
                board,
                emulated_link,
                settings.name,
                out,
                starts_service,
                hil,
                autopilot,
                body,
                parts.control.filter.funnel.r_c_m,
            )
            world = open_simulator(request, clock)
            stack.callback(world.close)
            settings = settings.model_copy(update=world.reach)
            parts = parts if tuning is not None else world.tuned(parts)
            floor_m, ceiling_m = _heights(world, floor_m, ceiling_m)
        parts = _with_keep_outs(parts, body, floor_m, ceiling_m)
        cockpit = TerminalCockpit(console, ask=asks)
        stack.callback(cockpit.close)
        robot: Robot | Simulator
        if world is not None:
            robot = world
        else:
            robot = open_robot(
                source, camera, autopilot, settings, clock, vio_topic, lidar_topic, ahead_topic
            )
            stack.callback(robot.close)
        link = open_link(settings, clock)
        stack.callback(link.close)
        for warning in link_summary(link).get("warnings", ()):
            _warn(console, f"warning: {warning}", "yellow")
        ros = open_ros(settings, clock)
        if ros is not None:
            stack.callback(ros.close)
        recorder = FlightRecorder(
            robot.camera,
            robot.vehicle.state,
            out,
            partial(facts_of, settings, body, parts.control.filter.funnel),
            pictures=views.wants_pictures,
            live=views.live,
        )
        stack.callback(recorder.close)
        summary = run_fly(
            recorder,
            robot.vehicle,
            body,
            settings,
            parts,
            FlyOptions(
                out,
                dry_run,
                _wait_s(wait_for_vehicle_s, hil),
                plot,
                overwrite,
                feeds_on=sim is None,
            ),
            link,
            clock,
            cockpit,
            (lambda reception: None) if ros is None else partial(publish_accepted, ros),
            robot.odometry,
            partial(told, recorder, world),
        )
        write_views(views, out, summary, world, console, overwrite=overwrite)
    if as_json:
        print(json.dumps(summary, indent=2))
    else:
        print_summary(summary)
        print_truth(summary)
    raise typer.Exit(_verdict(summary, out, console, shared=starts_service))


def _verdict(summary: dict[str, Any], out: Path, console: Console, *, shared: bool) -> int:
    """The exit code, and a word about it that the summary has not.

    Args:
        summary: of the run.
        out: its folder.
        console: for the word.
        shared: the service was started for the flight, on this machine.
    """
    done, broken_off = summary["phase"] == Phase.DONE.value, summary["broken_off"]
    if not done and not broken_off:
        late = too_slow(read_lines(out / LEDGER_NAME), summary["service_ms"], shared=shared)
        _warn(console, late, "yellow")
    if (what := unsafe(summary)) is not None:
        _warn(console, what, "red")
        return EXIT_NOT_DONE
    if broken_off:
        return EXIT_BROKEN_OFF
    if not done:
        return EXIT_NOT_DONE
    return EXIT_UNWRITTEN if summary["unwritten"] else 0


def _warn(console: Console, sentence: str | None, style: str) -> None:
    if sentence is not None:
        console.print(sentence, style=style, markup=False, highlight=False, soft_wrap=True)


def _is_given(context: typer.Context, option: str) -> bool:
    source = context.get_parameter_source(option)
    return source is not None and source.name != "DEFAULT"


def _check(
    context: typer.Context, sim: str | None, hil: str | None, emulated_link: str | None
) -> None:
    """What a simulated drone alone has, and a real one alone: nothing that is given is ignored.

    Args:
        context: knows what was given.
        sim: the world.
        hil: address of a PX4.
        emulated_link: its name.
    """
    if sim is not None:
        for option in OF_A_ROBOT:
            if _is_given(context, option):
                raise WorldError(
                    f"{_flag(option)} names a part of a real drone, and --sim has its own: leave "
                    "one of them out"
                )
        if hil is None and _is_given(context, "autopilot"):
            raise WorldError("--autopilot goes with --hil in --sim, which has a vehicle of its own")
        return
    for option in OF_A_WORLD:
        if _is_given(context, option):
            raise WorldError(f"{_flag(option)} needs --sim: it is of a simulated world")
    if hil is not None:
        raise WorldError("--hil puts a PX4 into a simulated world: which one? --sim says it")
    if emulated_link is not None:
        raise WorldError("--link emulates a link for --sim; a real one is as it is")


def _needs_service(settings: ClientSettings, tls: Path | None, key_file: Path | None) -> bool:
    """Whether one has to be started for a simulated flight: nobody named one that runs."""
    if "connect" in settings.model_fields_set:
        return False
    for option, given in (("--tls", tls), ("--key-file", key_file)):
        if given is not None:
            raise WorldError(
                f"{option} is for the service of --connect: the one that is started for a "
                "simulated flight needs none"
            )
    return True


def _check_asked(*, asks: bool) -> None:
    if asks and not sys.stdin.isatty():
        raise ClientError("nobody to ask: run it in a terminal, or with --yes or --dry-run")


def _heights(
    world: Simulator, floor_m: float | None, ceiling_m: float | None
) -> tuple[float | None, float | None]:
    """Of floor and ceiling: as the user has them, or as the world does."""
    return (
        world.floor_m if floor_m is None else floor_m,
        world.ceiling_m if ceiling_m is None else ceiling_m,
    )


def _tuned(parts: FlightSettings, tuning: Path | None) -> FlightSettings:
    return parts if tuning is None else load_tuning(tuning, parts)


def _flag(option: str) -> str:
    return "--" + option.replace("_", "-")


def _airframe(path: Path | None, sim: str | None, console: Console) -> Airframe:
    """What is flown; nobody flies a real drone by the simulated one's numbers unawares."""
    if path is not None:
        body = load_airframe(path)
        if body.assumed and sim is None:
            what = ", ".join(body.assumed)
            _warn(console, f"warning: {path} has no {what}: the default drone's fly", "yellow")
        return body
    if sim is None:
        raise AirframeError("--airframe is needed: where camera and arm sit on this drone")
    return Airframe()


def _tell_building(console: Console, sim: str, seed: int, hil: str | None) -> None:
    sentence = f"building the world {sim}, seed {seed}"
    if hil is not None:
        sentence += f"; then it waits for a PX4 SITL binary that calls its simulator at {hil}"
    console.print(sentence, markup=False, highlight=False, soft_wrap=True)


def _wait_s(wait_s: float, hil: str | None) -> float:
    """For the vehicle's pose; a PX4 that has just been started has to boot."""
    return wait_s if hil is None else max(wait_s, PX4_BOOT_S)


def _with_keep_outs(
    parts: FlightSettings, body: Airframe, floor_m: float | None, ceiling_m: float | None
) -> FlightSettings:
    """The settings with the planes of the airframe, a floor and a ceiling."""
    if floor_m is not None and ceiling_m is not None and not floor_m < ceiling_m:
        raise AirframeError(
            f"--floor-m {floor_m:g} is not below --ceiling-m {ceiling_m:g}: both are heights"
        )
    try:
        planes = body.planes(floor_m, ceiling_m)
    except ValueError as error:
        raise AirframeError(str(error)) from None
    return replace(parts, control=replace(parts.control, keep_outs=planes))


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
